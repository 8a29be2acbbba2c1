"""magcal: real-time, attitude-independent magnetometer calibration.

The names below are the public face; every other name may move.  Each is loaded when it is first used, so that
``import magcal_service as magcal`` costs next to nothing.  ``docs/python.md`` shows them at work.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from magcal_service.base.version import __version__

if TYPE_CHECKING:
    from magcal_service.base.errors import ExtraMissingError, InputRefusedError, MagcalError
    from magcal_service.config.settings import CraftConfig as Craft
    from magcal_service.config.settings import FilterConfig as Filter
    from magcal_service.config.settings import SensorConfig as Sensor
    from magcal_service.config.settings import SpinConfig as Spin
    from magcal_service.config.settings import TickConfig as Ticks
    from magcal_service.config.settings import TrustConfig as Trust
    from magcal_service.daemon.pipeline import Pipeline
    from magcal_service.diagnosis.answer import Answer, JointAnswer, diagnose
    from magcal_service.offline.calibrate import Calibration, calibrate
    from magcal_service.offline.fit import Fit, fit
    from magcal_service.offline.no_solution import NoSolutionError
    from magcal_service.offline.replay import Replay, replay
    from magcal_service.recordings.reader import read_recording
    from magcal_service.recordings.recording import Recording

_HOMES: Final = {
    "Answer": ("diagnosis.answer", "Answer"),
    "Calibration": ("offline.calibrate", "Calibration"),
    "Craft": ("config.settings", "CraftConfig"),
    "ExtraMissingError": ("base.errors", "ExtraMissingError"),
    "Filter": ("config.settings", "FilterConfig"),
    "Fit": ("offline.fit", "Fit"),
    "InputRefusedError": ("base.errors", "InputRefusedError"),
    "JointAnswer": ("diagnosis.answer", "JointAnswer"),
    "MagcalError": ("base.errors", "MagcalError"),
    "NoSolutionError": ("offline.no_solution", "NoSolutionError"),
    "Pipeline": ("daemon.pipeline", "Pipeline"),
    "Recording": ("recordings.recording", "Recording"),
    "Replay": ("offline.replay", "Replay"),
    "Sensor": ("config.settings", "SensorConfig"),
    "Spin": ("config.settings", "SpinConfig"),
    "Ticks": ("config.settings", "TickConfig"),
    "Trust": ("config.settings", "TrustConfig"),
    "calibrate": ("offline.calibrate", "calibrate"),
    "diagnose": ("diagnosis.answer", "diagnose"),
    "fit": ("offline.fit", "fit"),
    "read_recording": ("recordings.reader", "read_recording"),
    "replay": ("offline.replay", "replay"),
}
"""Public name -> the module under this package that has it, and its name there."""

__all__ = [
    "Answer",
    "Calibration",
    "Craft",
    "ExtraMissingError",
    "Filter",
    "Fit",
    "InputRefusedError",
    "JointAnswer",
    "MagcalError",
    "NoSolutionError",
    "Pipeline",
    "Recording",
    "Replay",
    "Sensor",
    "Spin",
    "Ticks",
    "Trust",
    "__version__",
    "calibrate",
    "diagnose",
    "fit",
    "read_recording",
    "replay",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'magcal_service' has no attribute {name!r}; public: {', '.join(__all__)}")
    module, own_name = _HOMES[name]
    value = getattr(import_module(f"{__name__}.{module}"), own_name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
