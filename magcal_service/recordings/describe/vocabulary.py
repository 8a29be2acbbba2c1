"""What names of columns say, by their words: a closed list, small letters."""

from __future__ import annotations

from enum import StrEnum
from typing import Final


class Kind(StrEnum):
    """What a group of three columns can be by its name."""

    MAGNETOMETER = "magnetometer"
    REFERENCE = "reference"
    GYRO = "gyro"
    ACCELEROMETER = "accelerometer"
    SUN = "sun"
    TORQUER = "torquer"
    POSITION = "position"
    VELOCITY = "velocity"
    UNKNOWN = ""


_MAGNETOMETER: Final = {
    "m", "mag", "magn", "magneto", "magnetometer", "magnetic", "magfield", "b", "bfield", "compass", "tam", "mtm",
    "mgm", "fgm", "mfield", "hmc", "hmc5883", "lis", "lis3mdl", "rm", "rm3100", "qmc", "qmc5883", "ak", "bmm", "mmc",
    "iis2mdc", "mlx", "mlx90393", "fluxgate", "amr", "bmag", "field", "magraw", "magcal",
}  # fmt: skip
STRONG_MAGNETOMETER: Final = _MAGNETOMETER - {"m", "b", "lis", "rm", "ak"}
_REFERENCE: Final = {
    "ref", "reference", "igrf", "igrf13", "igrf14", "wmm", "model", "expected", "truth", "true", "predicted", "h",
    "ned", "eci", "ecef", "inertial", "bref", "href", "bigrf", "beci", "bned", "becef",
}  # fmt: skip
_GYRO: Final = {
    "g", "gyr", "gyro", "gyroscope", "w", "omega", "rate", "rates", "angular", "angvel", "angrate", "av", "imu_g",
}  # fmt: skip
_ACCELEROMETER: Final = {"a", "acc", "accel", "acceleration", "accelerometer", "gravity", "linear", "la", "f"}
_SUN: Final = {"s", "sun", "ss", "sunvec", "sunvector", "fss"}
_TORQUER: Final = {"mtq", "mtr", "torquer", "torquers", "dipole", "magnetorquer", "mt", "torqrod", "moment", "coil"}
_POSITION: Final = {"p", "pos", "position", "r", "ecef", "eci", "orbit", "sat", "gps"}
_VELOCITY: Final = {"v", "vel", "velocity", "speed"}
_OTHER: Final = {"euler", "roll", "pitch", "yaw", "q", "quat", "quaternion", "css", "photo"}

TEMPERATURE: Final = {"temp", "temperature", "temps", "tmp", "tsens", "tmag", "therm", "thermistor", "tempc", "tempk"}
CURRENT: Final = {"current", "curr", "amps", "amperage", "ibat", "ibatt", "ibus", "batcurrent"}
LATITUDE: Final = {"enlem", "breite", "lat", "latitude", "latd", "latdeg", "glat"}
LONGITUDE: Final = {"boylam", "länge", "laenge", "lon", "long", "longitude", "lng", "londeg", "glon"}
ALTITUDE: Final = {
    "yükseklik",
    "irtifa",
    "höhe",
    "hoehe",
    "alt",
    "altitude",
    "height",
    "elevation",
    "hgt",
    "altkm",
    "altm",
    "msl",
}
FRAMES: Final = {
    "eci": "eci", "gcrf": "eci", "j2000": "eci", "teme": "eci", "inertial": "eci", "tod": "eci", "beci": "eci",
    "mod": "eci", "ecef": "ecef", "itrf": "ecef", "ecf": "ecef", "becef": "ecef", "fixed": "ecef", "ned": "ned",
    "bned": "ned",
}  # fmt: skip


def kind_of(words: tuple[str, ...]) -> Kind:
    """What three columns are by the words that they share; unknown where the words say nothing or two things."""
    found = set(words)
    if found & _TORQUER and not found & STRONG_MAGNETOMETER:
        return Kind.TORQUER
    magnetic = bool(found & _MAGNETOMETER)
    strong = bool(found & STRONG_MAGNETOMETER)
    if found & _OTHER:
        return Kind.UNKNOWN
    if found & (_REFERENCE - {"h", "ned", "eci", "ecef"}) or (magnetic and found & _REFERENCE):
        return Kind.REFERENCE
    if found == {"h"}:
        return Kind.REFERENCE
    if strong and not found & (_GYRO - {"g", "w"}) and not found & (_ACCELEROMETER - {"a", "f", "linear"}):
        return Kind.MAGNETOMETER
    for kind, words_of_kind in (
        (Kind.GYRO, _GYRO),
        (Kind.ACCELEROMETER, _ACCELEROMETER),
        (Kind.SUN, _SUN),
        (Kind.VELOCITY, _VELOCITY),
        (Kind.POSITION, _POSITION),
    ):
        if found & words_of_kind and not magnetic:
            return kind
    return Kind.MAGNETOMETER if magnetic else Kind.UNKNOWN


def frame_of(words: tuple[str, ...]) -> str:
    """The frame that a name says: ``eci``, ``ecef``, ``ned`` or empty."""
    frames = {FRAMES[word] for word in words if word in FRAMES}
    return frames.pop() if len(frames) == 1 else ""
