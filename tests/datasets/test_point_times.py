"""Times of points are understood however drivers count them, or refused with a warning."""

from __future__ import annotations

import numpy as np
import pytest

from docdepth.datasets.point_times import TimeSample, find_point_times, sweep_seconds

PERIOD = 100_000_000
STAMPS = [1_700_000_000_000_000_000 + k * PERIOD for k in (0, 50, 99)]
SHARES = np.linspace(0, 0.999, 500)


def relative(values, stamps=STAMPS, usable=None, period=PERIOD, **said):
    """Relative times of each sweep, of ``values(stamp)``; None if the field is ignored."""
    usable = np.ones(len(SHARES), bool) if usable is None else usable
    samples = [TimeSample(np.asarray(values(stamp)), usable, stamp) for stamp in stamps]
    found = find_point_times(samples, period, "drive", **said)
    return None if found is None else [found.relative(sample) for sample in samples]


UNITS = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("begin", [0.0, -0.5, -1.0], ids=["start", "middle", "end"])
def test_relative_times_of_any_unit_tell_where_the_stamp_lies(unit, begin, caplog):
    found = relative(lambda _: (SHARES + begin) * PERIOD / UNITS[unit])
    for late in found:
        np.testing.assert_allclose(late, SHARES + begin, atol=1e-6)
        assert late.dtype == np.float32
    assert not caplog.records


@pytest.mark.parametrize(
    ("dtype", "unit"),
    [("<f8", "s"), ("<f8", "us"), ("<f8", "ns"), ("<u8", "ns"), ("<i8", "us"), ("<u8", "ms")],
)
@pytest.mark.parametrize("begin", [0.0, -0.5, -1.0])
def test_absolute_times_on_the_clock_of_the_stamps(dtype, unit, begin, caplog):
    def values(stamp):
        whole = stamp + np.round((SHARES + begin) * PERIOD).astype(np.int64)
        return (whole / UNITS[unit]).astype(dtype) if dtype == "<f8" else (
            whole // int(UNITS[unit])
        ).astype(dtype)  # fmt: skip

    coarse = 1.1e6 if unit == "ms" else 2e3  # ns
    for late in relative(values):
        np.testing.assert_allclose(late, SHARES + begin, atol=coarse / PERIOD)
    assert not caplog.records


def test_nanoseconds_since_1970_keep_their_digits():
    (late, *_) = relative(lambda stamp: np.uint64(stamp) + np.arange(500).astype("<u8"), period=500)
    np.testing.assert_array_equal(late, (np.arange(500) / 500).astype("<f4"))


@pytest.mark.parametrize(("instant", "begin"), [("start", 0), ("middle", -0.5), ("end", -1)])
def test_a_declared_instant_wins(instant, begin):
    for values in (
        lambda _: SHARES * 0.1,
        lambda stamp: stamp * 1e-9 + SHARES * 0.1,
        lambda stamp: (stamp - STAMPS[0]) * 1e-9 + 4321.0 + SHARES * 0.1,
    ):
        for late in relative(values, instant=instant):
            np.testing.assert_allclose(late, SHARES + begin, atol=2e-3)


def test_another_clock_is_told_and_gives_differences(caplog):
    found = relative(lambda stamp: (stamp - STAMPS[0]) * 1e-9 + 4321.0 + SHARES * 0.1)
    for late in found:
        np.testing.assert_allclose(late, SHARES, atol=1e-6)
    assert "another clock" in caplog.text
    assert "stamp: start, middle or end" in caplog.text


def test_padding_with_zero_times_does_not_count():
    usable = SHARES < 0.8

    def values(stamp):
        return np.where(usable, stamp + (SHARES * PERIOD).astype(np.int64), 0).astype("<u8")

    for late in relative(values, usable=usable):
        np.testing.assert_allclose(late[usable], SHARES[usable], atol=1e-6)
        assert (late[~usable] == 0).all()


def test_times_that_are_not_finite_are_not_looked_at():
    usable = SHARES < 0.8
    for late in relative(lambda _: np.where(usable, SHARES * 0.1, np.nan), usable=usable):
        assert np.isfinite(late).all()


def test_partial_sweeps_keep_their_times():
    """A third of a revolution is not stretched to a whole one, and one unit holds for all."""
    samples = [
        TimeSample(SHARES[part] * 1e8, np.ones(len(SHARES[part]), bool), stamp)
        for part, stamp in zip((slice(0, 3), slice(100, 250), slice(0, 400)), STAMPS, strict=True)
    ]
    found = find_point_times(samples, PERIOD, "drive")
    for sample, part in zip(samples, (slice(0, 3), slice(100, 250), slice(0, 400)), strict=True):
        np.testing.assert_allclose(found.relative(sample), SHARES[part], atol=1e-6)


@pytest.mark.parametrize(
    "values",
    [
        lambda _: np.zeros(500),
        lambda stamp: np.full(500, np.float32(stamp * 1e-9)),  # all digits lost
        lambda stamp: (stamp * 1e-9 + SHARES * 0.1).astype("<f4"),
        lambda _: SHARES * 3.0,  # seconds of half a minute of sweeps
        lambda _: SHARES,  # shares of an unknown duration, or seconds
    ],
    ids=["zeros", "float32", "few digits", "too long", "shares"],
)
def test_implausible_times_are_ignored_with_a_warning(values, caplog):
    assert relative(values) is None
    assert "they are ignored" in caplog.text


def test_a_said_unit_is_believed():
    for late in relative(lambda _: SHARES * 2e-4, unit="s"):
        np.testing.assert_allclose(late, SHARES * 2e-3, atol=1e-6)


def test_a_single_sweep_lasts_as_long_as_sweeps_do():
    (late,) = relative(lambda _: (SHARES * 1e8).astype("<u4"), stamps=STAMPS[:1], period=None)
    np.testing.assert_allclose(late, SHARES * 0.8, atol=1e-6)


def test_a_sweep_whose_clock_has_jumped_has_no_times():
    samples = [TimeSample(s * 1e-9 + SHARES * 0.1, np.ones(500, bool), s) for s in STAMPS]
    found = find_point_times(samples, PERIOD, "drive")
    assert found.relative(samples[1]._replace(stamp=STAMPS[1] + 3 * PERIOD)) is None


def test_fields_without_any_return():
    usable = np.zeros(500, bool)
    assert relative(lambda _: SHARES, usable=usable) is None


@pytest.mark.parametrize("period", [99_990_016, 100_000_000, 50_123_457, 199_000_001])
def test_seconds_of_a_sweep_survive_the_way_to_shares_and_back(period):
    rng = np.random.default_rng(period)
    whole = sweep_seconds(np.arange(5) * period)
    seconds = whole * rng.uniform(-1.6, 1.6, 100_000).astype(np.float32)
    assert seconds.dtype == np.float32
    np.testing.assert_array_equal(whole * (seconds / whole), seconds)


def test_a_counter_that_begins_anew_within_a_sweep(caplog):
    """As each hour in the packets of Velodyne; the others of the drive keep their times."""
    hour = 3600 * 10**9
    late = [relative(lambda s: (s + SHARES * PERIOD) % hour / 1e9, [s])[0] for s in STAMPS[:1]]
    stamps = [*(s - STAMPS[0] % hour for s in STAMPS), STAMPS[0] - STAMPS[0] % hour - PERIOD // 2]
    found = relative(lambda s: (s + SHARES * PERIOD) % hour / 1e9, stamps)
    assert found is not None
    for one in found[:3]:
        np.testing.assert_allclose(one, late[0], atol=1e-4)
    assert found[3] is None  # told of this sweep alone


def test_offsets_before_the_stamp_that_begin_anew_at_32_bits(caplog):
    """As Livox's, whose offsets have no sign."""
    shares = SHARES - 0.5
    whole = np.round(shares * PERIOD).astype(np.int64) % (1 << 32)
    for late in relative(lambda _: whole.astype("<u4")):
        np.testing.assert_allclose(late, shares, atol=1e-6)
    one = iter([whole, whole + PERIOD // 2, whole + PERIOD // 2])
    first, *others = relative(lambda _: (next(one) % (1 << 32)).astype("<u4"))
    np.testing.assert_allclose(first, shares, atol=1e-6)
    for late in others:
        np.testing.assert_allclose(late, SHARES, atol=1e-6)
    assert not caplog.records


def test_a_few_times_that_are_wrong_are_told_from_a_unit_that_is(caplog):
    times = np.round(SHARES * PERIOD).astype("<u4")
    assert relative(lambda _: times * 5) is None
    assert "no sweep of 0.1 s" in caplog.text
    assert "because of" not in caplog.text
    times[[3, 70]] = 900_000_000
    assert relative(lambda _: times) is None
    assert "because of 2 of 500 points in a sweep; remove those points" in caplog.text
