"""A replay of a recorded session is the live run, byte for byte."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from magcal_service.cli.__main__ import main
from magcal_service.config.settings import FilterConfig, TickConfig, TrustConfig
from magcal_service.recordings.reader import read_recording
from magcal_service.wire.messages import MagnetometerSample, Message
from tests.daemon.magnetometer_streams import PAIR
from tests.daemon.magnetometer_streams import messages as pair_messages
from tests.recordings.sessions import command, craft, record, stream


def replayed(*arguments: str, out: Path) -> bytes:
    assert main(["replay", *arguments, "--out", str(out)]) in (0, 3)
    return out.read_bytes()


def test_a_replay_writes_the_rows_of_the_live_run(tmp_path: Path) -> None:
    (file,) = record(tmp_path / "rec", stream(600), csv=tmp_path / "live.csv")
    live = (tmp_path / "live.csv").read_bytes()
    assert len(live.splitlines()) == 601
    assert replayed(str(file), out=tmp_path / "replay.csv") == live


def test_settings_that_are_not_the_defaults_are_replayed_too(tmp_path: Path) -> None:
    own = replace(
        craft(),
        filter=FilterConfig(start_s=30.0, prior_bias_nt=12345.678, gate_sigma=5.1, adaptive=True),
        ticks=TickConfig(hold_s=1.0),
        trust=TrustConfig(min_ticks=20),
    )
    (file,) = record(tmp_path / "rec", stream(600), [own], csv=tmp_path / "live.csv")
    assert replayed(str(file), out=tmp_path / "replay.csv") == (tmp_path / "live.csv").read_bytes()


def test_commands_take_effect_where_they_did(tmp_path: Path) -> None:
    samples = stream(300)
    session: list[Message] = [*samples[:200], command("freeze", 0), *samples[200:300], command("resume", 1)]
    session += [*samples[300:400], command("reset", 2), *samples[400:]]
    (file,) = record(tmp_path / "rec", session, csv=tmp_path / "live.csv")
    live = (tmp_path / "live.csv").read_bytes()
    assert replayed(str(file), out=tmp_path / "replay.csv") == live
    record(tmp_path / "plain", samples, csv=tmp_path / "plain.csv")
    assert live != (tmp_path / "plain.csv").read_bytes()


def test_a_checkpoint_of_the_session_is_there_for_the_command_that_goes_back_to_it(tmp_path: Path) -> None:
    samples = stream(600)
    session: list[Message] = [
        *samples[:900],
        command("checkpoint", 0, name="before"),
        command("process_noise", 1, D=1e-4),
    ]
    session += [*samples[900:1100], command("rollback", 2, name="before"), *samples[1100:]]
    (file,) = record(tmp_path / "rec", session, csv=tmp_path / "live.csv", state=tmp_path / "state")
    live = (tmp_path / "live.csv").read_bytes()
    assert replayed(str(file), out=tmp_path / "replay.csv") == live
    record(tmp_path / "plain", samples, csv=tmp_path / "plain.csv")
    assert live != (tmp_path / "plain.csv").read_bytes()


def test_a_command_that_was_refused_is_not_carried_out_again(tmp_path: Path) -> None:
    samples = stream(600)
    checkpoint, rollback = command("checkpoint", 0, name="before"), command("rollback", 1, name="before")
    session: list[Message] = [*samples[:900], checkpoint, *samples[900:1100], rollback, *samples[1100:]]
    (file,) = record(tmp_path / "rec", session, csv=tmp_path / "live.csv")  # no [state]: both are refused
    assert replayed(str(file), out=tmp_path / "replay.csv") == (tmp_path / "live.csv").read_bytes()


def test_a_session_that_began_with_a_checkpoint_is_replayed_from_it(tmp_path: Path) -> None:
    samples = stream(600)
    record(tmp_path / "first", samples[:800], state=tmp_path / "state")
    (file,) = record(tmp_path / "second", samples[800:], csv=tmp_path / "live.csv", state=tmp_path / "state")
    header, *rows = (tmp_path / "live.csv").read_text().splitlines()
    assert int(rows[0].split(",")[header.split(",").index("tick")]) > 300
    assert replayed(str(file), out=tmp_path / "replay.csv") == (tmp_path / "live.csv").read_bytes()
    assert main(["record", "check", str(file)]) == 0


def test_a_state_that_goes_with_another_configuration_is_not_taken_up_and_said_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record(tmp_path / "first", stream(200)[:300], state=tmp_path / "state")
    record(tmp_path / "second", stream(200)[300:], state=tmp_path / "state")
    (file,) = (tmp_path / "second").glob("*.mcap")
    config = tmp_path / "magcal.toml"
    config.write_text('version = 1\n[[craft]]\nname = "paper"\n')
    main(["replay", str(file), "--config", str(config)])
    assert "which does not go with another configuration" in capsys.readouterr().out


def test_a_replay_goes_on_over_the_command_that_ended_the_daemon(tmp_path: Path) -> None:
    samples = stream(600)
    parts = record(tmp_path / "one", [*samples[:600], command("shutdown")], state=tmp_path / "state")
    parts += record(tmp_path / "two", samples[600:], state=tmp_path / "state")
    assert main(["record", "join", *map(str, parts), "--out", str(tmp_path / "all.mcap")]) == 0
    rows = replayed(str(tmp_path / "all.mcap"), out=tmp_path / "replay.csv").splitlines()
    assert len(rows) == 601


@pytest.mark.parametrize("scenario", ["lossy-link", "stale-reference"])
def test_a_bad_link_is_replayed_with_its_faults(scenario: str, tmp_path: Path) -> None:
    (file,) = record(tmp_path / "rec", stream(400, scenario), csv=tmp_path / "live.csv")
    assert replayed(str(file), out=tmp_path / "replay.csv") == (tmp_path / "live.csv").read_bytes()


def test_each_craft_of_a_session_is_replayed_by_its_name(tmp_path: Path) -> None:
    crafts = [craft("alpha"), replace(craft("beta"), spin=None)]
    both = zip(stream(200, name="alpha"), stream(200, name="beta", seed=6), strict=True)
    (file,) = record(tmp_path / "rec", [one for pair in both for one in pair], crafts, csv=tmp_path / "live.csv")
    header, *rows = (tmp_path / "live.csv").read_bytes().splitlines(keepends=True)
    for name in ("alpha", "beta"):
        wanted = [row for row in rows if row.startswith(name.encode())]
        assert len(wanted) == 200
        assert replayed(str(file), "--craft", name, out=tmp_path / name) == b"".join([header, *wanted])


def test_the_parts_of_a_rotated_session_joined_are_the_session(tmp_path: Path) -> None:
    parts = record(tmp_path / "rec", stream(600), csv=tmp_path / "live.csv", file_mb=0.02, flush_s=0.0005)
    assert len(parts) > 1
    assert main(["record", "join", *map(str, parts), "--out", str(tmp_path / "all.mcap")]) == 0
    assert replayed(str(tmp_path / "all.mcap"), out=tmp_path / "replay.csv") == (tmp_path / "live.csv").read_bytes()


def test_a_descriptor_of_the_session_changes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (file,) = record(tmp_path, stream(200), csv=tmp_path / "live.csv")
    assert main(["record", "describe", str(file)]) == 0
    (tmp_path / "RECORDING.toml").write_text(capsys.readouterr().out)
    assert (
        replayed(str(tmp_path / "RECORDING.toml"), out=tmp_path / "replay.csv") == (tmp_path / "live.csv").read_bytes()
    )


def test_a_daemon_on_a_session_writes_the_rows_of_the_live_run(tmp_path: Path) -> None:
    (file,) = record(tmp_path / "rec", stream(200), csv=tmp_path / "live.csv")
    config = tmp_path / "magcal.toml"
    axis = list(craft().spin.axis)  # type: ignore[union-attr]
    config.write_text(
        f'version = 1\nlink = "recording:{file}"\n[[craft]]\nname = "paper"\n[craft.sensor]\nnoise_nt = 300.0\n'
        f'[craft.spin]\naxis = {axis}\nrate_rpm = 7.5\n[output]\ncsv = "{tmp_path}/daemon.csv"\n'
    )
    assert main(["run", "--config", str(config)]) == 0
    assert (tmp_path / "daemon.csv").read_bytes() == (tmp_path / "live.csv").read_bytes()


def test_of_several_magnetometers_a_replay_writes_the_rows_of_all_and_shows_the_one_that_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the second session each of them begins with a state of its own."""
    samples = pair_messages(400.0)
    for folder, part in (("one", samples[:600]), ("two", samples[600:])):
        (file,) = record(tmp_path / folder, part, [PAIR], csv=tmp_path / f"{folder}.csv", state=tmp_path / "state")
        live = (tmp_path / f"{folder}.csv").read_bytes()
        assert replayed(str(file), out=tmp_path / "replay.csv") == live
        assert {row.split(b",")[0] for row in live.splitlines()[1:]} == {b"pair", b"pair/mag2"}
    capsys.readouterr()
    (first,) = (tmp_path / "one").glob("*.mcap")
    assert main(["calibrate", str(first), "--source", "mag3"]) == 2
    assert "source: 'mag3' is refused; did you mean 'mag'? known: mag, mag2" in capsys.readouterr().err
    for source in ("mag", "mag2"):
        capsys.readouterr()
        main(["calibrate", str(first), "--source", source])
        told = capsys.readouterr().out
        other = {"mag": "mag2", "mag2": "mag"}[source]
        assert f"magnetometer {source}; --source chooses another: {other}" in told
        mine = [one for one in samples[:600] if isinstance(one, MagnetometerSample) and one.source == source]
        rows = read_recording(first, source=source).field_body_nt.tolist()
        assert rows == [list(one.field_body_nt) for one in mine]
