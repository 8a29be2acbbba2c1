"""magcal: real-time, attitude-independent magnetometer calibration."""

__version__ = "0.1.0"
