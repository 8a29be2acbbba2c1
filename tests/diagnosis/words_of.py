"""As much of a diagnosis as words are made of."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from magcal_service.diagnosis.diagnose import Verdict
from magcal_service.diagnosis.misled import Misled
from magcal_service.diagnosis.words import percent
from magcal_service.physics.held import HeldAt
from magcal_service.recordings.inspect.account import Account

HELD_OUT = {"simulation": 950.04, "recalibrated": 410.26, "with_effects": 101.48}
TITLES = {"a": "heat", "b": "currents", "c": "a step", "d": "a tone"}


def diagnosis(
    verdict: Verdict,
    *,
    terms: int = 0,
    unexplained: float = 0.0,
    lasting: float = 0.0,
    reasons: tuple[str, ...] = (),
    doubts: str = "",
    held: tuple[HeldAt, ...] = (),
) -> Any:
    """As much of a diagnosis as words are made of: a bias that moved by 3, 4 and 12 nT."""
    before = np.array([10.0, 20.0, 30.0, *[0.0] * 6])
    return SimpleNamespace(
        verdict=verdict,
        unexplained=unexplained,
        left_share=max(unexplained, lasting),
        reasons=reasons,
        may_last=0.26,
        noise_nt=100.04,
        added_noise_nt=0.0,
        memory_nt=None,
        has_simulation=True,
        held_at=held,
        misled=Misled(14.04, 0.52, 20.06, 1234.0, 397.5),
        concerned={reason: ("heat",) for reason in reasons if reason == "name_uncertain"},
        inspection=SimpleNamespace(open=tuple(doubts), findings=(), account_to_diagnose=Account(10, {"defect": 1})),
        effects=[SimpleNamespace(name=name, title=title) for name, title in TITLES.items()],
        fit=SimpleNamespace(
            terms=(None,) * terms,
            x=before + np.array([3.0, -4.0, 12.0, *[0.0] * 6]),
            covariance=0.25 * np.eye(9),
            problem=SimpleNamespace(aimed=None, field_error=None),
        ),
        refused=(),
        modelled=None,
        made_where=[],
        prepared=SimpleNamespace(
            sun=None,
            view=SimpleNamespace(stated_noise_nt=100.04),
            baseline=SimpleNamespace(x=before),
            left_out={"spikes": 2},
        ),
    )


def entry(
    effect: str, *members: str, share: float = 0.5, says: str = "It is hot.", probability: float = 0.99, rms: Any = None
) -> Any:
    rest = (1.0 - probability) / max(len(members), 1)
    return SimpleNamespace(
        effect=effect,
        says=says,
        where={"share_of_mismatch": share} | ({} if rms is None else {"rms_nt": rms}),
        probability=probability,
        rivals=tuple((name, rest) for name in members),
        nats=12.0,
        members=(effect, *members),
        separated_by="a heater test",
        record_next="",
        measure=(),
        drivers=(),
        extent=f"{percent(share)} of the mismatch",
        unlisted="",
        as_well=(),
        why_first="",
    )
