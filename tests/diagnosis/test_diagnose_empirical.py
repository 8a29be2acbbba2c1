"""The command on a concealed recording whose cause is in no catalogue, and follows a recorded channel."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from magcal_service.physics.apply.model_file import parse_model, text_of
from tests.blind import draw_case, write_case
from tests.diagnosis.diagnosis_runs import Done, diagnose


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Done]:
    folder = tmp_path_factory.mktemp("hopkinson")
    descriptor = write_case(draw_case(900, "outside:hopkinson"), folder / "case")
    return folder, diagnose(descriptor, "--out", folder)


def test_what_has_no_name_stays_unknown_and_is_modelled(ran: tuple[Path, Done]) -> None:
    folder, done = ran
    assert done.code == 3
    assert "verdict: unknown" in done.out
    assert "Without a name, but modelled: a gain over the recorded temperature" in " ".join(done.out.split())
    content = json.loads((folder / "diagnosis.json").read_text())
    assert (content["verdict"], content["trusted"]) == ("unknown", False)
    assert "unexplained_structure" in content["reasons"]
    modelled = content["empirical"]
    rms = modelled["held_out_rms_nt"]
    assert rms["before"] == pytest.approx(content["fit"]["held_out_rms_nt"]["with_effects"])
    noise = content["fit"]["noise_floor_nt"]
    assert rms["before"] > 1.2 * noise
    assert rms["after"] < 1.05 * noise
    assert modelled["gain_standard_errors"] >= 3.0


def test_the_physics_file_carries_the_curve_with_its_doubts(ran: tuple[Path, Done]) -> None:
    folder, _ = ran
    content = json.loads((folder / "diagnosis.json").read_text())
    text = (folder / "physics.toml").read_text()
    model = parse_model(text.encode())
    assert text_of(model) == text
    assert model.doubts == ", ".join(content["reasons"])
    assert (model.terms, len(model.empirical)) == ((), 1)
    said = content["empirical"]["curves"][0]
    curve = model.empirical[0]
    assert (curve.driver, str(curve.kind), list(curve.span)) == (said["driver"], said["kind"], said["range"])
    assert curve.values.tolist() == said["values"]
    assert model.x[:3].tolist() == content["empirical"]["bias_nt"]


def test_the_report_draws_the_curve(ran: tuple[Path, Done]) -> None:
    page = (ran[0] / "report.html").read_text()
    assert "<h2>Without a name, but modelled</h2>" in page
    assert "The gain over the recorded temperature, straight between its knots, with 1 sigma." in page
    assert "It says nothing of a cause." in page


def test_the_drawn_curve_is_told_in_words_too(ran: tuple[Path, Done]) -> None:
    page = (ran[0] / "report.html").read_text()
    curve = json.loads((ran[0] / "diagnosis.json").read_text())["empirical"]["curves"][0]
    values, (low, high) = np.array(curve["values"]), curve["range"]
    sized = f"from {values.min():.3g} to {values.max():.3g}, over {low:.4g} to {high:.4g}."
    assert f'alt="gain against the recorded temperature [degC]: {sized}"' in page
