"""Times of points, whatever a recording calls and counts them: one place for all loaders.

Drivers name the field t, time, timestamp, timestamps, stamps, offset_time or time_stamp. They count
seconds, milli-, micro- or nanoseconds, from 1970, from the start of the LiDAR, or from the sweep's
stamp, which lies at the sweep's start, middle or end. The unit follows from the span of the values,
since a sweep lasts as long as stamps are apart. The origin follows from where the values lie.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

log = logging.getLogger(__name__)

FIELD_NAMES = (
    "t",
    "time",
    "timestamp",
    "timestamps",
    "stamps",
    "offset_time",
    "time_stamp",
    "offset_ns",
    "gps_time",
)
"""Names of the field, in small letters."""

Instant = Literal["start", "middle", "end"]
"""Which instant of a sweep its stamp is."""
Unit = Literal["s", "ms", "us", "ns"]

_NANOSECONDS: dict[Unit, int] = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
USUAL_PERIOD = 125_000_000
"""Nanoseconds of a sweep of which no more is known; sweeps last 50 to 200 ms."""
# Of the time between stamps that the points of a sweep may span: of a LiDAR that looks ahead, or a
# little more than a revolution. Units are a thousand apart, so at most one fits.
_SHORTEST, LONGEST = 0.1, 1.6
_HALF_OF_32_BITS = 1 << 31
_FEW = 0.02  # of the points of a sweep, whose times may be called wrong beside the others'
SHARE_BEFORE: dict[Instant, float] = {"start": 0.0, "middle": 0.5, "end": 1.0}
"""Of a sweep that is measured before its stamp."""


class TimeSample(NamedTuple):
    """Times of the points of one sweep as recorded."""

    values: NDArray[Any]  # (N,): Of any number type
    usable: NDArray[np.bool_]  # (N,): Which rows are returns; others often have time 0
    stamp: int  # nanoseconds


@dataclass(frozen=True)
class PointTimes:
    """How a recording counts the times of its points."""

    unit: int  # nanoseconds of one count
    # times count from the sweep's stamp, on the clock of the stamps, or on another clock, of which
    # only the differences within a sweep are used
    origin: Literal["stamp", "clock", "first"]
    shift: int  # nanoseconds to add, where the stamp is not at the instant the values count from
    period: int  # nanoseconds between sweeps

    def relative(self, sample: TimeSample) -> NDArray[np.float32] | None:
        """When each point was measured, as :attr:`~docdepth.datasets.Sweep.relative_time`.

        Rows that are no returns have any time or none: what cannot be a time of the sweep is 0
        there. None if a return lies more than a sweep and a half from the stamp: then times are
        wrong.
        """
        sample = _signed(sample)
        kept = sample.values[sample.usable]
        if not len(kept):
            return np.zeros(len(sample.values), np.float32)
        if self.origin == "clock":
            start: int | float = sample.stamp
        else:
            start = 0 if self.origin == "stamp" else _exact(kept.min()) * self.unit
        late = _after(sample.values, start - self.shift, self.unit) / self.period
        with np.errstate(invalid="ignore"):
            right = np.abs(late) <= LONGEST
        if (np.isfinite(late) & ~right & sample.usable).any():
            return None
        return np.where(right | sample.usable, late, 0).astype(np.float32)


def find_point_times(
    samples: Sequence[TimeSample],
    period: int | None,
    where: str,
    unit: Unit | None = None,
    instant: Instant | None = None,
) -> PointTimes | None:
    """Find how a recording counts the times of its points.

    Parameters
    ----------
    samples : sequence of TimeSample
        Of a few sweeps from all over the recording: one unit and origin must fit all of them.
    period : int, optional
        Nanoseconds between sweeps; None if there is one sweep.
    where : str
        The recording, for warnings.
    unit : {"s", "ms", "us", "ns"}, optional
        As the user says; found if left out.
    instant : {"start", "middle", "end"}, optional
        Where the stamp lies in the sweep, as the user says. If left out the values tell, and start
        is taken where they do not.

    Returns
    -------
    PointTimes or None
        None with a warning if the values cannot be times of the points of a sweep.
    """
    samples = [_signed(_finite(sample)) for sample in samples]
    samples = [sample for sample in samples if sample.usable.any()]
    if not samples:
        return None
    kept = [sample.values[sample.usable] for sample in samples]
    spans = [float(_exact(v.max()) - _exact(v.min())) for v in kept]
    duration, span = period or USUAL_PERIOD, max(spans)
    units = [unit] if unit else list(_NANOSECONDS)
    fitting = list[Unit]()
    for u in units:
        # In a few sweeps a counter begins anew, as each hour in those of Velodyne.
        whole = [s for s in spans if s * _NANOSECONDS[u] < LONGEST * duration]
        longest = max(whole, default=0) if 2 * len(whole) > len(spans) else span
        if _SHORTEST < longest * _NANOSECONDS[u] / duration < LONGEST or u == unit:
            fitting.append(u)
            span = longest
    if not fitting or span == 0:
        log.warning(
            "%s: times of points span %g, which is no sweep of %.3g s in s, ms, us or ns%s; they "
            "are ignored, and the sweeps stay as they were measured",
            where, span, duration * 1e-9, _outliers(max(kept, key=np.ptp), units, duration),
        )  # fmt: skip
        return None
    count = _NANOSECONDS[fitting[0]]
    first = [_exact(v.min()) * count for v in kept]
    limit = LONGEST * duration
    shift = -round(SHARE_BEFORE[instant or "start"] * span * count)
    if all(abs(start) < limit for start in first):
        # Declared: the values count from the first point, wherever the driver puts its stamp.
        shift = shift - round(float(np.median(first))) if instant else 0
        return PointTimes(count, "stamp", shift, duration)
    if instant is None and all(
        abs(start - sample.stamp) < limit for start, sample in zip(first, samples, strict=True)
    ):
        return PointTimes(count, "clock", 0, duration)
    if instant is None:
        log.warning(
            "%s: times of points are on another clock than the stamps of the sweeps (%.3f s and "
            "%.3f s); the stamp is taken for the time of the first point. Say stamp: start, middle "
            "or end in docdepth.yaml",
            where, first[0] * 1e-9, samples[0].stamp * 1e-9,
        )  # fmt: skip
    return PointTimes(count, "first", shift, duration)


def sweep_seconds(times: NDArray[np.int64]) -> np.float32:
    """Seconds of a sweep (median), 0 if there is one; float32 like the times that it scales.

    Shares of a sweep become seconds by this number alone. Seconds that are divided by it and
    multiplied again are the same seconds, to the last bit.
    """
    return np.float32(np.median(np.diff(times)) * 1e-9 if len(times) > 1 else 0)


def median_period(times: NDArray[np.int64]) -> int | None:
    """Nanoseconds between sweeps (median); None for a single sweep."""
    return int(np.median(np.diff(times))) if len(times) > 1 else None


def nearest_rows(stamps: NDArray[np.int64], times: NDArray[np.int64]) -> NDArray[np.int64]:
    """Row of the ascending stamps that is nearest to each time, the later one of two."""
    after = np.searchsorted(stamps, times).clip(0, len(stamps) - 1)
    before = (after - 1).clip(0)
    nearer = np.abs(times - stamps[before]) < np.abs(stamps[after] - times)
    return np.where(nearer, before, after)


def _finite(sample: TimeSample) -> TimeSample:
    values = sample.values
    if values.dtype.kind == "f":
        return sample._replace(usable=sample.usable & np.isfinite(values))
    return sample


def _signed(sample: TimeSample) -> TimeSample:
    """Offsets of 32 bits without a sign begin anew below 0: before the stamp, as Livox's may."""
    values = sample.values
    kept = values[sample.usable]
    if values.dtype == np.uint32 and len(kept) and np.ptp(kept) > _HALF_OF_32_BITS:
        return sample._replace(values=values.astype(np.int32))
    return sample


def _outliers(values: NDArray[Any], units: Sequence[Unit], duration: int) -> str:
    """Words for the few times (N,) without which the others would be those of a sweep."""
    low, high = np.quantile(values, [_FEW / 2, 1 - _FEW / 2])
    for unit in units:
        if _SHORTEST < (high - low) * _NANOSECONDS[unit] / duration < LONGEST:
            beyond = LONGEST * duration / _NANOSECONDS[unit]
            count = int((np.abs(values - (low + high) / 2) > beyond).sum())
            return f", because of {count} of {len(values)} points in a sweep; remove those points"
    return ""


def _exact(value: Any) -> int | float:
    """A number of numpy's as Python's, whose integers do not overflow."""
    return value.item()


def _after(values: NDArray[Any], start: int | float, unit: int) -> NDArray[np.float64]:
    """Nanoseconds from ``start`` (ns) to each value; integers lose no digits."""
    if values.dtype.kind in "iu" and float(start).is_integer():
        if int(start) % unit == 0:
            return (values.astype(np.int64) - int(start) // unit).astype(np.float64) * unit
        return (values.astype(np.int64) * unit - int(start)).astype(np.float64)
    return np.asarray(values, np.float64) * unit - start
