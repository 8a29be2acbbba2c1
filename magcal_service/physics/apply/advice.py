"""What each reason against acting on a diagnosis means, and what would lift it: as it is made, and as it is read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

DO_NOT: Final = "do not act on this"
"""What stands before the reasons, wherever they are said."""

RECORDING: Final = "recording_doubtful"
"""The reason that comes before all others: what else is wrong may be no more than its consequence."""

REASONS: Final[Mapping[str, tuple[str, str]]] = {
    RECORDING: (
        "what was found on the recording itself has to be answered before any physics is named",
        "answer each open finding of magcal inspect: mend the file, or accept it in [inspect]",
    ),
    "collapsed": (
        "the nine errors ended at values that no sensor has",
        "check units, axes and reference with magcal inspect; record over more attitudes",
    ),
    "poor_coverage": (
        "the field did not point in enough directions to fix the nine errors",
        "record over more attitudes: at least a turn about two axes, or most of an orbit",
    ),
    "unexplained_structure": (
        "a mismatch is left for which no name is borne out",
        "record more telemetry beside the magnetometer, and switch one suspect at a time",
    ),
    "mismatch_lasts": (
        "beside what was named, too much of the mismatch still lasts from sample to sample, or could last unseen: the"
        " cause resembles the name, but may be another one",
        "record what drives it, where it is not recorded yet; see in the report where the rest sits, and record longer"
        " where it is faint",
    ),
    "not_converged": (
        "the fit did not arrive at a solution; its numbers are where it stopped",
        "record longer or over more attitudes, or give the sensor's noise as noise_nt",
    ),
    "name_uncertain": (
        "less than 95 % speak for a name: other names, or a cause in no catalogue, have the rest",
        "make a measurement that tells the names apart: magcal diagnose lists them for each name (next time, what would"
        " tell), and report.html (What to measure next)",
    ),
    "size_uncertain": (
        "no number of an effect is three times its own sigma, or one ended where the search did: it is there, but"
        " nobody can say how large",
        "record longer, or record what drives it, where it is not recorded yet",
    ),
    "rough_residual": (
        "what changes from one sample to the next is larger than any sensor's noise",
        "state noise_nt; look for repeated or misplaced rows with magcal inspect",
    ),
    "noisier_than_stated": (
        "more is left than the noise that was stated: the sensor is noisier, or something as quick as noise disturbs"
        " it, such as a tone far above the sampling rate",
        "state the noise that the sensor has on board; switch wheels, converters and transmitters off one by one",
    ),
    "field_model_doubtful": (
        "the reference seems to err by clearly more than a field model does, smoothly along the orbit, which other"
        " slow causes do as well: names and nine errors may hold a part of it",
        "check coefficients, places and frames of the reference; record whole orbits",
    ),
    "reference_far_off": (
        "with the recorded attitude the vectors agree only with a reference that is off by more than a building or the"
        " crust makes it: it is wrong, and all gains with it, or the attitude is in other axes",
        "check the reference's frame and place and the attitude's axes; measure the field there with another sensor",
    ),
    "gain_in_scatter": (
        "what the effects gain on held-out blocks does not stand out of its scatter",
        "record longer: twice the blocks halve the variance of the gain",
    ),
    "not_predicted": (
        "a recording is not predicted by the numbers of the others: what was named is not common to them",
        "see which recording and which effect it is; diagnose that recording alone",
    ),
    "not_enough_data": ("too few samples for held-out blocks", "record longer: 300 samples at least"),
}
"""What each reason against trusting a result means, and what would lift it."""


def reason_in_words(reason: str) -> str:
    """A reason as a clause; one that is new here by its own name."""
    return REASONS[reason][0] if reason in REASONS else reason.replace("_", " ")


def remedy(reason: str) -> str:
    """What would lift a reason; empty for one that is new here."""
    return REASONS[reason][1] if reason in REASONS else ""


def advice(reasons: Sequence[str], concerned: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
    """Every reason against acting on a result: what it means, what would lift it, and the effects it is about."""
    return [
        {
            "reason": reason,
            "means": reason_in_words(reason),
            "remedy": remedy(reason),
            "effects": list(concerned.get(reason, ())),
        }
        for reason in reasons
    ]


def in_order(against: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Of ``advice`` what is shown: while the recording has to be answered for, that, and the other reasons by name."""
    doubtful, others = [one for one in against if one["reason"] == RECORDING], [*against]
    if not doubtful or len(against) == 1:
        return others
    names = ", ".join(one["reason"] for one in against if one["reason"] != RECORDING)
    return [*doubtful, {"reason": names, "means": "may follow from that", "remedy": "", "effects": []}]


def in_line(one: Mapping[str, Any]) -> str:
    """An entry of ``advice`` in a line: the reason, the effects it is about, what it means, and what would lift it."""
    about = f" ({', '.join(one['effects'])})" if one["effects"] else ""
    lift = f"; {one['remedy']}" if one["remedy"] else ""
    return f"{one['reason']}{about}: {one['means']}{lift}"


def doubts_of(doubts: str) -> list[str]:
    """``doubts`` of a ``physics.toml`` as its diagnosis said them, a line each; none where it has none."""
    names = [name.strip() for name in doubts.split(",") if name.strip()]
    return [f"{DO_NOT}: {in_line(one)}" for one in in_order(advice(names, {}))]
