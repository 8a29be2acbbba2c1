"""Whether nine errors speak for another unit: all axes of a sensor seldom read too little alike by a third."""

from __future__ import annotations

from typing import Final

import numpy as np

from magcal_service.model import D_ALL, Array, d_matrix

_BEYOND_A_SENSOR: Final = 1.3
"""A common factor from which on a unit is likelier than a sensor.

Choice: far beyond a data sheet's tolerance of the sensitivity (AK8963: 0.1425 to 0.1575 uT a count, 5 %) with a wrong
reference beside it.
"""

_ALIKE: Final = 1.25
"""Most by which the gains of a wrong unit differ; choice: axes that differ by more need a look of their own."""


def scale_doubt(x: Array, covariance: Array) -> str:
    """What a factor that all axes share speaks for, in words; empty where it is that of a sensor, or not sure.

    Parameters
    ----------
    x, covariance: nine errors (9,) and their covariance (9, 9) [nT, -].
    """
    gains = np.linalg.eigvalsh(np.eye(3) + d_matrix(x))
    if gains[0] <= 0.0 or gains[-1] > _ALIKE * gains[0]:
        return ""
    common = float(np.cbrt(gains.prod()))
    sigma = float(np.sqrt(np.diagonal(covariance)[D_ALL][:3].max()))
    if max(common - 3.0 * sigma, 1.0 / (common + 3.0 * sigma)) < _BEYOND_A_SENSOR:
        return ""
    return (
        f"all axes read {'too little' if common > 1.0 else 'too much'} alike, by a factor of "
        f"{max(common, 1.0 / common):.2f}: rather the unit than the sensor (one count is {common:.3g} of the unit that "
        "was stated: magnetometer.factor), or the reference"
    )
