"""``magcal calibrate`` of many recordings of different craft."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from magcal_service.many.executor import Executor
from magcal_service.offline.calibrate import calibrate
from magcal_service.offline.each import Answer, Asked, ask_each
from magcal_service.offline.result_files import CALIBRATION
from magcal_service.recordings.reader import read_recording


def calibrate_each(
    paths: Sequence[Path], method: str, craft: str | None, out: Path, executor: Executor, source: str | None = None
) -> Asked:
    """The nine errors of each recording, ``CALIBRATION`` in a folder of each under ``out``; raises as ``ask_each``."""
    return ask_each("calibrate", partial(_answered, method, craft, source), paths, out, executor)


def _answered(method: str, craft: str | None, source: str | None, path: Path) -> Answer:
    result = calibrate(read_recording(path, craft, source=source), method)
    levels = result.residuals
    says = f"residual {levels.before:.1f} -> {levels.after:.1f} nT, noise {levels.noise}"
    reasons = [str(reason) for reason in result.reasons]
    return Answer(
        trusted=result.trusted,
        verdict=str(result.verdict),
        says=f"{says}; {', '.join(reasons)}" if reasons else says,
        files={CALIBRATION: result.as_json()},
        more={"reasons": reasons, "residual_rms_nt": result.to_dict()["residual_rms_nt"]},
    )
