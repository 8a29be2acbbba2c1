"""Keys that others can read, configurations and directories that everybody can write: refused before any use."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from magcal_service.base.errors import ConfigError
from magcal_service.config.private_files import (
    check_input,
    check_secret,
    check_state_directory,
    check_unaltered,
    check_way,
    read_key,
)
from magcal_service.links import Role, open_link
from tests.config.test_config_physics import EXAMPLE

KEY = "00112233445566778899aabbccddeeff"
NOBODY = 65534
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another group")


def secret(folder: Path, mode: int, text: str = KEY) -> Path:
    path = folder / "secret"
    path.write_text(text)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("mode", [0o604, 0o602, 0o644, 0o666])
def test_a_secret_that_all_can_reach_is_refused_with_its_mode(mode: int, tmp_path: Path) -> None:
    """One line names the file, its mode and the mend."""
    path = secret(tmp_path, mode)
    with pytest.raises(ConfigError, match=f"{path}: 'mode {mode:04o}' is refused; .*chmod 0600 {path}"):
        check_secret(path)


@as_root
def test_a_secret_of_a_group_is_refused(tmp_path: Path) -> None:
    """A group of people is others too."""
    path = secret(tmp_path, 0o640)
    os.chown(path, 0, NOBODY)
    with pytest.raises(ConfigError, match="mode 0640"):
        check_secret(path)


@as_root
def test_a_credential_as_systemd_hands_it_over_is_accepted(tmp_path: Path) -> None:
    """An access list for the service's user shows as rights of root's group."""
    path = secret(tmp_path, 0o440)
    os.chown(path, 0, 0)
    check_secret(path)


@pytest.mark.parametrize("mode", [0o600, 0o400])
def test_a_secret_of_its_owner_is_accepted(mode: int, tmp_path: Path) -> None:
    """Read and write for the owner alone is what is asked for."""
    check_secret(secret(tmp_path, mode))
    assert read_key(secret(tmp_path, 0o600)) == bytes.fromhex(KEY)


@pytest.mark.parametrize(
    ("text", "told"),
    [("", "0 bytes"), (KEY[:-2], "15 bytes"), ("00" * 65, "65 bytes"), ("not hex!", "hexadecimal"), ("é", "hexadec")],
)
def test_a_key_that_is_none_is_refused(text: str, told: str, tmp_path: Path) -> None:
    """Too short, too long, or no hexadecimal: each is told with the way to make one."""
    with pytest.raises(ConfigError, match=f"{told}.*openssl rand -hex 32"):
        read_key(secret(tmp_path, 0o600, text))


def test_a_secret_that_is_not_there_is_refused(tmp_path: Path) -> None:
    """A missing file and a directory are told as such."""
    with pytest.raises(ConfigError, match="there is no such file"):
        check_secret(tmp_path / "absent")
    with pytest.raises(ConfigError, match="not a file"):
        check_secret(tmp_path)
    with pytest.raises(ConfigError, match="there is no such file"):
        read_key(tmp_path / "absent")


def test_a_state_directory_that_everybody_can_write_is_refused(tmp_path: Path) -> None:
    """What is restored has to be the daemon's own; the sticky bit is no help against planted files."""
    check_state_directory(tmp_path)
    for mode in (0o777, 0o1777):
        tmp_path.chmod(mode)
        with pytest.raises(ConfigError, match=f"mode {mode:04o}"):
            check_state_directory(tmp_path)
    tmp_path.chmod(0o700)
    with pytest.raises(ConfigError, match="not a directory"):
        check_state_directory(secret(tmp_path, 0o600))


def test_a_configuration_that_everybody_can_write_is_refused(tmp_path: Path) -> None:
    """The daemon does not take its rules from a file that anybody may have changed."""
    config = tmp_path / "magcal.toml"
    config.write_text('version = 1\nlink = "loop:x"\n[[craft]]\nname = "demo"\n')
    config.chmod(0o646)
    command = [sys.executable, "-m", "magcal_service.cli", "run", "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "mode 0646" in done.stderr
    config.chmod(0o644)
    check_unaltered(config)


@pytest.mark.parametrize("table", ["state", "record"])
def test_a_daemon_takes_up_no_state_that_everybody_could_have_written(table: str, tmp_path: Path) -> None:
    """A folder for checkpoints or recordings with mode 0777 stops the daemon before it reads from it."""
    folder = tmp_path / "kept"
    folder.mkdir()
    folder.chmod(0o777)
    config = tmp_path / "magcal.toml"
    text = f'version = 1\nlink = "loop:x"\n[[craft]]\nname = "demo"\n[{table}]\ndirectory = "{folder}"\n'
    config.write_text(text)
    command = [sys.executable, "-m", "magcal_service.cli", "run", "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, list(folder.iterdir())) == (2, [])
    assert f"{folder}: 'mode 0777' is refused" in done.stderr


@pytest.mark.parametrize(
    "content",
    [
        "{transport: {link: {tls: {listen_private_key: 'SECRET'}}}}",
        "{transport: {link: {tls: {connect_private_key: 'SECRET'}}}}",
        "{transport: {auth: {usrpwd: {dictionary_file: 'SECRET'}}}}",
    ],
)
def test_a_zenoh_link_looks_after_the_files_it_names(content: str, tmp_path: Path) -> None:
    """A readable private key or password file that a zenoh configuration names stops the link before it opens."""
    config = tmp_path / "zenoh.json5"
    config.write_text(content.replace("SECRET", str(secret(tmp_path, 0o644))))
    with pytest.raises(ConfigError, match=r"secret: 'mode 0644'"):
        open_link(f"zenoh:tcp/127.0.0.1:0?listen=yes&config={config}", Role.SERVICE)


def test_a_zenoh_configuration_with_a_password_in_it_is_a_secret_itself(tmp_path: Path) -> None:
    """A client's password stands in the file itself; others must not read it."""
    config = tmp_path / "zenoh.json5"
    config.write_text("{transport: {auth: {usrpwd: {user: 'feeder', password: 'corn'}}}}")
    config.chmod(0o644)
    with pytest.raises(ConfigError, match=r"zenoh.json5: 'mode 0644'"):
        open_link(f"zenoh:tcp/127.0.0.1:0?listen=yes&config={config}", Role.SERVICE)


def test_a_zenoh_configuration_that_everybody_can_write_is_refused(tmp_path: Path) -> None:
    """The file with the access rules is not anybody's to change."""
    config = tmp_path / "zenoh.json5"
    config.write_text("{}")
    config.chmod(0o666)
    with pytest.raises(ConfigError, match=r"zenoh.json5: 'mode 0666'"):
        open_link(f"zenoh:tcp/127.0.0.1:0?listen=yes&config={config}", Role.SERVICE)


def test_a_folder_above_that_everybody_can_write_is_refused(tmp_path: Path) -> None:
    """Whoever can rename the folder above puts another in its place; what is not there yet is nobody's."""
    open_one = tmp_path / "open"
    inner = open_one / "inner" / "state"
    inner.mkdir(parents=True)
    check_way(inner)
    open_one.chmod(0o777)
    with pytest.raises(ConfigError, match=f"{open_one}: 'mode 0777' is refused; above {inner}, .*chmod o-w {open_one}"):
        check_way(inner)
    check_way(open_one)  # what stands in it is looked after by ``check_state_directory``
    open_one.chmod(0o1777)
    check_way(inner)
    check_way(open_one / "absent" / "state")


@as_root
def test_what_somebody_else_owns_in_a_folder_as_tmp_is_refused(tmp_path: Path) -> None:
    open_one = tmp_path / "open"
    inner = open_one / "inner"
    (inner / "state").mkdir(parents=True)
    open_one.chmod(0o1777)
    os.chown(inner, NOBODY, NOBODY)
    with pytest.raises(ConfigError, match=f"{inner}: 'owner {NOBODY}' is refused"):
        check_way(inner / "state")


def test_a_link_is_followed_to_folders_that_everybody_can_write(tmp_path: Path) -> None:
    """Absolute and relative ones, with steps up, and a circle."""
    real = tmp_path / "open" / "real"
    real.mkdir(parents=True)
    real.parent.chmod(0o777)
    holder = tmp_path / "holder"
    holder.mkdir()
    (holder / "absolute").symlink_to(real)
    (holder / "relative").symlink_to("../open/real")
    (holder / "round").symlink_to("round")
    for name in ("absolute", "relative"):
        with pytest.raises(ConfigError, match=f"{real.parent}: 'mode 0777'"):
            check_way(holder / name / "state")
    with pytest.raises(ConfigError, match="links in a circle"):
        check_way(holder / "round")
    real.parent.chmod(0o755)
    check_way(holder / "relative" / "state")
    holder.chmod(0o777)
    with pytest.raises(ConfigError, match=f"{holder}: 'mode 0777'"):
        check_way(holder / "relative" / "state")


def test_a_physics_file_is_a_file_that_not_everybody_can_write(tmp_path: Path) -> None:
    path = secret(tmp_path, 0o644)
    check_input(path)
    path.chmod(0o646)
    with pytest.raises(ConfigError, match="mode 0646"):
        check_input(path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="pipe: 'not a file' is refused"):
        check_input(tmp_path / "pipe")
    with pytest.raises(ConfigError, match="absent: there is no such file"):
        check_input(tmp_path / "absent")


def test_a_daemon_takes_up_nothing_from_a_craft_folder_that_everybody_can_write(tmp_path: Path) -> None:
    (tmp_path / "kept" / "demo").mkdir(parents=True)
    (tmp_path / "kept" / "demo").chmod(0o777)
    assert "demo: 'mode 0777' is refused" in _refusal(tmp_path, "")


def test_a_daemon_takes_no_physics_that_everybody_can_write(tmp_path: Path) -> None:
    path = tmp_path / "physics.toml"
    path.write_text(EXAMPLE)
    path.chmod(0o666)
    assert f"{path}: 'mode 0666' is refused" in _refusal(tmp_path, f'physics = "{path}"\n')


def _refusal(folder: Path, craft: str) -> str:
    """What ``magcal run`` says as it ends with 2."""
    config = folder / "magcal.toml"
    state = f'[state]\ndirectory = "{folder / "kept"}"\n'
    config.write_text(f'version = 1\nlink = "loop:x"\n{state}[[craft]]\nname = "demo"\n{craft}')
    command = [sys.executable, "-m", "magcal_service.cli", "run", "--config", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    return done.stderr


def test_a_pipe_is_no_key_and_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "key", 0o600)
    with pytest.raises(ConfigError, match="not a file"):
        read_key(tmp_path / "key")
