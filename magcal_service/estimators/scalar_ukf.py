"""The nine-state UKF with the scalar measurement alone: ``ukf`` without its spin windows.

It is the same class with the spin switched off, so that the two differ in the information they use and in nothing
else: batch start, mean of v, noise inside B and innovation gate are those of ``ukf``.

Source: Crassidis, Lai & Harman 2003, "Real-time attitude-independent three-axis magnetometer calibration", section on
the unscented filter; Cetin, Soken & Tekinalp 2020, equations (2)-(4).
"""

from __future__ import annotations

from dataclasses import replace

from magcal_service.config.settings import CraftConfig
from magcal_service.estimators.interface import Method
from magcal_service.estimators.ukf import Ukf


class ScalarUkf(Ukf):
    """One craft's filter; whatever spin the configuration states is left aside.

    Parameters
    ----------
    config: the craft's configuration (sensor, filter).
    """

    name = "scalar-ukf"

    def __init__(self, config: CraftConfig) -> None:
        super().__init__(replace(config, spin=None))


METHOD = Method("scalar-ukf", "nine-state UKF with the scalar measurement alone", ScalarUkf, takes_prior=True)
