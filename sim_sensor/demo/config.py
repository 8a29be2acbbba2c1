"""The daemon's configuration for a simulated craft: what its operator would know, and nothing of the truth."""

from __future__ import annotations

import json
import math
from pathlib import Path

from sim_sensor.scenario import Scenario

__all__ = ["daemon_config", "zenoh_settings"]

_MIN_RATE_RPM = 0.01  # below this the daemon takes a craft as one that does not spin
_WAIT_US = 500_000  # how long a message waits for room in the sender's queue before it is dropped [us]


def daemon_config(scenario: Scenario, link: str, csv: Path) -> str:
    """TOML for ``magcal run``: the link, the craft's name, the data sheet's noise, the commanded spin.

    Parameters
    ----------
    scenario: a resolved scenario; its errors, orbit and faults are not looked at.
    link: address of the daemon's end.
    csv: file that the daemon writes one row per tick into.
    """
    noise_nt = math.sqrt(sum(noise**2 for noise in scenario.sensor.noise_nt) / 3.0)
    lines = ["version = 1", f"link = {json.dumps(link)}", "", "[[craft]]", f"name = {json.dumps(scenario.craft)}"]
    if noise_nt > 0.0:
        lines += ["[craft.sensor]", f"noise_nt = {noise_nt!r}"]
    rate_rpm = scenario.spin.rate_rad_s * 60.0 / math.tau
    if abs(rate_rpm) >= _MIN_RATE_RPM:
        lines += ["[craft.spin]", f"axis = {list(scenario.spin.axis_body)!r}", f"rate_rpm = {rate_rpm!r}"]
    lines += ["", "[output]", f"csv = {json.dumps(str(csv))}", "status_period_s = 1.0"]
    return "\n".join(lines) + "\n"


def zenoh_settings() -> str:
    """zenoh configuration (JSON5) for both ends: wait for room in the sender's queue instead of dropping.

    With zenoh's own 1 ms, a machine busy with other work dropped 0.5 to 2.5 % of 1000 messages at 500 Hz; with 200 ms
    none.  At 300 times real time a sample that is recovered later comes too late for its tick.
    """
    queue = {"congestion_control": {"drop": {"wait_before_drop": _WAIT_US}}}
    return json.dumps({"transport": {"link": {"tx": {"queue": queue}}}}, indent=2) + "\n"
