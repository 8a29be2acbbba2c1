"""What no log tells: whose it is, where it was made, and what the sensor's data sheet says."""

from __future__ import annotations

import math
from typing import Final

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.base.typed_toml import nearest
from magcal_service.config.rules import RANGE_NT
from magcal_service.recordings.describe.draft import Draft
from magcal_service.recordings.specs import NOISE_NT, PlatformKind

_WHAT = {
    "samples.craft": ("whose it is", "NAME"),
    "platform.kind": ("where it was made", "orbit|ground|air|bench"),
    "magnetometer.noise_nt": ("the sensor's noise, 1 sigma per axis", "NT"),
    "magnetometer.range_nt": ("its range", "NT"),
}
"""What may be answered without a question, with what an answer looks like."""

_NUMBERS: Final = {"magnetometer.noise_nt": NOISE_NT, "magnetometer.range_nt": RANGE_NT}
"""What each number may be, from and to [nT]."""

_MEANT: Final = {
    PlatformKind.ORBIT: ("space", "satellite", "cubesat", "spacecraft", "leo", "geo", "flight"),
    PlatformKind.AIR: ("aircraft", "aeroplane", "plane", "drone", "uav", "helicopter", "balloon", "sky"),
    PlatformKind.GROUND: ("earth", "land", "outdoors", "outside", "car", "vehicle", "ship", "sea", "water", "walk"),
    PlatformKind.BENCH: ("lab", "laboratory", "table", "turntable", "coil", "helmholtz", "room", "indoors", "desk"),
}
"""Other words for where a recording was made."""


def tell(draft: Draft) -> None:
    """Take up what was answered of it, and say how the rest is stated."""
    open_ = []
    for key, (what, form) in _WHAT.items():
        answer = draft.answers.get(key)
        if answer is None:
            open_.append(f"{what} (--answer {key}={form})")
            continue
        value = _number(key, answer) if key in _NUMBERS else answer
        if key == "platform.kind":
            _refuse_kind(key, answer)
        section, name = key.split(".")
        for one in _sections(draft, section):
            draft.put(one, name, value)
    if open_:
        draft.said.append(f"no log tells, and it may be stated: {', '.join(open_)}")


def _sections(draft: Draft, name: str) -> list[str]:
    """A section of the draft; of several magnetometers, that of each."""
    each = [section for section in draft.sections if section.startswith(f"[{name}]")]
    return each or [name]


def _refuse_kind(key: str, answer: str) -> None:
    """Raise ``InputRefusedError`` for a place that is none, with the one that is probably meant."""
    if answer in [*PlatformKind]:
        return
    meant = next((kind for kind, words in _MEANT.items() if answer.lower() in words), answer)
    raise InputRefusedError([Fault(f"--answer {key}", answer, nearest(meant, PlatformKind))])


def _number(key: str, answer: str) -> float:
    low, high = _NUMBERS[key]
    try:
        value = float(answer)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        accepted = f"a number of nT is accepted, from {low:g} to {high:g}"
        raise InputRefusedError([Fault(f"--answer {key}", answer, accepted)])
    return value
