"""``magcal send`` gives a running daemon its commands, and says what the daemon answered."""

from __future__ import annotations

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.cli.asking import Desk
from magcal_service.cli.send import commands_text, request
from magcal_service.daemon.command_table import COMMANDS
from magcal_service.daemon.outbox import Stamp, command_reply
from magcal_service.links import Role, open_link
from magcal_service.wire.messages import Clock, Command
from sim_sensor.demo.pty_pair import PtyPair
from tests.cli.cli_inputs import run
from tests.daemon.service_processes import daemon, free_port
from tests.physics.live_models import THERMAL, physics

CRAFT = 'version = 1\nlink = {link}\n[[craft]]\nname = "paper"\n[output]\nstatus_period_s = 1.0\n'


def test_commands_over_zenoh_are_answered_with_what_has_changed(tmp_path: Path) -> None:
    link = f"zenoh:tcp/127.0.0.1:{free_port()}"
    config = tmp_path / "magcal.toml"
    config.write_text(
        CRAFT.format(link=json.dumps(link)).replace('"paper"', f'"paper"\nphysics = "{tmp_path}/physics.toml"')
    )
    (tmp_path / "physics.toml").write_text(physics(THERMAL[0], origin_ns=1_750_000_000_000_000_000).text)
    other = replace(THERMAL[0], amplitudes={"nt_per_k": np.array([1.0, 2.0, 3.0])})
    (tmp_path / "other.toml").write_text(physics(other, origin_ns=1_750_000_000_000_000_000).text)

    def sent(*arguments: str) -> tuple[int, str]:
        done = run("send", "paper", *arguments, "--config", config)
        return done.code, done.out

    with daemon(config) as process:
        code, said = sent("process_noise", "bias_nt=0.5")
        first, before = said.splitlines()
        assert code == 0
        assert first.startswith("paper: process_noise accepted: process_noise: bias 0.5 nT/sqrt(s), D 0 /sqrt(s); ")
        assert before.startswith("  before: ")
        assert "not_started" in before
        assert sent("freeze")[1].startswith("paper: freeze accepted: frozen, ")
        code, said = sent("resume", "--as", "me")
        assert said.startswith("paper: resume accepted: resumed; ")
        assert "frozen" not in said.splitlines()[0]
        loaded = sent("load_physics", "name=other.toml")[1]
        assert f"accepted: physics_loaded: other.toml: {other.effect} by {other.driver}; " in loaded
        assert "none.toml: there is no such file or folder; " in sent("load_physics", "name=none.toml")[1]
        assert sent("process_noise", "D=5") == (2, "paper: process_noise REFUSED: D is 5.0; 0 to 0.01 is accepted\n")
        asked = json.loads(sent("status", "--json")[1])
        assert (asked["accepted"], asked["command"], asked["text"]) == (True, "status", asked["before"])
        wrong = run("send", "papre", "freeze", "--link", link, "--timeout", "60")
        assert (wrong.code, wrong.out) == (2, "")
        assert "no daemon there serves craft papre; served: paper" in wrong.err
        assert sent("shutdown")[0] == 0
        deadline = time.monotonic() + 120.0
        while process.running and time.monotonic() < deadline:
            time.sleep(0.02)
        assert process.stop() == 0
    silent = run("send", "paper", "freeze", "--link", link, "--timeout", "0.5")
    assert silent.code == 2
    assert "is the daemon running?" in silent.err


def test_a_sealed_line_takes_what_is_sealed_alone(tmp_path: Path) -> None:
    key = tmp_path / "line.key"
    key.write_text("ab" * 32)
    key.chmod(0o600)
    with PtyPair() as pair:
        ends = [f"serial:{path}?key={key}&counter={tmp_path / f'{n}.counter'}" for n, path in enumerate(pair.paths)]
        config = tmp_path / "magcal.toml"
        config.write_text(CRAFT.format(link=json.dumps(ends[0])))
        with daemon(config):
            refused = run("send", "paper", "reset", "--link", f"serial:{pair.paths[1]}", "--timeout", "60")
            assert (refused.code, refused.out.startswith("paper: reset REFUSED: unsealed")) == (2, True), refused
            done = run("send", "paper", "reset", "--link", ends[1], "--timeout", "60")
            assert (done.code, done.out.startswith("paper: reset accepted: reset; not_started")) == (0, True), done
    needs = run("send", "paper", "reset", "--config", config)
    assert needs.code == 2
    assert "give --link with the end of a viewer" in needs.err


@pytest.mark.parametrize(
    ("name", "given", "told"),
    [
        ("freez", [], "COMMAND: 'freez' is refused; did you mean 'freeze'?"),
        ("freeze", ["now"], "freeze: 'now' is refused; KEY=VALUE is accepted"),
        ("process_noise", ["bias=1"], "process_noise: 'bias' is refused; unknown argument; did you mean 'bias_nt'?"),
        ("process_noise", ["D=x"], "process_noise: D: 'x' is refused; 0 to 0.01 /sqrt(s) is accepted"),
        ("process_noise", ["D=0", "D=0"], "process_noise: D: '0' is refused; it is given twice"),
        ("process_noise", ["bias_nt=1e999"], "process_noise: bias_nt: '1e999' is refused; 0 to 1000 nT/sqrt(s)"),
        ("process_noise", ["bias_nt=1_0"], "process_noise: bias_nt: '1_0' is refused"),
        ("checkpoint", [], "checkpoint: name: missing; 1 to 32 of A-Z a-z 0-9 _ - is accepted"),
    ],
)
def test_what_no_daemon_would_take_is_refused_before_it_is_asked(name: str, given: list[str], told: str) -> None:
    with pytest.raises(ConfigError, match=r".") as caught:
        request(name, given)
    assert told in str(caught.value)


def test_two_operators_hear_their_own_answers_alone() -> None:
    with open_link("loop:two", Role.SERVICE, crafts=["a"]) as service, open_link("loop:two", Role.VIEWER) as link:
        one, two = Desk(link, "send"), Desk(link, "send")
        numbers = one.give("a", "freeze"), two.give("a", "reset")
        commands = service.receive(0.1)
        assert len({(each.source, each.sequence) for each in commands}) == 2
        stamp = Stamp("a", 0, 0, Clock.ELAPSED)
        for each in commands:
            assert isinstance(each, Command)
            service.send(command_reply(stamp, each, "", each.name))
        heard = two.answer("a", numbers[1], 1.0)
        assert heard is not None
        assert heard.text == "reset"
        with pytest.raises(ConfigError, match="checkpoint: arguments"):
            one.give("a", "checkpoint", {"name": "x" * 4000})


def test_texts_stay_texts_and_numbers_become_numbers() -> None:
    assert request("checkpoint", ["name=7", "source=mag2"]) == {"name": "7", "source": "mag2"}
    assert request("process_noise", ["bias_nt=1e-2"]) == {"bias_nt": 0.01}


def test_the_help_has_every_command_and_argument() -> None:
    text = commands_text()
    for name, spec in COMMANDS.items():
        assert f"  {name:<14}  {spec.does}" in text
        assert all(f"{key}=VALUE: {one.accepted}" in text for key, one in spec.arguments.items())


def test_ends_of_one_process_never_have_the_same_digits() -> None:
    """Two that begin within a millisecond have the same number, too."""
    with open_link("loop:ends", Role.SERVICE, crafts=["a"]) as service, open_link("loop:ends", Role.VIEWER) as link:
        for _ in range(256):
            Desk(link, "send").give("a", "freeze")
        assert len({each.source for each in service.receive(0.1)}) == 256
