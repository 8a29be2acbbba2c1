"""Protection levels: what a hazard too small to be seen does to a vector is what the level says."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from magcal_service.config.settings import CraftConfig, FilterConfig, SensorConfig, SpinConfig, TrustConfig
from magcal_service.estimators.ekf import Ekf
from magcal_service.estimators.interface import Phase
from magcal_service.estimators.ukf import Ukf
from magcal_service.model import calibrate, d_matrix, field_jacobian
from magcal_service.residuals import log_tail
from magcal_service.ticks.assembler import Tick
from magcal_service.trust import hazard_sums as sums
from magcal_service.trust import hazards
from magcal_service.trust.hazard_look import ALARM_NATS, Accumulated, _raised
from magcal_service.trust.hazards import REMEDY, Hazard
from magcal_service.trust.modes import MODES, Mode
from magcal_service.trust.monitor import TrustMonitor
from magcal_service.trust.protection import MISSED_SIGMA, alarm_gain, smallest_seen, worst
from magcal_service.trust.reasons import Reason
from magcal_service.wire.messages import Verdict
from tests.trust.trust_runs import TRUTH, Ticks, good

NOISE_NT = 100.0
SECONDS = 2000
SIDE = np.array([0.6, -0.48, 0.64])
MATRIX = np.eye(3) + d_matrix(TRUTH)


def craft(filter_: FilterConfig | None = None, **trust: object) -> CraftConfig:
    """The paper's craft at 100 nT."""
    settings = TrustConfig(**trust)  # type: ignore[arg-type]
    return CraftConfig("paper", SensorConfig(NOISE_NT), SpinConfig(), filter_ or FilterConfig(), trust=settings)


def clean() -> Ticks:
    return good(1, SECONDS, noise_nt=NOISE_NT)


def late(by_s: float) -> Iterator[Tick]:
    """The reference is that of so long before."""
    magnitude = np.array([tick.reference_magnitude_nt[0] for tick in clean()])
    slope = np.gradient(magnitude)
    for tick, behind in zip(clean(), by_s * slope, strict=True):
        yield replace(tick, reference_magnitude_nt=tick.reference_magnitude_nt - behind)


def disturbed(field_nt: Callable[[float], np.ndarray]) -> Iterator[Tick]:
    """A body field that goes with time [s] is added to what is true."""
    for tick in clean():
        added = np.linalg.solve(MATRIX, field_nt(float(tick.times_s[0])))
        yield replace(tick, field_body_nt=tick.field_body_nt + added)


def flown(ticks: Iterable[Tick], config: CraftConfig | None = None) -> tuple[TrustMonitor, np.ndarray]:
    """The monitor after the ticks, and the nine errors."""
    config = config or craft()
    ukf, monitor = Ukf(config), TrustMonitor(config)
    for tick in ticks:
        monitor.observe(tick, ukf.handle(tick), ukf.estimate())
        if tick.index > 1800 and monitor.protector.level is not None and not monitor.protector._rows:
            break  # it has just been looked at
    return monitor, ukf.estimate().x


@cache
def unspoiled() -> tuple[TrustMonitor, np.ndarray]:
    return flown(clean(), craft(disturbance_nt=1.0))


@pytest.mark.parametrize("columns", [1, 3, 6])
def test_the_alarm_is_where_chance_is_as_small_as_told(columns: int) -> None:
    assert -log_tail(2.0 * alarm_gain(20.0, columns), columns) == pytest.approx(20.0, rel=1e-6)
    many = smallest_seen(20.0, columns, 10**9)
    assert many == pytest.approx((math.sqrt(2.0 * alarm_gain(20.0, columns)) + MISSED_SIGMA) ** 2, rel=1e-4)
    assert smallest_seen(20.0, columns, 100) > 1.1 * many


def test_the_level_is_that_of_the_hazard_with_the_largest_of_its_own() -> None:
    monitor, _ = unspoiled()
    look, level = monitor.protector.looked(), monitor.protector.level
    assert look is not None
    assert level is not None
    assert set(look.levels) == set(Hazard)
    assert level.nt == look.levels[level.by].max() == max(levels.max() for levels in look.levels.values())
    assert look.ages.shape == look.levels[Hazard.BIAS_STEP].shape
    assert (np.diff(look.ages) < 0.0).all()


def test_a_level_holds_every_amplitude_that_is_unseen_and_possible_and_little_more() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        root = rng.normal(size=(3, 3)) * np.array([3.0, 1.0, 0.1])
        seen, effect = root.T @ root, rng.normal(size=(1, 4, 3, 3))
        (level,) = worst(seen[None], 9.0, np.array([4.0]), effect)
        amplitudes = rng.normal(size=(20_000, 3))
        scale = np.maximum(np.linalg.norm(amplitudes, axis=1) / 4.0, np.linalg.norm(amplitudes @ root.T, axis=1) / 3.0)
        off = np.linalg.norm(np.einsum("mij,nj->nmi", effect[0], amplitudes / scale[:, None]), axis=-1).max()
        assert 0.98 * off < level < 1.45 * off


def test_the_response_is_what_the_filter_does() -> None:
    """Two flights with the same noise, with a hazard and without: their estimates differ by the response."""
    monitor, x = unspoiled()
    wave = 2.0 * math.pi / sums.ORBIT_S
    cases = (
        (late(0.5), {sums.LATE: 0.5}, -1.0),
        (disturbed(lambda t: SIDE * 0.02 * t), dict(zip(sums.DRIFT, SIDE * 0.02 * sums.DRIFT_S, strict=True)), 1.0),
        (
            disturbed(lambda t: 60.0 * SIDE * math.sin(wave * t)),
            dict(zip(sums.ORBIT_BIAS[3:], 60.0 * SIDE, strict=True)),
            1.0,
        ),
    )
    for ticks, amplitudes, sign in cases:
        _, spoiled = flown(ticks)
        columns = np.array(list(amplitudes)) - 9
        told = sign * monitor.protector._response[:, columns] @ np.array(list(amplitudes.values()))
        moved = (spoiled - x) / sums.UNIT
        assert np.linalg.norm(moved - told) < 0.12 * np.linalg.norm(moved), (amplitudes, moved, told)


def test_the_level_is_the_error_of_the_smallest_late_reference_that_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hazards, "DRIFT_NT_PER_H", 1e-3)
    monitor, x = flown(clean(), craft(disturbance_nt=1.0))
    protector, level = monitor.protector, monitor.protector.level
    assert level is not None
    assert level.by is Hazard.REFERENCE_LATE
    total = protector._sums
    fitted = np.linalg.solve(total[:9, :9], total[:9, [sums.LATE, sums.RESIDUAL]])
    left = total[sums.LATE, sums.LATE] - total[sums.LATE, :9] @ fitted[:, 0]
    noise = (total[-1, -1] - total[-1, :9] @ fitted[:, 1]) / (protector._used - 9)
    smallest_s = math.sqrt(smallest_seen(ALARM_NATS, 1, protector._used - 9) * noise / left)
    _, spoiled = flown(late(smallest_s))
    field = np.array(protector._directions)[:, 1:4]
    off = np.linalg.norm(calibrate(spoiled, field) - calibrate(x, field), axis=1).max()
    assert off == pytest.approx(level.nt, rel=0.1)


def test_a_late_reference_is_not_trusted_where_it_is_wrong_beyond_the_level() -> None:
    """100 nT, 10 s late: without a level it is trusted from 600 s on, hundreds of nT off."""
    ukf, monitor, told = Ukf(craft()), TrustMonitor(craft()), []
    for tick in late(10.0):
        monitor.observe(tick, ukf.handle(tick), ukf.estimate())
        if not 900 <= tick.index <= 1800:
            continue
        trust, x = monitor.judge(ukf.estimate()), ukf.estimate().x
        off = float(np.linalg.norm(field_jacobian(tick.field_body_nt[0]) @ (x - TRUTH)))
        told.append((off, trust))
    assert max(off for off, _ in told) > 100.0
    assert all(off < (trust.protection_nt or 0.0) for off, trust in told if trust.verdict is Verdict.TRUSTED)
    assert {Verdict.TRUSTED} != {trust.verdict for _, trust in told}
    assert sum(Reason.UNPROTECTED in trust.reasons for _, trust in told) > 100


def test_a_step_that_has_just_occurred_is_always_allowed_for() -> None:
    monitor, _ = flown(clean(), craft(disturbance_nt=2000.0))
    level = monitor.protector.level
    assert level is not None
    assert level.nt >= 2000.0


@pytest.mark.parametrize("bias_nt", [0.0, 60_000.0])
def test_a_new_gain_puts_no_vector_further_off_than_a_new_bias_may(bias_nt: float) -> None:
    """It changes all that is read, the bias as well: as large as changes the largest reading by disturbance_nt."""
    monitor, _ = flown(disturbed(lambda _: SIDE * bias_nt), craft(disturbance_nt=50.0))
    look = monitor.protector.looked()
    assert look is not None
    recent = look.levels[Hazard.GAIN_STEP].reshape(-1, 3)[look.ages < hazards.STEP_SEEN_TICKS]
    assert 15.0 < recent.max() < 50.0


def test_what_is_asked_for_and_not_reached_is_a_reason_whose_remedy_is_the_hazards() -> None:
    config = craft(protection_nt=100.0)
    ukf, monitor = Ukf(config), TrustMonitor(config)
    for tick in clean():
        monitor.observe(tick, ukf.handle(tick), ukf.estimate())
    trust = monitor.judge(ukf.estimate())
    row = MODES[Mode.UNPROTECTED]
    assert (trust.verdict, trust.reasons) == (row.verdict, (row.reason,)) == (Verdict.CONVERGING, (Reason.UNPROTECTED,))
    assert trust.remedy == REMEDY[Hazard(str(trust.protection_by))]
    assert trust.protection_nt is not None
    assert trust.protection == f", protected to {trust.protection_nt:.0f} nT ({trust.protection_by})"


@pytest.mark.parametrize(
    ("config", "why"),
    [
        (craft(protection=False), "protection = false"),
        (craft(watch=False), "watch = false"),
        (craft(FilterConfig(process_noise_bias_nt=(0.1, 0.1, 0.1))), "process noise"),
        (craft(FilterConfig(adaptive=True)), "adaptive"),
    ],
)
def test_where_no_level_can_be_given_none_is_asked_for_and_it_is_said_why(config: CraftConfig, why: str) -> None:
    ukf, monitor = Ukf(config), TrustMonitor(config)
    for tick in clean()[:700]:
        monitor.observe(tick, ukf.handle(tick), ukf.estimate())
    trust = monitor.judge(ukf.estimate())
    assert monitor.protector.level is None
    assert Reason.UNPROTECTED not in trust.reasons
    assert trust.protection == f", no protection level ({why})"


def test_of_a_method_that_weighs_otherwise_no_response_is_known() -> None:
    estimate = Ekf(craft()).estimate()
    assert not estimate.is_least_squares
    trust = TrustMonitor(craft()).judge(replace(estimate, phase=Phase.RUNNING))
    assert trust.no_level == "its method"


def test_before_the_start_nothing_is_said_of_a_level() -> None:
    assert TrustMonitor(craft()).judge(Ukf(craft()).estimate()).protection == ""


def test_who_has_not_seen_the_start_gives_no_level_and_says_what_brings_one() -> None:
    ukf, monitor = Ukf(craft()), TrustMonitor(craft())
    for tick in clean():
        outcome = ukf.handle(tick)
        if tick.index > 1000:
            monitor.observe(tick, outcome, ukf.estimate())
    trust = monitor.judge(ukf.estimate())
    assert monitor.protector.level is None
    assert trust.reasons == (Reason.UNPROTECTED,)
    assert trust.no_level == "until the filter's next start"
    assert trust.remedy.endswith("reset, or set protection = false")


@pytest.mark.parametrize(("pause_s", "known"), [(320, True), (321, False)])
def test_after_a_long_pause_the_level_is_unknown_until_the_next_look(pause_s: int, known: bool) -> None:
    """What began meanwhile has not been looked for; the look is at the 64 ticks after the pause."""
    ukf, monitor, last = Ukf(craft()), TrustMonitor(craft()), 1400 + pause_s
    levels: dict[int, bool] = {}
    for tick in clean():
        if not 1400 < tick.index < last:
            monitor.observe(tick, ukf.handle(tick), ukf.estimate())
            levels[tick.index] = monitor.protector.level is not None
    assert levels[1400]
    assert [levels[last + after] for after in (0, 62)] == [known, known]
    assert levels[last + 63]


def test_what_it_remembers_goes_on_to_the_last_bit() -> None:
    config = craft()
    ukf, monitor, again = Ukf(config), TrustMonitor(config), None
    for tick in clean():
        outcome = ukf.handle(tick)
        monitor.observe(tick, outcome, ukf.estimate())
        if again is not None:
            again.observe(tick, outcome, ukf.estimate())
        if tick.index == 1333:
            again = TrustMonitor(config)
            again.restore_state(monitor.export_state())
    assert again is not None
    assert again.export_state() == monitor.export_state()


@pytest.mark.parametrize(
    ("correlation", "factor"),
    [(0.03, 1.0), (0.05, 1.05 / 0.95), (0.5, 3.0), (0.9, 19.0), (0.999, 199.9)],
)
def test_noise_with_a_memory_raises_what_is_slow(correlation: float, factor: float) -> None:
    """(1 + r) / (1 - r), bounded; up to four sigma of 10 000 samples, 0.04, a correlation is chance."""
    none = np.zeros(0)
    data = Accumulated(none, 10_000, (), (), (), none, none, (7.0 * correlation, 7.0), 0.0)
    assert _raised(data) == pytest.approx(factor)
