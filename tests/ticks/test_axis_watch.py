"""When one axis counts as standing still: every limit from both sides."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from magcal_service.ticks.axis_watch import AxisWatch

SECOND_NS = 1_000_000_000
Vector = tuple[float, float, float]


def placed(axis: int, still: float, moving: float, third: float) -> Vector:
    """A vector whose component ``axis`` stands still while the next one moves."""
    field = [0.0, 0.0, 0.0]
    field[axis], field[(axis + 1) % 3], field[(axis + 2) % 3] = still, moving, third
    return (field[0], field[1], field[2])


def first_refused(watch: AxisWatch, fields: Sequence[Vector], step_s: float = 1.0, start_s: float = 7.0) -> int | None:
    """Number of the first vector that is called still, None where none is."""
    for number, field in enumerate(fields):
        if watch.stands_still(round((start_s + step_s * number) * SECOND_NS), field):
            return number
    return None


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("step_s", "longest_s", "refused"),
    [(1.0, 60.0, 60), (1.0, 59.0, 59), (1.0, 58.0, 59), (2.0, 60.0, 59), (0.5, 60.0, 120), (0.5, 60.5, 121)],
)
def test_a_coarse_axis_needs_60_values_and_the_configured_time(
    axis: int, step_s: float, longest_s: float, refused: int
) -> None:
    """The value before the run was another one, and the run begins with its first value."""
    watch = AxisWatch(round(longest_s * SECOND_NS), 4, None)
    fields = [placed(axis, 900.0, 10.0 * number, 30.0) for number in range(200)]
    assert first_refused(watch, fields, step_s) == refused


def test_an_axis_that_is_zero_from_the_first_sample_on_counts_from_there() -> None:
    fields = [(0.0, 50.0 * number, 1000.0) for number in range(100)]
    assert first_refused(AxisWatch(10 * SECOND_NS, 4, None), fields, start_s=0.0) == 59
    assert first_refused(AxisWatch(90 * SECOND_NS, 4, None), fields, start_s=0.0) == 90


@pytest.mark.parametrize("still", [0.0, 40.0])
def test_an_axis_is_not_stuck_while_the_others_stand_still_too(still: float) -> None:
    """A coarse sensor on a craft that holds its attitude; 0 is a value like another."""
    fields = [(still, 30_000.0, -20_000.0 + (number % 2)) for number in range(200)]
    assert first_refused(AxisWatch(60 * SECOND_NS, 4, None), fields, start_s=0.0) is None


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("moved_nt", "stuck"), [(200.0, True), (199.9, False)])
@pytest.mark.parametrize("largest", ["still", "third"])
def test_another_component_has_to_move_by_a_fifth_of_the_largest(
    sign: float, moved_nt: float, stuck: bool, largest: str
) -> None:
    """To and fro: at the end it is back where it was."""
    still, third = (1000.0, 17.0) if largest == "still" else (17.0, 1000.0)
    moving = [0.0] * 30 + [moved_nt] * 10 + [0.0] * 60
    fields = [placed(1, sign * still, sign * value, sign * third) for value in moving]
    assert (first_refused(AxisWatch(60 * SECOND_NS, 4, None), fields) is not None) is stuck


@pytest.mark.parametrize("other", [1, 2])
def test_each_of_the_other_components_counts(other: int) -> None:
    fields = [(900.0, *(5.0 * number if axis == other else 0.5 for axis in (1, 2))) for number in range(100)]
    assert first_refused(AxisWatch(60 * SECOND_NS, 4, None), fields) == 60  # type: ignore[arg-type]


def test_what_moved_before_the_axis_took_its_value_does_not_count() -> None:
    fields = [(1.0 + number, 900.0 * (number % 2), -900.0 * (number % 2)) for number in range(20)]
    fields += [(1000.0, 450.0 + number % 2, -450.0 - number % 2) for number in range(200)]
    assert first_refused(AxisWatch(60 * SECOND_NS, 4, None), fields) is None


def test_an_axis_that_changes_is_believed_at_once_and_counted_anew() -> None:
    watch = AxisWatch(60 * SECOND_NS, 4, None)
    still = [(900.0, 10.0 * number, 5.0 * number) for number in range(80)]
    assert first_refused(watch, still) == 60
    assert not watch.stands_still(100 * SECOND_NS, (901.0, 0.5, 0.5))
    assert first_refused(watch, [(901.0, 10.0 * n, 5.0 * n) for n in range(1, 100)], start_s=101.0) == 59


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("values", "refused"),
    [
        ((100.0, 101.9), 4),  # closer than a fifth of the noise: the fourth of the same value is a fault
        ((101.9, 100.0), 4),
        ((100.0, 102.0), None),
        ((100.0, 110.0, 100.0), None),  # the same value again says nothing of the resolution
        ((100.0, 150.0, 101.9), 5),  # not only neighbours are compared
    ],
)
def test_where_noise_would_have_changed_the_value_a_few_alike_are_a_fault(
    axis: int, values: tuple[float, ...], refused: int | None
) -> None:
    watch = AxisWatch(60 * SECOND_NS, 4, 10.0)
    fields = [placed(axis, value, 3e4, -3e4) for value in (*values, *[values[-1]] * 40)]
    assert first_refused(watch, fields) == refused


@pytest.mark.parametrize(("between", "refused"), [(63, 68), (64, None)])
def test_64_values_are_compared(between: int, refused: int | None) -> None:
    """The first and the last are close together; those between are far from all others."""
    watch = AxisWatch(60 * SECOND_NS, 4, 10.0)
    values = [0.5, *(100.0 * number for number in range(1, between + 1)), *[1.0] * 20]
    fields = [(value, 7.5, 8.5) for value in values]
    assert first_refused(watch, fields, step_s=0.01) == (None if refused is None else between + 4)


def test_without_a_known_noise_a_few_alike_are_no_fault() -> None:
    fields = [(value, 10.0, 20.0) for value in (100.0, 100.5, *[101.0] * 40)]
    assert first_refused(AxisWatch(60 * SECOND_NS, 4, None), fields) is None


def test_a_resolution_once_known_stays_known() -> None:
    watch = AxisWatch(60 * SECOND_NS, 4, 10.0)
    values = [100.0, 101.0, *(1000.0 * number for number in range(2, 90)), *[500.0] * 4]
    assert first_refused(watch, [(value, 7.5, 8.5) for value in values], step_s=0.01) == len(values) - 1


def test_the_values_that_are_remembered_are_bounded_and_go_with_the_question() -> None:
    watch = AxisWatch(60 * SECOND_NS, 4, 10.0)
    for number in range(1, 100):
        watch.stands_still(number * SECOND_NS, (100.0 * number, 100.0 * number, 0.0))
    assert list(map(len, watch.export_state()["_seen"])) == [64, 64, 1]
    watch.stands_still(100 * SECOND_NS, (9900.5, 0.0, 0.0))
    assert list(map(len, watch.export_state()["_seen"])) == [0, 64, 1]


def test_a_fresh_watch_has_nothing_in_its_memory() -> None:
    assert AxisWatch(60 * SECOND_NS, 4, 10.0).export_state() == {
        "_last": [0.0, 0.0, 0.0],
        "_count": [0, 0, 0],
        "_since_ns": [0, 0, 0],
        "_fine": [False, False, False],
        "_seen": [[], [], []],
        "_low": [[], [], []],
        "_high": [[], [], []],
    }
