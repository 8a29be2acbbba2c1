"""XTCE 1.2 of the space packets: the same table that packs them, as mission control reads it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final
from xml.etree import ElementTree as Tree

from magcal_service.wire.kinds import KIND_BY_CODE, Kind
from magcal_service.wire.messages import Verdict
from magcal_service.wire.packets import PARAMETERS, Form, Parameter

NAMESPACE: Final = "http://www.omg.org/spec/XTCE/20180204"

_SCHEMA: Final = f"{NAMESPACE} https://www.omg.org/spec/XTCE/20180204/SpaceSystem.xsd"

ROOT: Final = "CCSDSPacket"
"""The container of what all packets begin with."""

_BITS: Final = {Form.U8: 8, Form.U32: 32, Form.U64: 64, Form.I64: 64, Form.F64: 64}
_LENGTH_BITS: Final = 16  # of the number of bytes before a text

_HEADER: Final = (
    ("VERSION", 3, "packet version number, 0"),
    ("TYPE", 1, "0: telemetry"),
    ("SEC_HDR_FLG", 1, "1: the time follows as secondary header"),
    ("PKT_APID", 11, "application process identifier: which kind of message"),
    ("SEQ_FLGS", 2, "3: unsegmented"),
    ("SRC_SEQ_CTR", 14, "packet sequence count of the APID"),
    ("PKT_LEN", 16, "octets after the primary header, less one"),
    ("CUC_P_FIELD", 8, "47: CUC, epoch 1970-01-01, 4 octets of seconds, 3 of fraction"),
    ("CUC_SECONDS", 32, "seconds of the data's time since 1970, leap seconds ignored"),
    ("CUC_FRACTION", 24, "its fraction in 2^-24 s"),
)
"""Name, bits and meaning of what stands before the user data."""


_SAYS: Final = {
    "schema_version": "of the wire's schema",
    "craft": "name of the craft",
    "source": "magnetometer, or magcal for results of the craft's own",
    "sequence": "counts the messages of one kind from one source",
    "time_ns": "time of the data on clock, exact",
    "clock": "utc: since 1970, leap seconds ignored; elapsed: since the source's own start",
    "field_body_nt": "calibrated vector in the sensor's axes",
    "covariance_nt2": "covariance of the vector, noise and estimate together",
    "verdict": "how far to trust the estimate",
    "protection_nt": "how far a vector may be off by what would not have been seen yet; not a number while unknown",
    "protection_by": "the hazard that sets the protection level",
    "method": "estimator",
    "tick": "seconds of samples used so far",
    "bias_nt": "bias b",
    "D": "scale and non-orthogonality: w = (I + D) B - b",
    "covariance": "covariance of bias [nT] and D, upper triangle",
    "reasons": "why not to trust it further, joined by commas",
    "remedy": "what to do about it",
    "residual_rms_nt": "running rms of |(I + D) B - b| - |H|",
    "noise_nt": "sensor noise assumed, 1 sigma per axis",
    "samples_used": "magnetometer samples used so far",
    "uptime_s": "of the daemon",
    "counters": "of the daemon for this craft, docs/health.md",
    "text": "for people",
    "name": "of the command",
    "command_source": "who sent it",
    "command_sequence": "its number",
    "accepted": "whether it was carried out",
}
"""What each field means, in a line for an operator's display."""


def names_of(kind: Kind) -> tuple[str, ...]:
    """The names of a kind's parameters in the XTCE, in the order of ``packets.values_of``."""
    return tuple(_name(kind, parameter) for parameter in PARAMETERS[kind.code])


def xtce(apids: Mapping[int, int]) -> str:
    """The XTCE of the kinds in ``apids``, from a kind's code to its APID, as XML text."""
    schema = {"xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance", "xsi:schemaLocation": _SCHEMA}
    root = Tree.Element("SpaceSystem", {"xmlns": NAMESPACE, **schema, "name": "magcal"})
    root.set("shortDescription", "telemetry of magcal: magnetometer calibration without attitude")
    telemetry = Tree.SubElement(root, "TelemetryMetaData")
    kinds = [KIND_BY_CODE[code] for code in sorted(apids)]
    types = Tree.SubElement(telemetry, "ParameterTypeSet")
    for bits in sorted({bits for _, bits, _ in _HEADER} | {_LENGTH_BITS}):
        _integer_type(types, f"uint{bits}", bits)
    seen: set[str] = {f"uint{bits}" for _, bits, _ in _HEADER}
    for kind in kinds:
        for parameter in PARAMETERS[kind.code]:
            name = _type_name(kind, parameter)
            if name not in seen:
                seen.add(name)
                _parameter_type(types, name, kind, parameter)
    _parameters(Tree.SubElement(telemetry, "ParameterSet"), kinds)
    _containers(Tree.SubElement(telemetry, "ContainerSet"), kinds, apids)
    Tree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + Tree.tostring(root, encoding="unicode") + "\n"


def _name(kind: Kind, parameter: Parameter) -> str:
    return f"{kind.name}_{parameter.name}"


def _length_name(kind: Kind, parameter: Parameter) -> str:
    return f"{_name(kind, parameter)}_bytes"


def _type_name(kind: Kind, parameter: Parameter) -> str:
    """Texts have a type each, since it says where their length stands; others share theirs by form, words and unit."""
    if parameter.form is Form.TEXT:
        return f"{_name(kind, parameter)}_text"
    if parameter.labels:
        return "_or_".join(parameter.labels)
    sort = {Form.F64: "float", Form.I64: "int"}.get(parameter.form, "uint")
    unit = parameter.unit.replace("^", "")
    return f"{sort}{_BITS[parameter.form]}{'_' if unit else ''}{unit}"


def _parameter_type(types: Tree.Element, name: str, kind: Kind, parameter: Parameter) -> None:
    form = parameter.form
    if form is Form.TEXT:
        _text_type(types, name, _length_name(kind, parameter))
    elif parameter.labels:
        _enumerated_type(types, name, parameter.labels)
    elif form is Form.F64:
        float_type = Tree.SubElement(types, "FloatParameterType", {"name": name, "sizeInBits": "64"})
        _units(float_type, parameter.unit)
        Tree.SubElement(float_type, "FloatDataEncoding", {"sizeInBits": "64"})
    else:
        _integer_type(types, name, _BITS[form], parameter.unit, signed=form is Form.I64)


def _units(of: Tree.Element, unit: str) -> None:
    units = Tree.SubElement(of, "UnitSet")
    if unit:
        Tree.SubElement(units, "Unit").text = unit


def _integer_type(types: Tree.Element, name: str, bits: int, unit: str = "", *, signed: bool = False) -> None:
    size = {"name": name, "sizeInBits": str(max(bits, 32)), "signed": "true" if signed else "false"}
    integer = Tree.SubElement(types, "IntegerParameterType", size)
    _units(integer, unit)
    encoding = "twosComplement" if signed else "unsigned"
    Tree.SubElement(integer, "IntegerDataEncoding", {"sizeInBits": str(bits), "encoding": encoding})


def _enumerated_type(types: Tree.Element, name: str, labels: tuple[str, ...]) -> None:
    enumerated = Tree.SubElement(types, "EnumeratedParameterType", {"name": name})
    _units(enumerated, "")
    Tree.SubElement(enumerated, "IntegerDataEncoding", {"sizeInBits": "8", "encoding": "unsigned"})
    entries = Tree.SubElement(enumerated, "EnumerationList")
    for number, label in enumerate(labels):
        Tree.SubElement(entries, "Enumeration", {"value": str(number), "label": label})
    if Verdict.DOUBTFUL in labels:
        alarm = Tree.SubElement(enumerated, "DefaultAlarm", {"defaultAlarmLevel": "normal"})
        alarms = Tree.SubElement(alarm, "EnumerationAlarmList")
        Tree.SubElement(
            alarms, "EnumerationAlarm", {"enumerationLabel": str(Verdict.DOUBTFUL), "alarmLevel": "warning"}
        )


def _text_type(types: Tree.Element, name: str, length: str) -> None:
    text = Tree.SubElement(types, "StringParameterType", {"name": name})
    _units(text, "")
    encoding = Tree.SubElement(text, "StringDataEncoding", {"encoding": "UTF-8"})
    variable = Tree.SubElement(encoding, "Variable", {"maxSizeInBits": str(8 * ((1 << _LENGTH_BITS) - 1))})
    value = Tree.SubElement(variable, "DynamicValue")
    Tree.SubElement(value, "ParameterInstanceRef", {"parameterRef": length, "useCalibratedValue": "false"})
    Tree.SubElement(value, "LinearAdjustment", {"slope": "8", "intercept": "0"})


def _entries(kind: Kind) -> Iterator[tuple[str, str, str]]:
    """Name, type and meaning of each entry of a kind's container."""
    for parameter in PARAMETERS[kind.code]:
        if parameter.form is Form.TEXT:
            yield _length_name(kind, parameter), f"uint{_LENGTH_BITS}", "bytes of the text after it"
        yield _name(kind, parameter), _type_name(kind, parameter), _SAYS[parameter.field]


def _parameters(parameters: Tree.Element, kinds: list[Kind]) -> None:
    header = [(name, f"uint{bits}", meaning) for name, bits, meaning in _HEADER]
    for name, of, meaning in (*header, *(entry for kind in kinds for entry in _entries(kind))):
        attributes = {"name": name, "parameterTypeRef": of, "shortDescription": meaning}
        Tree.SubElement(parameters, "Parameter", attributes)


def _containers(containers: Tree.Element, kinds: list[Kind], apids: Mapping[int, int]) -> None:
    root = Tree.SubElement(containers, "SequenceContainer", {"name": ROOT, "abstract": "true"})
    entries = Tree.SubElement(root, "EntryList")
    for name, _, _ in _HEADER:
        Tree.SubElement(entries, "ParameterRefEntry", {"parameterRef": name})
    for kind in kinds:
        says = (kind.record.__doc__ or "").partition("\n")[0]
        container = Tree.SubElement(
            containers, "SequenceContainer", {"name": kind.name, "shortDescription": says.replace("``", "")}
        )
        entries = Tree.SubElement(container, "EntryList")
        for name, _, _ in _entries(kind):
            Tree.SubElement(entries, "ParameterRefEntry", {"parameterRef": name})
        base = Tree.SubElement(container, "BaseContainer", {"containerRef": ROOT})
        criteria = Tree.SubElement(base, "RestrictionCriteria")
        Tree.SubElement(criteria, "Comparison", {"parameterRef": "PKT_APID", "value": str(apids[kind.code])})
