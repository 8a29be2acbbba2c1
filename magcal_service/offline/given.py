"""Nine errors out of a result's file, with what the file says of their use: for ``apply`` and ``export``."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from magcal_service.base.errors import MISSING, Fault, FileFault, InputRefusedError, Lacking
from magcal_service.base.typed_toml import TomlKind
from magcal_service.base.typed_toml.kind import refuse_kinds
from magcal_service.model import BIAS, D_ALL, STATE_SIZE, Array
from magcal_service.offline.json_file import parsed_json, refuse_others, refuse_strange
from magcal_service.offline.nine_errors import NineErrors
from magcal_service.offline.result_head import DIAGNOSIS, SCHEMAS, head, schema_of
from magcal_service.physics.apply.advice import doubts_of
from magcal_service.physics.apply.model_file import PhysicsModel, parse_model
from magcal_service.recordings.recording import Recording
from magcal_service.wire.messages import Verdict

_NO_ESTIMATE: Final = "it has no estimate, and its remedy says why; a result with an estimate is accepted"

_LARGEST_FILE: Final = 8 << 20
"""A result is some 10 kB [bytes]: what is larger than 8 MiB is something else."""

_LARGEST_BIAS_NT: Final = 1e6  # 1 mT, as for a recording
_LARGEST_D: Final = 10.0  # a scale of eleven: beyond, no gate of any method lets an estimate pass

_SMALLEST_NOISE_NT, _LARGEST_NOISE_NT = 1e-3, 1e5  # of [craft.sensor] noise_nt, and what a residual may show below it

ACCEPTED: Final = "what calibrate --json or diagnose --out writes is accepted: a .json, or physics.toml"


@dataclass(frozen=True, slots=True, eq=False)
class Given(NineErrors):
    """Nine errors as a file has them.

    Parameters
    ----------
    name, sha256: of the file.
    x, covariance: state (9,) and covariance (9, 9) [nT, -].
    whole: whether the file has the covariance; where not, it is that of the sigmas alone.
    noise_nt: noise of a sample, 1 sigma per axis [nT]; None where the file does not say.
    trusted, reasons: as the result says.
    protection_nt, protection_by: the protection level of the estimate; None where the file has none.
    model: of a ``physics.toml``; None of a result.
    source: of which magnetometer it is; empty where the file does not say.
    craft: whose it is; empty where the file does not say.
    schema: that the result keeps; empty where it says none that is known.
    """

    name: str
    sha256: str
    x: Array
    covariance: Array
    whole: bool
    noise_nt: float | None
    trusted: bool
    reasons: tuple[str, ...]
    protection_nt: float | None = None
    protection_by: str | None = None
    model: PhysicsModel | None = None
    schema: str = ""
    source: str = ""
    craft: str = ""

    @property
    def verdict(self) -> Verdict:
        """Of vectors that are made by it."""
        return Verdict.TRUSTED if self.trusted else Verdict.DOUBTFUL

    @property
    def matrix(self) -> Array:
        """I + D (3, 3) [-]."""
        return np.asarray(np.eye(3) + self.D)

    @property
    def offset_nt(self) -> Array:
        """(I + D)^-1 b (3,) [nT]: what is subtracted before the matrix, w = (I + D)(B - offset)."""
        return np.asarray(np.linalg.solve(self.matrix, self.bias_nt))

    def refuse_other_craft(self, recording: Recording) -> None:
        """Raise ``InputRefusedError`` where result and recording name different craft."""
        of_craft = recording.of_craft
        if self.craft and of_craft and self.craft != of_craft:
            accepted = f"a result of craft {of_craft} is accepted; where both are one craft, give it one name"
            raise InputRefusedError([Fault(f"{self.name}: craft", self.craft, accepted)])

    def doubts(self) -> list[str]:
        """Why it must not be trusted, a line each; none where it may be.  Those of a diagnosis are in its own words."""
        if self.trusted:
            return []
        names = ", ".join(self.reasons)
        if names and (self.model is not None or self.schema == DIAGNOSIS):
            return doubts_of(names)
        return [f"not to be trusted: {names or 'its file does not say why'}"]


def read_given(path: Path) -> Given:
    """Read a result of ``calibrate`` or ``diagnose``, or a ``physics.toml``.

    Raises ``InputRefusedError`` where the file cannot be read, is none of these, has no estimate, is of several
    recordings, or names effects that only ``physics.toml`` can subtract.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(_LARGEST_FILE + 1)
            size = max(len(raw), path.stat().st_size)
    except OSError as error:
        within = sorted(one.name for one in path.glob("*") if one.suffix in {".toml", ".json"}) if path.is_dir() else []
        accepted = f"give one of its files: {', '.join(within)}" if within else "give a readable file"
        raise InputRefusedError([FileFault(str(path), error, accepted)]) from None
    if len(raw) > _LARGEST_FILE:
        raise InputRefusedError([Fault(str(path), f"{size} bytes", f"at most {_LARGEST_FILE} bytes; {ACCEPTED}")])
    digest = hashlib.sha256(raw).hexdigest()
    if path.suffix.lower() == ".toml":
        refuse_kinds(path, TomlKind.MODEL, "so is the .json that calibrate --json or diagnose --out writes")
        return _of_model(path.name, digest, parse_model(raw, path.name))
    content = parsed_json(raw, str(path), ACCEPTED)
    refuse_others(content, str(path), ACCEPTED)
    if not {"fit", "bias_nt", "D", "verdict", "recordings"} & content.keys():
        refuse_strange(content, str(path), ACCEPTED)
    return _of_result(path, digest, content)


def _of_model(name: str, digest: str, model: PhysicsModel) -> Given:
    doubts = (model.doubts,) if model.doubts else ()
    covariance = np.diag(np.square(model.sigma))
    return Given(
        name,
        digest,
        model.x,
        covariance,
        False,
        model.sample_noise_nt,
        not doubts,
        doubts,
        model=model,
        craft=model.craft,
    )


def _of_result(path: Path, digest: str, content: dict[str, Any]) -> Given:
    if isinstance(content.get("recordings"), list):
        accepted = "the result of one recording is accepted; give its physics.toml, or calibrate it alone"
        raise InputRefusedError([Fault(f"{path}: recordings", len(content["recordings"]), accepted)])
    fit = content.get("fit")
    if content.get("effects") and isinstance(fit, dict):
        accepted = "its effects are subtracted by the physics.toml that diagnose wrote beside it; give that file"
        raise InputRefusedError([Fault(f"{path}: effects", len(content["effects"]), accepted)])
    numbers = fit if isinstance(fit, dict) else content
    if content.get("verdict") == Verdict.NOT_STARTED:
        raise InputRefusedError([Fault(f"{path}: verdict", "not_started", _NO_ESTIMATE)])
    reading = _Reading(path)
    bias = reading.array(numbers, "bias_nt", (3,), _LARGEST_BIAS_NT)
    d = reading.array(numbers, "D", (3, 3), _LARGEST_D)
    stated = numbers.get("sigma")
    sigma: dict[str, Any] = stated if isinstance(stated, dict) else {}
    covariance, whole = None, "covariance" in content
    if whole:
        covariance = reading.array(content, "covariance", (STATE_SIZE, STATE_SIZE), _LARGEST_BIAS_NT**2)
    else:
        sigmas = _state(
            reading.array(sigma, "bias_nt", (3,), _LARGEST_BIAS_NT), reading.array(sigma, "D", (3, 3), _LARGEST_D)
        )
        covariance = np.diag(np.square(sigmas))
    levels = content.get("residual_rms_nt")
    floor = ("noise_floor", levels) if isinstance(levels, dict) else ("noise_floor_nt", numbers)
    noise = reading.number(floor[1], floor[0], _SMALLEST_NOISE_NT, _LARGEST_NOISE_NT)
    level = reading.number(content, "protection_nt", 0.0, _LARGEST_BIAS_NT)
    reasons = reading.texts(content, "reasons")
    reading.covariance(covariance)
    reading.head(content)
    reading.done()
    if not np.allclose(d, d.T, rtol=0.0, atol=1e-9):
        raise InputRefusedError([Fault(f"{path}: D", d.tolist(), "a symmetric matrix is accepted")])
    if np.linalg.eigvalsh(np.eye(3) + d)[0] <= 0.0:
        raise InputRefusedError([Fault(f"{path}: D", d.tolist(), "I + D with eigenvalues above 0 is accepted")])
    hazard = content.get("protection_by")
    return Given(
        path.name,
        digest,
        _state(bias, d),
        covariance,
        whole,
        noise,
        _is_trusted(content, reasons),
        reasons,
        level,
        hazard if isinstance(hazard, str) else None,
        schema=schema_of(content),
        source=content["source"] if isinstance(content.get("source"), str) else "",
        craft=content["craft"] if isinstance(content.get("craft"), str) else "",
    )


def _is_trusted(content: dict[str, Any], reasons: tuple[str, ...]) -> bool:
    """Whether a result says so, and nothing in it says otherwise."""
    verdicts = {"trusted"} if "fit" not in content else {"none", "named"}
    return (
        content.get("trusted") is True and not reasons and content.get("verdict", "trusted") in {*verdicts, "trusted"}
    )


def _state(bias: Array, d: Array) -> Array:
    """The state (9,) in the order of ``model.STATE_NAMES``."""
    x = np.zeros(STATE_SIZE)
    x[BIAS] = bias
    x[D_ALL] = d[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return x


def _is_numbers(value: Any) -> bool:
    """Whether something is numbers, or lists of them."""
    if isinstance(value, list):
        return all(map(_is_numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


class _Reading:
    """Arrays out of a result; what is wrong with any of them is said together."""

    def __init__(self, path: Path) -> None:
        self._path, self._faults = path, list[Fault]()

    def array(self, content: dict[str, Any], key: str, shape: tuple[int, ...], limit: float) -> Array:
        """Finite numbers of a shape, none beyond a limit; zeros where they are none."""
        try:
            found = np.array(content.get(key) if _is_numbers(content.get(key)) else None, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            found = np.zeros(0)
        if found.shape != shape or not np.all(np.abs(found) <= limit):
            accepted = f"numbers of shape {shape} up to {limit:g} are accepted; {ACCEPTED}"
            where = f"{self._path}: {key}"
            is_there = key in content
            fault = Fault(where, str(content[key])[:60], accepted) if is_there else Lacking(where, MISSING, accepted)
            self._faults.append(fault)
            return np.zeros(shape)
        return found

    def number(self, content: dict[str, Any], key: str, low: float, high: float) -> float | None:
        """A number within limits; None where there is none."""
        value = content.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            self._faults.append(Fault(f"{self._path}: {key}", str(value)[:60], f"{low:g} to {high:g} is accepted"))
            return None
        return float(value)

    def texts(self, content: dict[str, Any], key: str) -> tuple[str, ...]:
        """A list of texts; none where there is none."""
        value = content.get(key, [])
        if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
            self._faults.append(Fault(f"{self._path}: {key}", str(value)[:60], "a list of texts is accepted"))
            return ()
        return tuple(value)

    def covariance(self, found: Array) -> None:
        """Symmetric, with no variance below 0 in any direction (to rounding)."""
        scale = np.sqrt(np.maximum(np.diagonal(found), 0.0))
        scaled = found / np.maximum(np.outer(scale, scale), 1e-300)
        even = np.allclose(scaled, scaled.T, rtol=0.0, atol=1e-6)
        if np.any(np.diagonal(found) < 0.0) or not even or np.linalg.eigvalsh(scaled)[0] < -1e-6:
            accepted = "a symmetric matrix with no negative eigenvalue is accepted"
            self._faults.append(Fault(f"{self._path}: covariance", "it is none", accepted))

    def head(self, content: dict[str, Any]) -> None:
        """What a result says of its own form has to be what is read here; one that says nothing is read as it is."""
        name = content.get("schema")
        if name is not None and name not in SCHEMAS:
            self._faults.append(
                Fault(f"{self._path}: schema", str(name)[:60], f"one of {', '.join(SCHEMAS)} is accepted")
            )
            return
        known = head(name or SCHEMAS[0])
        for key in ("equation", "units", "frame"):
            if key in content and content[key] != known[key]:
                accepted = f"{known[key]} is accepted"
                self._faults.append(Fault(f"{self._path}: {key}", str(content[key])[:60], accepted))

    def done(self) -> None:
        """Raise InputRefusedError where anything was refused."""
        if self._faults:
            raise InputRefusedError(self._faults)
