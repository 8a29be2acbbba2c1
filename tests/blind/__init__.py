"""Concealed cases: recordings in which one thing is wrong, made from causes, with the answer kept apart.

>>> from tests.blind import draw_case, write_case
>>> case = draw_case(7, "thermal_bias", driver_recorded=False)  # doctest: +SKIP
>>> write_case(case, "cases/0007")  # doctest: +SKIP

Nothing here knows how a disturbance is looked for, and nothing that looks for one is imported here; README.md says
what is simulated and in which conventions the answers are given.
"""

from tests.blind.case import Answer, Case, EffectTruth
from tests.blind.catalogue import DRIVEN, EFFECTS, KINDS, OUTSIDE, PAIRS
from tests.blind.draw import draw_case
from tests.blind.recording import seal_answer, write_case

__all__ = [
    "DRIVEN",
    "EFFECTS",
    "KINDS",
    "OUTSIDE",
    "PAIRS",
    "Answer",
    "Case",
    "EffectTruth",
    "draw_case",
    "seal_answer",
    "write_case",
]
