"""The samples of one magnetometer before and after calibration, against the reference, as they arrive."""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from typing import Final, NamedTuple

import numpy as np

from magcal_service.views.pulse import Pulse
from magcal_service.views.series import Recent, Row, Whole
from magcal_service.views.spectrum import Spectrum, spectrum
from magcal_service.views.sphere import Sphere
from magcal_service.wire.messages import CalibratedVector, MagnetometerSample, ReferenceSample, Vector, Verdict

_WAITING: Final = 512  # samples or vectors that wait for what belongs to them
_APART_S: Final = 30.0  # between two references; further apart nothing is interpolated


def length(vector: Vector) -> float:
    """The magnitude of a vector, in its own unit."""
    return math.hypot(*vector)


_ALONE_S: Final = 2.0  # how long a row waits where no reference at all has been heard


class _Pair(NamedTuple):
    time_ns: int
    before: Vector | None
    after: Vector
    is_calibrated: bool  # else there is no estimate yet, and the vector is that of the prior


class ReferenceField:
    """|H| of a craft at the times asked for, interpolated between the two references around it."""

    def __init__(self) -> None:
        self._heard: deque[tuple[int, float]] = deque(maxlen=64)

    def add(self, sample: ReferenceSample) -> None:
        """Take a reference; one that is older than the newest is left out."""
        magnitude = sample.magnitude_nt if sample.field_nt is None else length(sample.field_nt)
        if magnitude is not None and (not self._heard or sample.time_ns > self._heard[-1][0]):
            self._heard.append((sample.time_ns, magnitude))

    @property
    def newest_ns(self) -> int | None:
        """Time of the newest [ns], None before the first."""
        return self._heard[-1][0] if self._heard else None

    def at(self, time_ns: int) -> float | None:
        """|H| [nT]; None outside of what was heard, or where two references are too far apart."""
        later: tuple[int, float] | None = None
        for heard_ns, magnitude in reversed(self._heard):
            if heard_ns == time_ns:
                return magnitude
            if heard_ns < time_ns:
                if later is None or later[0] - heard_ns > _APART_S * 1e9:
                    return None
                share = (time_ns - heard_ns) / (later[0] - heard_ns)
                return magnitude + share * (later[1] - magnitude)
            later = heard_ns, magnitude
        return None


class FieldView:
    """What a page shows of one magnetometer's samples.

    Rows of ``recent`` and ``whole``: time [s since ``start_ns``], |B| before, |B| after, |H|, |B| after - |H| [nT];
    what needs an estimate is None before there is one.
    """

    def __init__(self, reference: ReferenceField, start_ns: int) -> None:
        self.recent, self.whole, self.sphere = Recent(), Whole(), Sphere()
        self.start_ns = self.newest_ns = start_ns
        self.pulse = Pulse()
        self._time_s = -math.inf
        self._reference = reference
        self._samples: OrderedDict[int, Vector] = OrderedDict()
        self._pairs: deque[_Pair] = deque()
        self._measured: deque[Vector] = deque(maxlen=self.recent.rows.maxlen)

    def sample(self, sample: MagnetometerSample) -> None:
        """Keep a raw sample until its calibrated vector comes."""
        self._samples[sample.sequence] = sample.field_body_nt
        while len(self._samples) > _WAITING:
            self._samples.popitem(last=False)

    def vector(self, vector: CalibratedVector) -> None:
        """Take a calibrated vector; its row is made when the reference covers it."""
        before = self._samples.pop(vector.sequence, None)
        is_calibrated = vector.verdict is not Verdict.NOT_STARTED
        self._pairs.append(_Pair(vector.time_ns, before, vector.field_body_nt, is_calibrated))
        self.newest_ns = max(self.newest_ns, vector.time_ns)
        self.settle()
        patience_s = _ALONE_S if self._reference.newest_ns is None else _APART_S
        while len(self._pairs) > _WAITING or (
            self._pairs and self.newest_ns - self._pairs[0].time_ns > patience_s * 1e9
        ):
            self._row(self._pairs.popleft())

    def settle(self) -> None:
        """Make the rows of all vectors that the reference covers by now."""
        newest_ns = self._reference.newest_ns
        while newest_ns is not None and self._pairs and self._pairs[0].time_ns <= newest_ns:
            self._row(self._pairs.popleft())

    def _row(self, pair: _Pair) -> None:
        reference, after = self._reference.at(pair.time_ns), length(pair.after)
        time_s = round((pair.time_ns - self.start_ns) * 1e-9, 3)
        if time_s <= self._time_s:  # out of order: a plot goes forward only
            return
        self._time_s = time_s
        row: Row = (
            time_s,
            None if pair.before is None else round(length(pair.before), 1),
            round(after, 1) if pair.is_calibrated else None,
            None if reference is None else round(reference, 1),
            round(after - reference, 2) if reference is not None and pair.is_calibrated else None,
        )
        self.recent.add(row)
        self.whole.add(row)
        self.sphere.add(pair.before, pair.after if pair.is_calibrated else None, reference or after)
        self._measured.append(pair.before or pair.after)

    def spectrum(self) -> Spectrum | None:
        """Of the residual of the newest rows; None where they are too few."""
        rows = [
            (row[0], row[4], measured)
            for row, measured in zip(self.recent.rows, self._measured, strict=True)
            if row[0] is not None and row[4] is not None
        ]
        if not rows:
            return None
        times, residuals, measured = zip(*rows, strict=True)
        return spectrum(times, residuals, np.array(measured))
