"""Samples of a drive by a given law, and the track that comes of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sins_align.odo.knots import Stretch
from sins_align.odo.track import OdometerTrack
from sins_align.types import Array, OdometerSamples

T0 = 1_700_000_000_000_000_000
MM = 1e-3
RNG = np.random.default_rng


def driven(t: Array) -> Array:
    """A drive with turns of the speed; never a standstill [m]."""
    return 8.0 * t + 20.0 * np.sin(0.3 * t) + 3.0 * np.cos(0.7 * t)


def speed_of(t: Array) -> Array:
    return 8.0 + 6.0 * np.cos(0.3 * t) - 2.1 * np.sin(0.7 * t)


def means(
    t: Array, law: Callable[[Array], Array] = driven, variance: float = 0.0
) -> OdometerSamples:
    """Samples at times t[1:] [s], means from one to the next."""
    stamp_ns = T0 + np.rint(t * 1e9).astype(np.int64)
    exact = (stamp_ns - T0) * 1e-9
    speed = np.diff(law(exact)) / np.diff(exact)
    return OdometerSamples(stamp_ns[1:], speed, np.full(speed.shape[0], variance))


def given_speeds(t: Array, speed: Array) -> OdometerSamples:
    return OdometerSamples(T0 + np.rint(t * 1e9).astype(np.int64), speed, np.zeros(t.shape[0]))


def with_speed(samples: OdometerSamples, speed: Array) -> OdometerSamples:
    return OdometerSamples(samples.stamp_ns, speed, samples.variance)


def track_of(samples: OdometerSamples, quantum: float | None = 0.0) -> OdometerTrack:
    track = OdometerTrack(quantum)
    track.add(samples)
    track.settle(np.inf)
    return track


def read(track: OdometerTrack, t: Array) -> Stretch | None:
    """At times t since T0 [s]."""
    assert track.origin_ns is not None
    return track.read(t + (T0 - track.origin_ns) * 1e-9)


def must_read(track: OdometerTrack, t: Array) -> Stretch:
    stretch = read(track, t)
    assert stretch is not None
    return stretch
