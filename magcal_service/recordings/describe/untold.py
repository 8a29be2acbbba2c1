"""What no log tells: whose it is, where it was made, and what the sensor's data sheet says."""

from __future__ import annotations

from magcal_service.base.errors import Fault, InputRefusedError
from magcal_service.recordings.describe.draft import Draft

_WHAT = {
    "samples.craft": ("whose it is", "NAME"),
    "platform.kind": ("where it was made", "orbit|ground|air|bench"),
    "magnetometer.noise_nt": ("the sensor's noise, 1 sigma per axis", "NT"),
    "magnetometer.range_nt": ("its range", "NT"),
}
"""What may be answered without a question, with what an answer looks like."""

_NUMBERS = ("magnetometer.noise_nt", "magnetometer.range_nt")


def tell(draft: Draft) -> None:
    """Take up what was answered of it, and say how the rest is stated."""
    open_ = []
    for key, (what, form) in _WHAT.items():
        answer = draft.answers.get(key)
        if answer is None:
            open_.append(f"{what} (--answer {key}={form})")
            continue
        value = _number(key, answer) if key in _NUMBERS else answer
        section, name = key.split(".")
        for one in _sections(draft, section):
            draft.put(one, name, value)
    if open_:
        draft.said.append(f"no log tells, and it may be stated: {', '.join(open_)}")


def _sections(draft: Draft, name: str) -> list[str]:
    """A section of the draft; of several magnetometers, that of each."""
    each = [section for section in draft.sections if section.startswith(f"[{name}]")]
    return each or [name]


def _number(key: str, answer: str) -> float:
    try:
        return float(answer)
    except ValueError:
        accepted = "a number of nT is accepted"
        raise InputRefusedError([Fault(f"--answer {key}", answer, accepted)]) from None
