"""A C99 header: the numbers as constants, and the equation as a function."""

from __future__ import annotations

from magcal_service.offline.exports.form import Exported, Form, Wanted, about
from magcal_service.offline.given import Given


def _make(given: Given, _wanted: Wanted) -> Exported:
    comment = "\n".join(f" * {line}" for line in about(given))
    bias = ", ".join(f"{one:.9e}f" for one in given.bias_nt.tolist())
    rows = ",\n    ".join("{" + ", ".join(f"{one:.9e}f" for one in row) + "}" for row in given.matrix.tolist())
    return Exported(f"""/*
{comment}
 */
#ifndef MAGCAL_RESULT_H
#define MAGCAL_RESULT_H

#define MAGCAL_RESULT_TRUSTED {int(given.trusted)}
/* Effects of physics.toml that have to be subtracted besides. */
#define MAGCAL_RESULT_EFFECTS_LEFT_OUT {0 if given.model is None else len(given.model.terms)}
#define MAGCAL_RESULT_SHA256 "{given.sha256}"

/* b [nT]. */
static const float magcal_result_bias_nt[3] = {{{bias}}};

/* I + D [-], symmetric. */
static const float magcal_result_matrix[3][3] = {{
    {rows}}};

/* w = (I + D) B - b, both in nT, sensor axes. */
static inline void magcal_result_apply(const float measured_nt[3], float calibrated_nt[3])
{{
    for (int i = 0; i < 3; ++i) {{
        calibrated_nt[i] = magcal_result_matrix[i][0] * measured_nt[0] + magcal_result_matrix[i][1] * measured_nt[1]
            + magcal_result_matrix[i][2] * measured_nt[2] - magcal_result_bias_nt[i];
    }}
}}

#endif
""")


C_HEADER = Form("c-header", "C99: the numbers as constants, and the equation as a function", _make)
