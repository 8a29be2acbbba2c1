"""What a page shows, from messages: numbers, who is who, and what is never said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from magcal_service.trust.reasons import REMEDIES, Reason
from magcal_service.views.feed import Feed
from magcal_service.views.field import ReferenceField
from magcal_service.views.result import Replayed, ellipsoid
from magcal_service.views.series import Recent, Whole
from magcal_service.views.spectrum import spectrum
from magcal_service.views.sphere import Sphere
from magcal_service.views.state import Views
from magcal_service.views.words import Finding, event_of, finding_of
from magcal_service.wire.messages import MagnetometerSample, ReferenceSample, Verdict
from tests.views.view_messages import BIAS_NT, FIELD_NT, direction, estimate, second_of, status

DOUBT = "model doubtful: thermal_bias (channel temperature), 34 nats; 2 axes; run: magcal diagnose RECORDING; trusted"


def heard(seconds: int, views: Views | None = None, **kind: object) -> Views:
    """What has been heard after so many seconds of one craft."""
    views = views or Views()
    for second in range(seconds):
        for message in second_of(second, **kind):  # type: ignore[arg-type]
            views.take(message, float(second))
    return views


def test_a_row_has_the_field_before_and_after_the_reference_and_the_residual() -> None:
    rows = Feed().update(heard(3, ripple_nt=50.0), 3.0)["recent"]["rows"]
    x, y, z = direction(1)
    before = math.hypot(x + BIAS_NT[0], y, z)
    assert rows[1] == pytest.approx((1.0, round(before, 1), FIELD_NT - 50.0, FIELD_NT, -50.0), abs=1e-9)


def test_before_there_is_an_estimate_nothing_counts_as_calibrated() -> None:
    update = Feed().update(heard(3, verdict=Verdict.NOT_STARTED), 3.0)
    row = update["recent"]["rows"][1]
    assert {cell[3:] for cell in update["cells"].values()} == {(None, None, None)}
    assert row[1] is not None
    assert row[2:] == (None, FIELD_NT, None)


def test_the_reference_is_interpolated_and_waited_for() -> None:
    views = Views()
    messages = [message for second in (0, 1, 2) for message in second_of(second)]
    for message in messages[:3] + messages[4:6]:  # the reference of second 1 is not heard
        views.take(message, 0.0)
    assert [row[0] for row in Feed().update(views, 0.0)["recent"]["rows"]] == [0.0]
    views.take(messages[6], 0.0)
    assert Feed().update(views, 0.0)["recent"]["rows"][1][3:] == (FIELD_NT, 0.0)


def test_between_two_references_the_field_is_a_straight_line_and_across_a_gap_there_is_none() -> None:
    reference = ReferenceField()
    for second, magnitude_nt in ((0, 100.0), (4, 200.0), (40, 300.0)):
        stamp = {"craft": "demo", "source": "igrf", "sequence": second, "time_ns": second * 10**9}
        reference.add(ReferenceSample(**stamp, field_nt=(0.6 * magnitude_nt, 0.0, -0.8 * magnitude_nt)))
    at = [reference.at(second * 10**9) for second in (0, 1, 4, 10, 41)]
    assert at == [100.0, pytest.approx(125.0), 200.0, None, None]


def test_a_reader_gets_each_row_and_cell_once() -> None:
    views, feed = heard(30), Feed()
    first = feed.update(views, 0.0)
    for message in second_of(30):
        views.take(message, 30.0)
    second = feed.update(views, 0.1)
    assert (first["recent"]["anew"], len(first["recent"]["rows"])) == (True, 30)
    assert (second["recent"]["anew"], [row[0] for row in second["recent"]["rows"]]) == (False, [30.0])
    assert len(second["cells"]) == 1
    assert "spectrum" not in second


@pytest.mark.parametrize("kind", [Recent, Whole])
@pytest.mark.parametrize("ask_every", [1, 3, 7, 50])
def test_what_a_reader_puts_together_is_what_is_kept(kind: type[Recent] | type[Whole], ask_every: int) -> None:
    series, mark, together = kind(8), None, list[object]()
    for number in range(101):
        series.add((float(number),))
        if number % ask_every == 0:
            anew, rows = series.since(mark)
            together, mark = (rows if anew else [*together, *rows]), series.mark
            assert together[-8:] == list(series.rows)[-8:]
    assert len(series.rows) <= 9


def test_the_spectrum_names_the_turn_and_shows_the_amplitude_of_a_line() -> None:
    time_s = np.arange(600.0)
    vectors = np.array([direction(int(second), 0.125) for second in time_s])
    found = spectrum(time_s.tolist(), (30.0 * np.sin(math.tau * 0.25 * time_s)).tolist(), vectors)
    assert found is not None
    peak = int(np.argmax(found.amplitude_nt))
    assert found.amplitude_nt[peak] == pytest.approx(30.0, rel=1e-3)
    assert found.frequency_hz[peak] == pytest.approx(0.25)
    assert found.turn_hz == pytest.approx(0.125)
    assert found.lines == [(pytest.approx(0.125), "turn"), (pytest.approx(0.25), "twice the turn")]


def test_noise_is_no_turn() -> None:
    draw = np.random.default_rng(4)
    found = spectrum(list(range(400)), draw.normal(size=400).tolist(), draw.normal(size=(400, 3)))
    assert found is not None
    assert found.turn_hz is None


def test_the_cells_are_equal_in_area_so_coverage_is_a_share_of_the_sphere() -> None:
    sphere, draw = Sphere(), np.random.default_rng(1)
    for one in draw.normal(size=(5000, 3)):
        if one[2] > 0.0:
            sphere.add(None, (one[0], one[1], one[2]), 1.0)
    assert sphere.coverage == 0.5


def test_the_ellipsoid_takes_the_reference_back_to_the_raw_sample() -> None:
    found = ellipsoid(estimate(1))
    assert found is not None
    raw = np.array(found["matrix"]).reshape(3, 3) @ (np.array(direction(7)) + found["bias_nt"])
    assert raw == pytest.approx(np.array(direction(7)) + BIAS_NT)


def test_each_magnetometer_of_a_craft_has_its_own_samples_and_results() -> None:
    views = heard(5, heard(4, source="mag"), source="mag2")
    views.take(estimate(4), 4.0)
    views.take(estimate(4, source="mag2", verdict=Verdict.DOUBTFUL), 4.0)
    views.take(estimate(4, craft="other"), 4.0)
    shown = {one["label"]: one["verdict"] for one in views.listed(5.0)}
    assert shown == {"demo": "trusted", "demo/mag2": "doubtful", "other": "trusted"}
    assert len(Feed("demo").update(views, 0.0)["recent"]["rows"]) == 4
    assert len(Feed("demo/mag2").update(views, 0.0)["recent"]["rows"]) == 5
    assert "recent" not in Feed("other").update(views, 0.0)


def test_nine_errors_are_shown_with_three_sigma() -> None:
    views = heard(1)
    views.take(estimate(1), 1.0)
    nine = Feed().update(views, 1.0)["result"]["nine"]
    assert nine[0] == ["bx", "3000.0", "6.0", "nT"]
    assert nine[8] == ["D23", "0.00000", "6.00000", "-"]


def test_each_reason_comes_with_what_to_do_and_the_first_in_the_daemon_s_own_words() -> None:
    views, said = heard(1), replace(estimate(1), reasons=("noise_misstated", "unprotected"), remedy="noise is 105 nT")
    views.take(said, 1.0)
    reasons = Feed().update(views, 1.0)["result"]["reasons"]
    assert reasons == [["noise_misstated", "noise is 105 nT"], ["unprotected", REMEDIES[Reason.UNPROTECTED]]]


def test_a_daemon_that_answers_without_vectors_and_one_that_is_silent_are_told_apart() -> None:
    views, feed = heard(20), Feed()
    for second in range(20, 40):
        views.take(status(second, "trusted"), float(second))
        for message in second_of(second):
            if isinstance(
                message, MagnetometerSample | ReferenceSample
            ):  # a node that goes on is no sign of the daemon
                views.take(message, second + 20.0)
    update = feed.update(views, 40.0)
    assert (update["list"][0]["is_stale"], update["vectors"]) == (False, {"age_s": 21.0, "is_stale": True})
    later = feed.update(views, 59.0)["list"][0]
    assert (later["age_s"], later["is_stale"]) == (20.0, True)


def test_invented_names_are_not_remembered_without_end() -> None:
    views = Views()
    for number in range(100):
        for message in second_of(0, f"craft{number}"):
            views.take(message, 0.0)
        for message in second_of(number, "craft0", source=f"mag{number}"):
            views.take(message, 0.0)
    assert len(views.crafts) == 64
    assert len(views.crafts["craft0"].fields) == 8


def test_a_finding_comes_with_its_command() -> None:
    said = "thermal_bias (channel temperature), 34 nats; 2 axes"
    assert finding_of(DOUBT) == Finding(said, "magcal diagnose RECORDING")
    assert finding_of(DOUBT, "my log.toml") == Finding(said, "magcal diagnose 'my log.toml'")
    assert finding_of("trusted, 9 ticks") is None
    assert event_of("trusted; last event: reset (by hand; by me)") == "reset (by hand; by me)"


def test_a_recording_with_an_open_defect_is_never_shown_as_trusted_nor_its_physics_named() -> None:
    views = heard(1, Views({"demo": Replayed("log.toml", ("axes y and z are swapped",))}))
    views.take(estimate(1), 1.0)
    views.take(status(1, DOUBT), 1.0)
    update = Feed().update(views, 1.0)
    result = update["result"]
    assert (result["verdict"], result["finding"]) == ("doubtful", None)
    assert result["reasons"] == [["recording_doubtful", REMEDIES[Reason.RECORDING_DOUBTFUL]]]
    assert result["defects"] == ["axes y and z are swapped"]
    assert update["list"][0]["verdict"] == "doubtful"


def test_time_that_goes_back_begins_anew() -> None:
    views = heard(300)
    for message in second_of(3):
        views.take(message, 300.0)
    assert [row[0] for row in Feed().update(views, 0.0)["recent"]["rows"]] == []
    for message in second_of(4):
        views.take(message, 301.0)
    assert [row[0] for row in Feed().update(views, 0.0)["recent"]["rows"]] == [0.0, 1.0]


def test_events_are_changes_not_repetitions() -> None:
    views = heard(1)
    for second, verdict in enumerate((Verdict.CONVERGING, Verdict.TRUSTED, Verdict.TRUSTED)):
        views.take(estimate(second, verdict=verdict), 1.0)
        views.take(status(second, "trusted; last event: started (by itself)"), 1.0)
    events = [text for _, text in Feed().update(views, 1.0)["result"]["events"]]
    assert events == ["verdict trusted", "started (by itself)", "verdict converging"]
