"""The reference of a recording in axes that do not turn, where it was given in axes that do."""

from __future__ import annotations

import math

import numpy as np
import pytest

from magcal_service.model import Array
from magcal_service.recordings.recording import Recording
from magcal_service.recordings.scene_of import scene_of

EARTH_RAD_S = 7.2921159e-5
TIME_S = 10.0 * np.arange(600.0)
IDENTITY = np.tile([1.0, 0.0, 0.0, 0.0], (len(TIME_S), 1))


def about_z(angle: Array, vectors: Array) -> Array:
    """Vectors (n, 3) in axes that have been turned by an angle (n,) about z."""
    x, y, z = vectors.T
    return np.stack([x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle), z], axis=1)


def recorded(frame: str, *, dated: bool, attitude: bool = False, places: bool = True) -> Array | None:
    """The reference that effects see, of a field that stands still in space above a place that goes round."""
    space = np.tile([20e3, -5e3, 30e3], (len(TIME_S), 1))
    course = 1.1e-3 * TIME_S
    place = 6900.0 * np.stack([np.cos(course), np.sin(course) * 0.6, np.sin(course) * 0.8], axis=1)
    turned = EARTH_RAD_S * TIME_S
    fixed_field, fixed_place = about_z(turned, space), about_z(turned, place)
    field = fixed_field if frame == "ecef" else north_east_down(fixed_place, fixed_field)
    time = np.datetime64("2025-06-01T00:00:00") + (1e3 * TIME_S).astype("timedelta64[ms]") if dated else TIME_S
    recording = Recording.from_arrays(
        time,
        space,
        field,
        frame=frame,
        position_ecef_km=fixed_place if places else None,
        attitude=IDENTITY if attitude else None,
    )
    return scene_of(recording).reference_eci_nt


def north_east_down(place_km: Array, field: Array) -> Array:
    """Earth-fixed vectors (n, 3) in geodetic axes: the vertical is the ellipsoid's."""
    flattening = 1.0 / 298.257223563
    squared = flattening * (2.0 - flattening)
    longitude = np.arctan2(place_km[:, 1], place_km[:, 0])
    across = np.hypot(place_km[:, 0], place_km[:, 1])
    latitude = np.arctan2(place_km[:, 2], across * (1.0 - squared))
    for _ in range(10):
        normal = 6378.137 / np.sqrt(1.0 - squared * np.sin(latitude) ** 2)
        latitude = np.arctan2(place_km[:, 2] + squared * normal * np.sin(latitude), across)
    up = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=1
    )
    east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros(len(up))], axis=1)
    north = np.cross(up, east)
    return np.stack([np.sum(field * axis, axis=1) for axis in (north, east, -up)], axis=1)


@pytest.mark.parametrize("frame", ["ecef", "ned"])
@pytest.mark.parametrize("dated", [True, False])
def test_a_field_that_stands_still_in_space_stands_still_in_the_scene(frame: str, dated: bool) -> None:
    """Without a date the Earth's turn is taken off all the same; only the direction of x is anybody's."""
    found = recorded(frame, dated=dated)
    assert found is not None
    assert np.ptp(found, axis=0).max() < 5.0  # of 36 uT; 0.04 rad of the Earth's turn would be 900 nT
    assert found[0, 2] == pytest.approx(30e3, abs=5.0)
    assert math.hypot(found[0, 0], found[0, 1]) == pytest.approx(math.hypot(20e3, 5e3), abs=5.0)


@pytest.mark.parametrize("frame", ["ecef", "ned"])
def test_beside_an_inertial_attitude_the_direction_of_x_has_to_be_known(frame: str) -> None:
    assert recorded(frame, dated=False, attitude=True) is None
    assert recorded(frame, dated=True, attitude=True) is not None


def test_north_without_a_place_is_no_axis() -> None:
    assert recorded("ned", dated=False, places=False) is None
