"""The configuration file: what is accepted, and that every refusal names file, field, value and what is accepted."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from magcal_service.base.errors import ConfigError
from magcal_service.base.typed_toml.record import declared
from magcal_service.config.daemon_settings import CommandsConfig, HealthConfig, OutputConfig, RecordConfig, StateConfig
from magcal_service.config.reader import load_config
from magcal_service.config.settings import (
    DEFAULT_LINK,
    Config,
    CraftConfig,
    FilterConfig,
    MagnetometerConfig,
    ReferenceConfig,
    ReferenceModel,
    SensorConfig,
    SpinConfig,
    SpinWindow,
    TickConfig,
    TrustConfig,
    default_craft,
)

MINIMAL = 'version = 1\n[[craft]]\nname = "demo"\n'

FULL = """
version = 1
link = "serial:/dev/magcal-sensor?baud=115200"
[[craft]]
name = "demo"
max_sources = 3
[craft.sensor]
noise_nt = 300.0
stuck_samples = 12
range_nt = 80000.0
axis_stuck_s = 90.0
[craft.spin]
axis = [0.0, -3.0, 4.0]
rate_rpm = -7.5
window = "mean"
window_turns = 3
window_samples = 9
fourth = true
[craft.filter]
method = "two-step"
prior_bias_nt = 5000.0
prior_D = 0.1
process_noise_bias_nt = [0.1, 0.2, 0.3]
process_noise_D = [1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6]
start_s = 100.0
start_max_s = 200.0
start_inflation = 5.0
alpha = 0.5
beta = 1.0
kappa = 2.0
gate_sigma = 5.0
adaptive = true
[craft.ticks]
reference_max_gap_s = 20.0
hold_s = 4.0
late_s = 40.0
gap_s = 70.0
step_confirm_s = 700.0
[craft.reference]
model = "igrf"
[craft.trust]
min_ticks = 400
sigma_bias_nt = 50.0
sigma_D = 0.002
residual_ratio = 2.0
watch = false
protection = false
protection_nt = 150.0
disturbance_nt = 50.0
[[craft.magnetometer]]
source = "mag2"
noise_nt = 50.0
range_nt = 90000.0
axis_stuck_s = 80.0
stuck_samples = 12
prior_bias_nt = 4000.0
prior_D = 0.3
process_noise_bias_nt = [0.4, 0.5, 0.6]
process_noise_D = [6e-6, 5e-6, 4e-6, 3e-6, 2e-6, 1e-6]
[craft.magnetometer.spin]
axis = "x"
rate_rpm = 7.0
[output]
csv = "estimates.csv"
status_period_s = 5.0
links = ["ccsds:udp/127.0.0.1:10015"]
[record]
directory = "recordings"
flush_s = 2.0
file_mb = 10.0
file_h = 1.0
total_mb = 500.0
min_free_mb = 20.0
retry_s = 30.0

[state]
directory = "state"
period_s = 120.0
keep = 5
key = "state.key"
counters = "counters"

[health]
metrics = "127.0.0.1:9464"
summary_s = 60.0
[commands]
rate_per_min = 120.0
burst = 30
"""


def load(tmp_path: Path, text: str, **options: Any) -> Config:
    path = tmp_path / "daemon.toml"
    path.write_text(text, encoding="utf-8")
    return load_config(path, **options)


def refusals(tmp_path: Path, text: str, **options: Any) -> list[str]:
    with pytest.raises(ConfigError) as refusal:
        load(tmp_path, text, **options)
    return str(refusal.value).splitlines()


def settings_in(record: Any, name: str = "") -> dict[str, Any]:
    """All settings in a tree of dataclasses with one craft, by dotted name."""
    if isinstance(record, tuple) and record and is_dataclass(record[0]):
        record = record[0]
    if not is_dataclass(record):
        return {name: record}
    found: dict[str, Any] = {}
    for setting in fields(record):
        found |= settings_in(getattr(record, setting.name), f"{name}.{setting.name}")
    return found


def test_the_smallest_file_gives_all_defaults(tmp_path: Path) -> None:
    assert load(tmp_path, MINIMAL) == Config(DEFAULT_LINK, (CraftConfig("demo"),), OutputConfig())


def test_every_key_of_a_full_file_arrives(tmp_path: Path) -> None:
    expected = Config(
        link="serial:/dev/magcal-sensor?baud=115200",
        crafts=(
            CraftConfig(
                name="demo",
                sensor=SensorConfig(300.0, 12, 80000.0, 90.0),
                spin=SpinConfig((0.0, -0.6, 0.8), -7.5, SpinWindow.MEAN, 3, 9, True),
                filter=FilterConfig(
                    "two-step", 5000.0, 0.1, (0.1, 0.2, 0.3), (1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6),
                    100.0, 200.0, 5.0, 0.5, 1.0, 2.0, 5.0, True,
                ),
                ticks=TickConfig(20.0, 4.0, 40.0, 70.0, 700.0),
                trust=TrustConfig(400, 50.0, 0.002, 2.0, False, False, 150.0, 50.0),
                reference=ReferenceConfig(ReferenceModel.IGRF),
                max_sources=3,
                magnetometers=(
                    MagnetometerConfig(
                        "mag2", 50.0, 90000.0, 80.0, 12, 4000.0, 0.3,
                        (0.4, 0.5, 0.6), (6e-6, 5e-6, 4e-6, 3e-6, 2e-6, 1e-6), SpinConfig((1.0, 0.0, 0.0), 7.0),
                    ),
                ),
            ),
        ),
        output=OutputConfig(Path("estimates.csv"), 5.0, ("ccsds:udp/127.0.0.1:10015",)),
        record=RecordConfig(Path("recordings"), 2.0, 10.0, 1.0, 500.0, 20.0, 30.0),
        state=StateConfig(Path("state"), 120.0, 5, Path("state.key"), Path("counters")),
        health=HealthConfig("127.0.0.1:9464", 60.0),
        commands=CommandsConfig(120.0, 30),
    )  # fmt: skip
    assert load(tmp_path, FULL) == expected


def test_sensors_with_sources_are_the_magnetometers_of_a_craft(tmp_path: Path) -> None:
    """An array of tables in place of the one that they share."""
    path = tmp_path / "magcal.toml"
    path.write_text(
        'version = 1\n[[craft]]\nname = "pair"\n[[craft.sensor]]\nsource = "a"\nnoise_nt = 20.0\n'
        '[[craft.sensor]]\nsource = "b"\nstuck_samples = 5\n'
    )
    (craft,) = load_config(path).crafts
    assert craft.sensor == SensorConfig()
    assert craft.magnetometers == (MagnetometerConfig("a", 20.0), MagnetometerConfig("b", stuck_samples=5))
    path.write_text(path.read_text().replace('source = "b"\n', ""))
    with pytest.raises(ConfigError, match="source"):
        load_config(path)


def test_the_full_file_differs_from_the_default_in_every_setting(tmp_path: Path) -> None:
    full = settings_in(load(tmp_path, FULL))
    del full[".crafts.physics"]  # names another file: tests/config/test_config_physics.py
    full = {name: full[name] for name in full if name not in (".crafts.hears", ".crafts.source")}  # not of a file
    other = Path("other")
    crafts = (CraftConfig("other", spin=SpinConfig()),)
    default = dict.fromkeys(full, ()) | settings_in(
        Config(crafts=crafts, record=RecordConfig(other), state=StateConfig(other))
    )
    assert [name for name in full if full[name] == default[name]] == []


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        ('"x"', (1, 0, 0)),
        ('"y"', (0, 1, 0)),
        ('"z"', (0, 0, 1)),
        ("[0, 0, -2]", (0, 0, -1)),
        ("[3, 4, 0]", (0.6, 0.8, 0)),
    ],
)
def test_a_spin_axis_becomes_a_unit_vector(tmp_path: Path, axis: str, expected: tuple[float, ...]) -> None:
    spin = load(tmp_path, MINIMAL + f"[craft.spin]\nrate_rpm = 7.5\naxis = {axis}\n").crafts[0].spin
    assert spin is not None
    assert spin.axis == pytest.approx(expected, abs=1e-15)


def test_a_spin_table_without_window_leaves_the_length_to_the_turns(tmp_path: Path) -> None:
    spin = load(tmp_path, MINIMAL + "[craft.spin]\nrate_rpm = 7.5\n").crafts[0].spin
    assert spin == SpinConfig()


def test_many_craft_keep_the_order_of_the_file(tmp_path: Path) -> None:
    text = "version = 1\n" + "".join(f'[[craft]]\nname = "sat-{i}"\n' for i in (3, 1, 2))
    assert [craft.name for craft in load(tmp_path, text).crafts] == ["sat-3", "sat-1", "sat-2"]


SPIN = "[craft.spin]\nrate_rpm = 7.5\n"


@pytest.mark.parametrize(
    ("text", "field", "value"),
    [
        (MINIMAL.replace("1", "2"), "daemon.toml: version", "2.0"),
        (MINIMAL.replace("version = 1\n", ""), "daemon.toml: version", "missing"),
        ("link = 7\n" + MINIMAL, "daemon.toml: link", "7"),
        ('link = "tcp/127.0.0.1"\n' + MINIMAL, "daemon.toml: link", "'tcp/127.0.0.1'"),
        ('link = "zenho:tcp/127.0.0.1:7447"\n' + MINIMAL, "daemon.toml: link", "'zenho:tcp/127.0.0.1:7447'"),
        ("version = 1\n", "daemon.toml: craft", "0"),
        ("version = 1\n[[craft]]\n", "daemon.toml: craft[0].name", "missing"),
        ("version = 1\n[[craft]]\nname = 'a b'\n", "daemon.toml: craft[0].name", "'a b'"),
        ("version = 1\n[[craft]]\nname = ''\n", "daemon.toml: craft[0].name", "''"),
        (f"version = 1\n[[craft]]\nname = '{'a' * 33}'\n", "daemon.toml: craft[0].name", f"'{'a' * 33}'"),
        (MINIMAL + "[[craft]]\nname = 'demo'\n", "daemon.toml: craft[1].name", "'demo'"),
        (MINIMAL + "sensor = 3\n", "daemon.toml: craft[0].sensor", "3"),
        (MINIMAL + "[craft.sensor]\nnoise_nt = -1\n", "daemon.toml: craft[0].sensor.noise_nt", "-1"),
        (MINIMAL + "[craft.sensor]\nnoise_nt = nan\n", "daemon.toml: craft[0].sensor.noise_nt", "nan"),
        (MINIMAL + "[craft.sensor]\nnoise_nt = inf\n", "daemon.toml: craft[0].sensor.noise_nt", "inf"),
        (MINIMAL + "[craft.sensor]\nstuck_samples = 10.5\n", "daemon.toml: craft[0].sensor.stuck_samples", "10.5"),
        (MINIMAL + "[craft.spin]\n", "daemon.toml: craft[0].spin.rate_rpm", "missing"),
        (MINIMAL + "[craft.spin]\nrate_rpm = 0\n", "daemon.toml: craft[0].spin.rate_rpm", "0.0"),
        (MINIMAL + "[craft.spin]\nrate_rpm = 5000\n", "daemon.toml: craft[0].spin.rate_rpm", "5000"),
        (MINIMAL + SPIN + "axis = 'w'\n", "daemon.toml: craft[0].spin.axis", "'w'"),
        (MINIMAL + SPIN + "axis = [0, 0, 0]\n", "daemon.toml: craft[0].spin.axis", "[0.0, 0.0, 0.0]"),
        (MINIMAL + SPIN + "axis = [9e-7, 0, 0]\n", "daemon.toml: craft[0].spin.axis", "[9e-07, 0.0, 0.0]"),
        (MINIMAL + SPIN + "axis = [2e6, 0, 0]\n", "daemon.toml: craft[0].spin.axis", "[2000000.0, 0.0, 0.0]"),
        (MINIMAL + SPIN + "axis = [0, 1]\n", "daemon.toml: craft[0].spin.axis", "[0, 1]"),
        (MINIMAL + SPIN + "axis = 3\n", "daemon.toml: craft[0].spin.axis", "3"),
        (MINIMAL + SPIN + "window = 'means'\n", "daemon.toml: craft[0].spin.window", "'means'"),
        (MINIMAL + SPIN + "window_turns = 21\n", "daemon.toml: craft[0].spin.window_turns", "21"),
        (MINIMAL + SPIN + "window_samples = 8\n", "daemon.toml: craft[0].spin.window_samples", "8"),
        (MINIMAL + SPIN + "fourth = 1\n", "daemon.toml: craft[0].spin.fourth", "1"),
        (MINIMAL + "[craft.filter]\nmethod = 'U K F'\n", "daemon.toml: craft[0].filter.method", "'U K F'"),
        (
            MINIMAL + "[craft.filter]\nprocess_noise_D = [0, 0, 0, 0, 0, 1]\n",
            "daemon.toml: craft[0].filter.process_noise_D",
            "[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]",
        ),
        (MINIMAL + "[craft.filter]\nstart_max_s = 60\n", "daemon.toml: craft[0].filter.start_max_s", "60.0"),
        (MINIMAL + "[craft.filter]\ngate_sigma = 1\n", "daemon.toml: craft[0].filter.gate_sigma", "1"),
        (MINIMAL + "[craft.ticks]\nlate_s = 1\n", "daemon.toml: craft[0].ticks.late_s", "1.0"),
        (MINIMAL + "[craft.ticks]\nstep_confirm_s = 30\n", "daemon.toml: craft[0].ticks.step_confirm_s", "30.0"),
        (MINIMAL + "[craft.trust]\nresidual_ratio = 0.5\n", "daemon.toml: craft[0].trust.residual_ratio", "0.5"),
        (MINIMAL + "[output]\ncsv = ''\n", "daemon.toml: output.csv", "''"),
        (MINIMAL + "[output]\ncsv = 5\n", "daemon.toml: output.csv", "5"),
        (MINIMAL + "[output]\nstatus_period_s = 0\n", "daemon.toml: output.status_period_s", "0"),
        (MINIMAL + "[record]\n", "daemon.toml: record.directory", "missing"),
        (MINIMAL + "[record]\ndirectory = ' '\n", "daemon.toml: record.directory", "' '"),
        (MINIMAL + "[record]\ndirectory = 'd'\ntotal_mb = 100\n", "daemon.toml: record.total_mb", "100.0"),
        (MINIMAL + "[craft.ticks]\ntick_s = 1.0\n", "daemon.toml: craft[0].ticks.tick_s", "1.0"),
    ],
)
def test_a_refusal_names_the_field_and_the_value(tmp_path: Path, text: str, field: str, value: str) -> None:
    told = "missing; required: " if value == "missing" else f"{value} is refused; "
    assert [line for line in refusals(tmp_path, text) if line.startswith(f"{field}: {told}")]


@pytest.mark.parametrize(
    "table", ["", "[craft.sensor]", "[craft.spin]", "[craft.filter]", "[craft.ticks]", "[output]", "[record]"]
)
def test_an_unknown_key_is_refused_in_every_table(tmp_path: Path, table: str) -> None:
    lines = refusals(tmp_path, f"{MINIMAL}{table}\nnosuch = 1\n")
    assert any("nosuch: 1 is refused; unknown key" in line for line in lines)


def test_a_mistyped_key_gets_the_nearest_one(tmp_path: Path) -> None:
    lines = refusals(tmp_path, MINIMAL + "[craft.sensor]\nnoise = 300.0\n")
    assert lines == [
        "daemon.toml: craft[0].sensor.noise: 300.0 is refused; "
        "unknown key; did you mean 'noise_nt'? known: axis_stuck_s, noise_nt, range_nt, stuck_samples"
    ]


def test_all_faults_of_a_file_are_reported_at_once(tmp_path: Path) -> None:
    text = 'version = 1\nlinks = "x"\n[[craft]]\nname = "?"\n[craft.filter]\nbeta = 11\n[output]\ncsv = 1\n'
    assert len(refusals(tmp_path, text)) == 4


def test_an_estimator_that_is_not_there_gets_the_nearest_one(tmp_path: Path) -> None:
    lines = refusals(tmp_path, MINIMAL + "[craft.filter]\nmethod = 'ufk'\n", methods=("ukf", "ekf", "two-step"))
    assert lines[0].endswith("'ufk' is refused; did you mean 'ukf'? known: ekf, two-step, ukf")


def test_an_estimator_that_is_there_is_accepted(tmp_path: Path) -> None:
    config = load(tmp_path, MINIMAL + "[craft.filter]\nmethod = 'ekf'\n", methods=("ukf", "ekf"))
    assert config.crafts[0].filter.method == "ekf"


@pytest.mark.parametrize(
    "value", ["[" * 400 + "]" * 400, "{a = " * 60 + "1" + "}" * 60, "0x" + "f" * 5000, "[[0x" + "f" * 500 + "]]"]
)
@pytest.mark.parametrize("key", ["version", "link", "nosuch", "craft"])
def test_a_value_without_end_is_refused_in_one_short_line(tmp_path: Path, key: str, value: str) -> None:
    (line,) = refusals(tmp_path, f"{key} = {value}\n")
    assert "is refused" in line
    assert len(line) < 300 + len(str(tmp_path))


@pytest.mark.parametrize("form", ["{key}b = 1", "[{key}b]", "x = {{{key}b = 1}}", "  [[{key}b]]"])
def test_a_key_of_half_a_million_dots_is_refused_at_once(tmp_path: Path, form: str) -> None:
    begin = time.process_time()
    (line,) = refusals(tmp_path, MINIMAL + form.format(key="a." * 500_000) + "\n")
    assert "nested too deeply" in line
    assert time.process_time() - begin < 5.0


def test_a_file_that_is_not_there_is_refused_by_its_path(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.toml: there is no such file or folder; give"):
        load_config(tmp_path / "absent.toml")


def test_the_defaults_of_a_named_craft_need_no_file() -> None:
    assert default_craft("cube-1") == CraftConfig("cube-1")


def test_a_bad_name_is_refused_without_a_file() -> None:
    with pytest.raises(ConfigError, match="craft name: 'a/b' is refused"):
        default_craft("a/b")


LEAVES = st.one_of(
    st.integers(-(10**20), 10**20), st.floats(allow_nan=True), st.booleans(), st.sampled_from(["ukf", "z", "", "mean"])
)


def toml_of(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(toml_of(item) for item in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"'{value}'" if isinstance(value, str) else repr(value)


KINDS: dict[str, Any] = {
    "craft.sensor": SensorConfig,
    "craft.spin": SpinConfig,
    "craft.filter": FilterConfig,
    "craft.ticks": TickConfig,
    "craft.trust": TrustConfig,
    "output": OutputConfig,
    "record": RecordConfig,
}
EVERY_SETTING = [(table, setting.name) for table, kind in KINDS.items() for setting in fields(kind)]


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.sampled_from(EVERY_SETTING), value=st.one_of(LEAVES, st.lists(LEAVES, max_size=6)))
def test_no_value_of_any_key_raises_anything_but_a_config_error(
    tmp_path: Path, place: tuple[str, str], value: object
) -> None:
    table, key = place
    text = f"{MINIMAL}[{table}]\n{key} = {toml_of(value)}\n"
    outcome: Config | list[Any]
    try:
        outcome = load(tmp_path, text)
    except ConfigError as refusal:
        outcome = list(refusal.faults)
    assert outcome


NEEDED_BESIDE = {
    "window_turns": "rate_rpm = 7.5\n",
    "window_samples": "rate_rpm = 7.5\nwindow = 'mean'\n",
    "start_s": "start_max_s = 604800\n",
    "hold_s": "late_s = 600\n",
    "gap_s": "step_confirm_s = 604800\n",
    "disturbance_nt": "protection_nt = 100000\n",
} | {setting.name: "directory = 'd'\n" for setting in fields(RecordConfig)}
LIMITED = [
    (table, name, key.limits.maximum, len(key.default) if isinstance(key.default, tuple) else 0)
    for table, kind in KINDS.items()
    for name, key in declared(kind).items()
    if key.limits is not None
]


@pytest.mark.parametrize(("table", "key", "maximum", "elements"), LIMITED)
def test_the_largest_value_is_accepted_and_nothing_beyond(
    tmp_path: Path, table: str, key: str, maximum: float, elements: int
) -> None:
    def file_with(value: float) -> str:
        return f"{MINIMAL}[{table}]\n{NEEDED_BESIDE.get(key, '')}{key} = {[value] * elements if elements else value}\n"

    load(tmp_path, file_with(maximum))
    lines = refusals(tmp_path, file_with(maximum + 1 if isinstance(maximum, int) else maximum * 1.0001))
    assert [line.split(": ")[1] for line in lines] == [f"{table.replace('craft', 'craft[0]')}.{key}"]


def test_every_number_in_the_configuration_has_limits() -> None:
    unlimited = {name for kind in KINDS.values() for name, key in declared(kind).items() if key.limits is None}
    texts = {"axis", "window", "method", "csv", "links", "directory"}
    assert unlimited == texts | {"fourth", "adaptive", "watch", "protection"}


def test_configuration_imports_neither_numpy_nor_an_extra() -> None:
    code = (
        "import sys, magcal_service.config.settings\n"
        "print(sorted({'numpy', 'scipy', 'rich', 'matplotlib', 'ppigrf', 'zenoh', 'serial'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


def test_the_length_of_a_spin_window_is_that_of_its_turns_either_way() -> None:
    assert SpinConfig(rate_rpm=7.5).window_s == 16.0
    assert SpinConfig(rate_rpm=-2.0, window_turns=3).window_s == 90.0


def test_a_disturbance_above_the_limit_of_the_level_is_refused(tmp_path: Path) -> None:
    """No level is below it: nothing would ever be trusted; without protection it does not matter."""
    path = tmp_path / "magcal.toml"
    path.write_text('version = 1\n[[craft]]\nname = "a"\n[craft.trust]\ndisturbance_nt = 501.0\n')
    with pytest.raises(
        ConfigError, match=r"disturbance_nt: 501.0 is refused; at most protection_nt \(500\) is accepted"
    ):
        load_config(path)
    path.write_text(path.read_text() + "protection = false\n")
    assert load_config(path).crafts[0].trust.disturbance_nt == 501.0
