"""Scenarios: the shipped ones are sound, and a faulty file is refused with each fault by name."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError
from sim_sensor.faults import FaultKind
from sim_sensor.orbit import KeplerOrbit
from sim_sensor.scenario import Channel, resolve
from sim_sensor.scenario_reader import load_scenario, shipped_scenarios
from sim_sensor.sensor import symmetric

MINIMAL = 'version = 1\ndescription = "test"\n'
LINE1 = "1 25544U 98067A   22010.08605869  .00001706  00000-0  38025-4 0  9993"
LINE2 = "2 25544  51.6438  39.5186 0005432  22.6155  73.7459 15.49885031320662"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "test.toml"
    path.write_text(MINIMAL + text)
    return path


def test_the_papers_scenario_is_the_papers() -> None:
    scenario = load_scenario("paper")
    orbit, spin, sensor = scenario.orbit, scenario.spin, scenario.sensor
    assert orbit.semi_major_km == pytest.approx(6378.137 + 612.0)
    assert (orbit.eccentricity, math.degrees(orbit.inclination_rad)) == pytest.approx((6.4e-5, 74.0))
    assert (spin.axis_body, spin.rate_rad_s * 60.0 / math.tau) == ((0.0, 0.0, 1.0), pytest.approx(7.5))
    assert spin.direction_eci == pytest.approx((1 / math.sqrt(3.0),) * 3)
    assert (scenario.duration_s, sensor.rate_hz, sensor.noise_nt) == (18000.0, 1.0, (300.0,) * 3)
    assert sensor.bias_nt == (5000.0, 3000.0, 4000.0)
    assert sensor.D == (0.05, 0.10, 0.05, 0.05, 0.05, 0.05)


def test_at_least_eight_scenarios_are_shipped() -> None:
    assert len(shipped_scenarios()) >= 8


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_shipped_scenario_loads_and_says_what_it_shows(name: str) -> None:
    scenario = load_scenario(name)
    assert len(scenario.description.split()) >= 30
    assert scenario.name == name


def test_shipped_scenarios_have_craft_of_their_own() -> None:
    crafts = [load_scenario(name).craft for name in shipped_scenarios()]
    assert len(set(crafts)) == len(crafts)


def test_a_file_needs_no_more_than_version_and_description(tmp_path: Path) -> None:
    assert load_scenario(written(tmp_path, "")).sensor.rate_hz == 1.0


FAULTS = [
    ("altitud_km = 1", "altitud_km"),
    ('start = "yesterday"', "start"),
    ('start = "2031-01-01T00:00:00Z"', "start"),
    ('start = "2030-01-01T00:00:00Z"', "start"),
    ('start = "2025-06-01T00:00:00.5Z"', "start"),
    ("duration_s = 0", "duration_s"),
    ('craft = "a b"', "craft"),
    ("[orbit]\naltitude_km = 20", "orbit.altitude_km"),
    ("[orbit]\neccentricity = 0.5", "orbit.eccentricity"),
    ("[orbit]\naltitude_km = 400\neccentricity = 0.05", "orbit.eccentricity"),  # a perigee of 61 km
    (f'[orbit]\ntle = ["{LINE1}", "{LINE2[:-1]}5"]', "orbit.tle"),
    (f'[orbit]\ntle = ["{LINE2}", "{LINE1}"]', "orbit.tle"),
    (f'[orbit]\ntle = ["{LINE1}", "{LINE2}"]\naltitude_km = 500', "orbit.altitude_km"),
    ('[spin]\naxis = "w"', "spin.axis"),
    ("[spin]\naxis = [0, 0, 0]", "spin.axis"),
    ('[spin]\ndirection = "north"', "spin.direction"),
    ("[spin]\nnutation_deg = 90", "spin.nutation_deg"),
    ("[spin]\nnutation_deg = 5\nspin_up_rpm_per_hour = 1", "spin.spin_up_rpm_per_hour"),
    ("[magnetometer]\nrate_hz = 100", "magnetometer.rate_hz"),
    ("[magnetometer]\nnoise_nt = -1", "magnetometer.noise_nt"),
    ("[magnetometer]\nnoise_nt = [1, 2, -3]", "magnetometer.noise_nt"),
    ("[magnetometer]\nbias_nt = [1, 2]", "magnetometer.bias_nt"),
    ("[magnetometer]\nD = [-0.95, 0, 0, 0, 0, 0]", "magnetometer.D"),
    ("[magnetometer]\nlag_s = 5", "magnetometer.lag_s"),
    ('[reference]\nform = "matrix"', "reference.form"),
    ('[field]\nreference_epoch = "x"', "field.reference_epoch"),
    ('[telemetry]\nchannels = ["temprature"]', "telemetry.channels"),
    ('[telemetry]\nchannels = ["temperature"]', "telemetry.channels"),
    ('[telemetry]\nchannels = ["current"]', "telemetry.channels"),
    ('[telemetry]\nchannels = ["torquer"]', "telemetry.channels"),
    ("[[panel]]\nmax_a = 1", "panel[0].normal"),
    ("[torquer]\nperiod_s = 10\non_s = 11", "torquer.on_s"),
    ("[torquer]\nperiod_s = 1\non_s = 0.9\ndecay_s = 0.1", "torquer.decay_s"),
    ("[[step]]\nbias_nt = [1, 2, 3]", "step[0].at_s"),
    ("[[step]]\nat_s = 1\nD = [-0.5, 0, 0, 0, 0, 0]\n[[step]]\nat_s = 2\nD = [-0.45, 0, 0, 0, 0, 0]", "magnetometer.D"),
    ("[random]\nbias_nt = -1", "random.bias_nt"),
    ('[[fault]]\nkind = "drop"\nsigma_s = -1', "fault[0].kind"),
    ('[[fault]]\nkind = "dropout"', "fault[0].probability"),
    ('[[fault]]\nkind = "dropout"\nprobability = 1.1', "fault[0].probability"),
    ('[[fault]]\nkind = "dropout"\nprobability = 0.1\nsigma_s = 1', "fault[0].sigma_s"),
    ('[[fault]]\nkind = "gap"\ntarget = "sun"\nat_s = 1\nfor_s = 1', "fault[0].target"),
]


@pytest.mark.parametrize(("text", "field"), FAULTS, ids=[f"{field}-{i}" for i, (_, field) in enumerate(FAULTS)])
def test_a_fault_is_refused_by_the_name_of_its_field(tmp_path: Path, text: str, field: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_scenario(written(tmp_path, text))
    assert [fault.where for fault in refused.value.faults] == [f"test.toml: {field}"]


def test_a_files_units_become_those_of_the_simulation(tmp_path: Path) -> None:
    text = (
        "[spin]\nrate_rpm = 30\nphase_deg = 90\nspin_up_rpm_per_hour = 60\n[orbit]\naltitude_km = 500\nraan_deg = 180\n"
    )
    scenario = load_scenario(written(tmp_path, text))
    assert scenario.spin.rate_rad_s == pytest.approx(math.pi)
    assert scenario.spin.phase_rad == pytest.approx(math.pi / 2.0)
    assert scenario.spin.acceleration_rad_s2 == pytest.approx(2.0 * math.pi / 3600.0)
    assert isinstance(scenario.orbit, KeplerOrbit)
    assert scenario.orbit.semi_major_km == pytest.approx(6878.137)
    assert scenario.orbit.raan_rad == pytest.approx(math.pi)


def test_defaults_that_follow_from_other_keys(tmp_path: Path) -> None:
    text = "[thermal]\nhot_degc = 30\ncold_degc = -10\n[torquer]\nperiod_s = 20\n"
    effects = load_scenario(written(tmp_path, text)).effects
    assert effects.thermal is not None
    assert effects.thermal.start_degc == 10.0
    assert effects.torquer is not None
    assert effects.torquer.on_s == 10.0


def test_noise_of_a_channel_that_is_not_sent_is_left_out(tmp_path: Path) -> None:
    text = '[telemetry]\nchannels = ["gyro", "sun"]\nsun_noise = 2\ngyro_noise = 3\ntemperature_noise = 1\n'
    plan = load_scenario(written(tmp_path, text)).telemetry
    assert (plan.channels, plan.noise) == ((Channel.SUN, Channel.GYRO), (2.0, 3.0))


def test_all_faults_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as refused:
        load_scenario(written(tmp_path, "duration_s = 0\n[magnetometer]\nrate = 5\n[spin]\nrate_rpm = 1e9\n"))
    assert {f.where.split()[1] for f in refused.value.faults} == {"duration_s", "magnetometer.rate", "spin.rate_rpm"}


def test_a_missing_version_is_named(tmp_path: Path) -> None:
    path = tmp_path / "test.toml"
    path.write_text('description = "test"\n')
    with pytest.raises(ConfigError, match=r"test\.toml: version"):
        load_scenario(path)


def test_an_unknown_name_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="did you mean 'paper'"):
        load_scenario("papper")


def test_random_errors_stay_within_their_limits_and_invertible() -> None:
    scenario = load_scenario("random-errors")
    for seed in range(40):
        sensor = resolve(scenario, seed).sensor
        assert 0.0 < np.linalg.norm(sensor.bias_nt) <= 30000.0
        assert np.max(np.abs(sensor.D)) <= 0.2
        assert np.linalg.eigvalsh(np.eye(3) + symmetric(sensor.D))[0] >= 0.3


def test_errors_that_nearly_fold_the_field_are_drawn_again(tmp_path: Path) -> None:
    """At D up to 0.5 one draw in four leaves an eigenvalue of I + D below 0.3."""
    wild = load_scenario(written(tmp_path, "[random]\nD = 0.5\n"))
    smallest = [np.linalg.eigvalsh(np.eye(3) + symmetric(resolve(wild, seed).sensor.D))[0] for seed in range(60)]
    assert 0.3 <= min(smallest) < 0.5


def test_random_errors_fill_their_range() -> None:
    scenario = load_scenario("random-errors")
    sensors = [resolve(scenario, seed).sensor for seed in range(200)]
    lengths = np.array([np.linalg.norm(sensor.bias_nt) for sensor in sensors])
    assert lengths.min() < 2000.0
    assert lengths.max() > 28000.0
    assert np.mean(lengths) == pytest.approx(15000.0, rel=0.1)
    assert np.abs(np.mean([sensor.D for sensor in sensors], axis=0)).max() < 0.04


def test_the_same_seed_draws_the_same_errors() -> None:
    scenario = load_scenario("random-errors")
    assert resolve(scenario, 7) == resolve(scenario, 7)
    assert resolve(scenario, 7).sensor != resolve(scenario, 8).sensor


def test_fixing_one_random_part_leaves_the_others(tmp_path: Path) -> None:
    both = load_scenario(written(tmp_path, "[random]\nbias_nt = 1000\nD = 0.1\n"))
    one = load_scenario(written(tmp_path, "[random]\nbias_nt = 1000\n"))
    assert resolve(both, 5).sensor.bias_nt == resolve(one, 5).sensor.bias_nt
    assert resolve(both, 5).spin == resolve(one, 5).spin


def test_the_orbit_normal_is_resolved_from_the_orbit() -> None:
    scenario = load_scenario("orbit-normal")
    expected = scenario.orbit.normal_eci(scenario.start_ns)
    assert resolve(scenario, 1).spin.direction_eci == pytest.approx(tuple(expected))


def test_channels_are_read_in_a_fixed_order(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, '[telemetry]\nchannels = ["gyro", "sun"]\nsun_noise = 0.5\n'))
    assert scenario.telemetry.channels == (Channel.SUN, Channel.GYRO)
    assert scenario.telemetry.noise == (0.5, 0.0)


def documented() -> list[str]:
    text = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
    return [block.split("```")[0] for block in text.split("```toml\n")[1:]]


def test_the_documented_scenario_is_the_defaults_with_the_papers_errors(tmp_path: Path) -> None:
    path = tmp_path / "test.toml"
    path.write_text(documented()[0])
    got, paper = load_scenario(path), load_scenario("paper")
    assert (got.orbit, got.spin, got.sensor) == (paper.orbit, paper.spin, paper.sensor)


def test_every_documented_effect_is_accepted(tmp_path: Path) -> None:
    effects = load_scenario(written(tmp_path, documented()[1])).effects
    assert effects.thermal
    assert effects.panels
    assert effects.torquer
    assert effects.steps


def test_every_shipped_scenario_and_every_link_fault_is_documented() -> None:
    text = (Path(__file__).parents[2] / "docs" / "simulator.md").read_text()
    assert [name for name in shipped_scenarios() if f"| `{name}` |" not in text] == []
    assert [kind for kind in FaultKind if f"| `{kind}` |" not in text] == []
