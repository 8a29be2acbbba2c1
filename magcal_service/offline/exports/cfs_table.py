"""The source of a table image of NASA's core Flight System, for ``elf2cfetbl``.

Source: ``CFE_TBL_FILEDEF(ObjName, TblName, Desc, Filename)`` of cFE's ``cfe_tbl_filedef.h``.
"""

from __future__ import annotations

from magcal_service.offline.exports.form import Exported, Form, Wanted, about
from magcal_service.offline.given import Given


def _make(given: Given, _wanted: Wanted) -> Exported:
    comment = "\n".join(f" * {line}" for line in about(given))
    bias = ", ".join(f"{one:.17g}" for one in given.bias_nt.tolist())
    rows = ", ".join("{" + ", ".join(f"{one:.17g}" for one in row) + "}" for row in given.matrix.tolist())
    return Exported(f"""/*
{comment}
 */
#include "cfe_tbl_filedef.h"

typedef struct
{{
    double   Bias_nT[3];     /* b */
    double   Matrix[3][3];   /* I + D */
    unsigned Trusted;        /* 1 where the result says that it may be used */
}} MAGCAL_ResultTable_t;

MAGCAL_ResultTable_t MagcalResult = {{
    .Bias_nT = {{{bias}}},
    .Matrix = {{{rows}}},
    .Trusted = {int(given.trusted)}}};

CFE_TBL_FILEDEF(MagcalResult, MAGCAL.Result, Magnetometer calibration, magcal_result.tbl)
""")


CFS_TABLE = Form("cfs-table", "the source of a cFE table image, for elf2cfetbl", _make)
