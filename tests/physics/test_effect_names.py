"""One owner for each effect: its name stands as a text in its own file alone."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from magcal_service.physics import effects
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.catalogue import catalogue, watched_as

ROOT = Path(__file__).resolve().parents[2]
HOME = Path(effects.__file__).parent
NAMES = {effect.name for effect in catalogue()}

ANOTHER_MEANING = {
    ("magcal_service/trust/modes.py", "stuck_axis"),  # a degraded mode of that name
    ("magcal_service/recordings/defects.py", "stuck_axis"),  # a defect of a recording, of that name
    ("sim_sensor/field.py", "reference_epoch"),  # keys of the simulator's own scenarios,
    ("sim_sensor/scenario.py", "torquer"),  # which shares nothing with the catalogue
    ("magcal_service/recordings/describe/telemetry.py", "torquer"),  # a channel of a descriptor
    ("magcal_service/recordings/describe/vocabulary.py", "torquer"),  # and a word in the names of columns
    ("magcal_service/studies/unseen/scenarios.py", "torquer"),  # scenarios of a study, which share nothing either
    ("magcal_service/studies/unseen/scenarios.py", "stuck_axis"),
    ("magcal_service/trust/hazards.py", "bias_step"),  # what a protection level guards against
    ("magcal_service/trust/hazards.py", "bias_drift"),
}


def texts(tree: ast.AST) -> Iterator[ast.Constant]:
    """String literals that are no docstring."""
    documents = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documents:
            yield node


def references(tree: ast.AST) -> set[int]:
    """What stands in ``confused_with=`` and the like: whom an effect may be taken for is its own to say."""
    return {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.keyword)
        and node.arg in ("confused_with", "as_well", "at_once", "if_completed", "if_along", "if_none")
        for part in ast.walk(node.value)
    }


def strangers(path: Path) -> list[str]:
    """Names of effects that a file holds and does not own."""
    source = path.read_text(encoding="utf-8")
    if not any(name in source for name in NAMES):  # seven files in eight, and reading them as Python takes the time
        return []
    tree = ast.parse(source)
    allowed = references(tree) if path.parent == HOME else set()
    own = {path.stem} if path.parent == HOME else set()
    place = path.relative_to(ROOT).as_posix()
    return [
        f"{place}:{node.lineno}: {node.value}"
        for node in texts(tree)
        if node.value in NAMES - own and id(node) not in allowed and (place, node.value) not in ANOTHER_MEANING
    ]


def test_no_effect_is_named_outside_its_own_file() -> None:
    files = [path for room in ("magcal_service", "sim_sensor") for path in (ROOT / room).rglob("*.py")]
    assert len(files) > 200
    assert [found for path in files for found in strangers(path)] == []


def test_a_name_in_another_file_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "stray.py"
    path.write_text('"""thermal_bias"""\nx = ["thermal_bias"]\n', encoding="utf-8")
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    assert strangers(path) == ["stray.py:2: thermal_bias"]


def test_what_each_effect_disturbs_is_one_of_six_kinds() -> None:
    kinds = {kind: {effect.name for effect in catalogue() if effect.acts_on is kind} for kind in ActsOn}
    text = "an effect of this kind is new: add the name to its kind here"
    assert kinds[ActsOn.REFERENCE_TIME] == {"time_offset"}, text
    assert kinds[ActsOn.REFERENCE] == {"external_field", "position_offset", "reference_epoch"}, text
    assert kinds[ActsOn.SAMPLES] == {"stuck_axis", "saturation", "quantisation"}, text
    assert kinds[ActsOn.ATTITUDE] == {"nutation", "spin_rate"}, text
    assert kinds[ActsOn.NOISE] == {"coloured_noise"}, text
    assert sum(len(names) for names in kinds.values()) == len(catalogue()), "acts_on is one of ActsOn"
    assert len(kinds[ActsOn.FIELD]) > len(catalogue()) / 2


def test_an_effect_of_the_field_or_the_reference_can_be_compensated_live() -> None:
    live = {ActsOn.FIELD, ActsOn.REFERENCE, ActsOn.REFERENCE_TIME}
    for effect in catalogue():
        assert effect.acts_on in live or not (effect.not_live or effect.needs_rate)


@pytest.mark.parametrize(
    ("kind", "quantity", "names"),
    [
        (Watched.BIAS_BY, "temperature", ("thermal_bias",)),
        (Watched.SCALE_BY, "temperature", ("thermal_scale",)),
        (Watched.BIAS_BY, "light", ("current_loop", "sun_disturbance")),
        (Watched.BIAS_BY, "current", ("current_loop",)),
        (Watched.BIAS_BY, "magnetic moment", ("torquer",)),
        (Watched.SCALE_BY, "current", ()),
        (Watched.SLOPE, "", ("position_offset", "time_offset")),
        (Watched.CUBE, "", ("cubic_response",)),
        (Watched.FLAT_TOP, "", ("saturation",)),
        (Watched.MEMORY, "", ("coloured_noise",)),
        (Watched.LINE, "", ("tone",)),
        (Watched.BIAS_COURSE, "", ("bias_drift",)),
        (Watched.SCALE_COURSE, "", ("scale_drift",)),
        (Watched.BIAS_STEP, "", ("bias_step",)),
        (Watched.SCALE_STEP, "", ("scale_step",)),
    ],
)
def test_the_watch_asks_the_effects_what_it_may_be_seeing(kind: Watched, quantity: str, names: tuple[str, ...]) -> None:
    assert watched_as(kind, quantity) == names, "an effect with this in `watched` is new: add the name to its row here"
