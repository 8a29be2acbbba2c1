"""Figures show the numbers of what they are made of, and files that cannot be shown are refused in a line."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import magcal_service as magcal
from magcal_service.base.errors import InputRefusedError
from magcal_service.offline.given import read_given
from magcal_service.physics.apply.model_file import ModelTerm, text_of
from magcal_service.plots.of_recording import before_after, errors, shown, spectrum
from magcal_service.plots.of_result import of_calibration, of_diagnosis, of_joint_diagnosis
from magcal_service.plots.of_study import of_study
from magcal_service.plots.paper import Sheet, save
from magcal_service.plots.plot import sheet_of
from magcal_service.residuals import rms
from magcal_service.trust.reasons import REMEDIES
from sim_sensor.recorder import record_simulation
from sim_sensor.simulation import Simulation
from tests.cli.cli_inputs import DESCRIPTOR, log_rows, run
from tests.offline.hand_turned import TRUTH, hand_turned
from tests.physics.live_models import THERMAL, hot, model_of

ROOT = Path(__file__).resolve().parents[2]

figure = pytest.importorskip("matplotlib.figure")


def drawn(sheet: Sheet):  # type: ignore[no-untyped-def]
    """The axes of a figure, by what they are titled or labelled."""
    made = figure.Figure()
    sheet.draw(made)
    return made.axes


def test_a_recording_is_shown_before_and_after(tmp_path: Path) -> None:
    time_s, field_nt, magnitude_nt = hand_turned(3, seconds=140.0)
    recording = magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=100.0, spin_rpm=6.0)
    of = shown(recording, None)
    upper, lower = drawn(before_after(of))
    assert np.median(np.asarray(upper.collections[1].get_offsets())[:, 1]) == pytest.approx(48.5, abs=0.05)
    assert lower.get_title().endswith(" nT after")
    nine = drawn(errors(of))
    assert [axes.get_title() for axes in nine[:4]] == ["bx [nT]", "by [nT]", "bz [nT]", "D11 [1e-3]"]
    assert nine[0].lines[0].get_ydata()[-1] == 0.0
    (axes,) = drawn(spectrum(of))
    assert [line.get_xdata()[0] for line in axes.lines[2:]] == pytest.approx([0.1, 0.2])


def test_a_log_that_ends_before_the_filter_starts_is_drawn_as_one_batch() -> None:
    time_s, field_nt, magnitude_nt = hand_turned(3)
    of = shown(magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=100.0), None)
    assert rms(of.after) == pytest.approx(100.0, rel=0.1)
    with pytest.raises(InputRefusedError, match="no errors over time; they are those of a replay"):
        errors(of)


def test_what_keeps_a_longer_log_from_an_estimate_is_said() -> None:
    time_s, field_nt, magnitude_nt = hand_turned(3, seconds=140.0, around_z_only=1.0)
    recording = magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=100.0)
    with pytest.raises(InputRefusedError, match=REMEDIES[magcal.replay(recording).reasons[0]]):
        shown(recording, None)


def test_a_result_is_shown_on_a_recording_and_by_itself(tmp_path: Path) -> None:
    time_s, field_nt, magnitude_nt = hand_turned(3)
    recording = magcal.Recording.from_arrays(time_s, field_nt, magnitude_nt, noise_nt=100.0)
    (tmp_path / "result.json").write_text(magcal.calibrate(recording).as_json())
    given = read_given(tmp_path / "result.json")
    assert "nT rms before, 10" in drawn(before_after(shown(recording, given)))[1].get_title()
    bias, _, levels = drawn(of_calibration(json.loads((tmp_path / "result.json").read_text()), given))
    assert bias.lines[0].get_ydata() == pytest.approx(TRUTH[:3], abs=100.0)
    assert levels.patches[1].get_height() == pytest.approx(100.0, rel=0.1)


def test_the_effects_of_a_physics_file_are_subtracted(tmp_path: Path) -> None:
    """The hot board's temperature, and a reference that is said to be 2 s early: as ``magcal apply`` corrects them."""
    scenario = hot()
    recording = magcal.read_recording(record_simulation(Simulation(scenario, 4, 600.0), tmp_path))
    early = ModelTerm("time_offset", "none", "", {"offset_s": np.array(2.0)})
    for name, terms in (("heat", THERMAL), ("late", (*THERMAL, early))):
        (tmp_path / f"{name}.toml").write_text(text_of(model_of(*terms, origin_ns=scenario.start_ns)))
    heat, late = (shown(recording, read_given(tmp_path / f"{name}.toml")) for name in ("heat", "late"))
    assert drawn(before_after(heat))[1].get_title() == "residual 3997 nT rms before, 95 nT after"
    recorded = recording.reference.magnitude_nt
    assert heat.reference_nt == pytest.approx(recorded)
    assert late.reference_nt[:-2] == pytest.approx(recorded[2:])
    assert late.calibrated_nt.tolist() == heat.calibrated_nt.tolist()


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.json", "{", "this JSON breaks off in line 1; a RECORDING.toml"),
        ("a.json", '{"bias_nt": 1}', "this JSON is no result: it has bias_nt; a RECORDING.toml"),
        ("a.json", '{"estimates": 1, "counters": 2}', "this is a replay's last estimate; give its recording"),
        ("a.toml", "[errors]", "a physics.toml is shown on one: RECORDING.toml --with physics.toml"),
    ],
)
def test_what_has_no_figure_is_refused_by_what_it_is(name: str, content: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputRefusedError, match=re.escape(told)):
        sheet_of(path, None, None)


def test_a_diagnosis_and_a_study_are_shown() -> None:
    effect = {"effect": "thermal_bias", "probability": 0.998, "where": {"share_of_mismatch": 0.93}}
    fit = {"noise_floor_nt": 300.0, "held_out_rms_nt": {"recalibrated": 318.4, "with_effects": 300.6}}
    held, share = drawn(of_diagnosis({"fit": fit, "effects": [effect]}))
    assert [bar.get_height() for bar in held.patches] == [318.4, 300.6]
    fit["held_out_rms_nt"] = {"simulation": 320.0, **fit["held_out_rms_nt"]}
    for said, label in (
        ("simulation", "simulation"),
        ("as calibrated on the first half", "as calibrated\non the first\nhalf"),
    ):
        held, _ = drawn(of_diagnosis({"fit": fit, "effects": [effect], "compared_with": said}))
        assert held.get_xticklabels()[0].get_text() == label
    assert share.patches[0].get_width() == pytest.approx(93.0)
    lines = [{"label": "ukf", "x": [1, 2], "y": [3.0, None], "limit": False}]
    lines.append({"label": "least", "x": [1, 2], "y": [2.0, 1.0], "limit": True})
    panel = {"title": "bx", "x": "time [s]", "y": "3 sigma [nT]", "log_x": False, "log_y": True, "lines": lines}
    (axes,) = drawn(of_study({"study": "table2", "curves": [panel]}))
    assert [line.get_linestyle() for line in axes.lines] == ["-", "--"]
    assert axes.get_yscale() == "log"


def test_a_diagnosis_of_several_recordings_shows_each_beside_its_floor() -> None:
    levels = {"recalibrated": 2462.0, "with_effects": 322.0}
    each = [
        {"name": name, "noise_floor_nt": 300.0, "held_out_rms_nt": levels, "predicted_from_others_rms_nt": predicted}
        for name, predicted in (("day 1", 640.0), ("day 2", None))
    ]
    effect = {"effect": "thermal_scale", "probability": 0.97, "where": {"share_of_mismatch": 0.7}}
    days, share = drawn(of_joint_diagnosis({"fit": {}, "recordings": each, "effects": [effect]}))
    heights = [[bar.get_height() for bar in bars] for bars in days.containers]
    assert (heights[:2], heights[2][0]) == ([[2462.0, 2462.0], [322.0, 322.0]], 640.0)
    assert [text.get_text() for text in days.get_xticklabels()] == ["day 1", "day 2"]
    assert share.patches[0].get_width() == pytest.approx(70.0)


def test_an_integrity_study_is_a_stanford_diagram() -> None:
    grid = {"title": "spin", "cells": [[10.0, 20.0, 100.0, 200.0, 60.0], [300.0, 400.0, 100.0, 200.0, 2.0]]}
    figures = {"trusted with a protection level [s]": 7200.0, "share of that time that misled": 0.01}
    made = figure.Figure()
    of_study({"study": "integrity", "grids": [grid], "curves": [], "figures": figures}).draw(made)
    cells = [patch.get_bbox().extents.tolist() for patch in made.axes[0].patches]
    assert cells == [[10.0, 100.0, 20.0, 200.0], [300.0, 100.0, 400.0, 200.0]]
    assert made.get_suptitle() == "beyond protection and 4 sigma: 1 % of 2 h of trusted time"
    quantiles = json.loads((ROOT / "docs/results/integrity.json").read_text())
    spin, *_ = drawn(of_study({**quantiles, "grids": []}))
    assert all(line.get_ydata()[0] > line.get_xdata()[0] for line in spin.lines[:1])  # half the time below protection
    assert spin.get_xlim() == spin.get_ylim()


def test_concealed_cases_are_a_reliability_diagram() -> None:
    rows = [["all", "0.9 to 0.99", 9, 0.9, 0.8, 0.5, 0.95], ["all", "0.99 to 1", 0, None, None, None, None]]
    (axes,) = drawn(of_study({"study": "concealed", "tables": [{"title": "Reliability: x", "rows": rows}]}))
    points = axes.containers[0].lines[0]
    assert (points.get_xdata().tolist(), points.get_ydata().tolist()) == ([pytest.approx(np.log(9.0))], [0.8])
    ticks = dict(zip((text.get_text() for text in axes.get_xticklabels()), axes.get_xticks(), strict=True))
    assert ticks["0.9"] == pytest.approx(np.log(9.0))


def test_no_claim_lies_off_the_axis_and_no_number_over_its_neighbours() -> None:
    rows = [["all", "", n, claim, 0.5, 0.1, 0.9] for n, claim in ((8, 0.05), (220, 0.97), (17, 0.99))]
    (axes,) = drawn(of_study({"study": "concealed", "tables": [{"title": "Reliability: x", "rows": rows}]}))
    assert axes.get_xlim()[0] < axes.containers[0].lines[0].get_xdata().min()
    heights = {text.get_text(): text.xyann[1] for text in axes.texts}
    assert heights["220"] != heights["17"]


@pytest.mark.parametrize("suffix", [".svg", ".png"])
def test_the_same_figure_has_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    sheet = Sheet(lambda made: made.subplots().plot([1, 2]), 1.0, 1.0)
    for name in "ab":
        save(sheet, tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_what_cannot_be_shown_is_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(log_rows(60))
    (tmp_path / "log.toml").write_text(DESCRIPTOR)
    (tmp_path / "other.json").write_text("[1]")
    (tmp_path / "study.json").write_text('{"study": "reality", "curves": []}')
    (tmp_path / "half.json").write_text('{"study": "reality"}')
    (tmp_path / "bare.json").write_text('{"effects": [], "fit": {"held_out_rms_nt": {}}}')
    (tmp_path / "summary.json").write_text('{"question": "diagnose", "recordings": []}')
    (tmp_path / "physics.toml").write_text("version = 1\n[errors]\n")
    log, out = tmp_path / "log.toml", tmp_path / "out.png"
    for arguments, said in (
        ((log, "--out", "x.gif"), ".svg, .pdf, .png is accepted"),
        ((log, "--out", out, "--figure", "sphere"), "known: before-after, errors, spectrum, track"),
        ((log, "--out", out, "--figure", "eror"), "'eror' is refused; did you mean 'errors'? known: "),
        (
            (log, "--out", out),
            "ends before the filter starts (120 s), and is not enough as one batch: magcal calibrate",
        ),
        ((log, "--out", out), "--with RESULT.json, these can be drawn: before-after, track, spectrum"),
        ((tmp_path / "other.json", "--out", out), "a RECORDING.toml, a session .mcap"),
        ((tmp_path / "study.json", "--out", out), "this one has tables alone"),
        ((tmp_path / "half.json", "--out", out), "without 'curves'"),
        ((tmp_path / "bare.json", "--out", out), "without 'noise_floor_nt'"),
        ((tmp_path / "summary.json", "--out", out), "give the file in the folder of one of them"),
        ((tmp_path / "physics.toml", "--out", out), "'a model of physics' is refused"),
        ((tmp_path / "study.json", "--out", out, "--figure", "track"), "it goes with a recording"),
    ):
        refused = run("plot", *arguments)
        assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
        assert said in refused.err
    assert not out.exists()
