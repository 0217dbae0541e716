"""What a session refuses: wrong arrays, data that are no good, estimates that break down."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from swing_sessions import CONFIG, SECOND, assert_add_up, imu, run, shifted

from sins_align.session import Session
from sins_align.soundness import is_sound
from sins_align.types import Advance, Estimate, ImuBlock, ImuSamples, State

# -- wrong calls


def wrong_arrays() -> dict[str, ImuSamples]:
    stamps, w, f = imu().select(slice(0, 10))
    return {
        "stamp_ns: an array of int64": ImuSamples(stamps * 1e-9, w, f),  # type: ignore[arg-type]
        "stamp_ns: an array of int64 is expected, not uint64": ImuSamples(
            stamps.astype(np.uint64),
            w,
            f,  # type: ignore[arg-type]
        ),
        "stamp_ns: an array of int64 is expected, not list": ImuSamples(stamps.tolist(), w, f),
        "stamp_ns: shape": ImuSamples(stamps[:, None], w, f),
        "stamp_ns: shape \\(N,\\)": ImuSamples(np.array(5), w, f),
        "w_ib_b: an array of float64": ImuSamples(stamps, w.astype(np.float32), f),  # type: ignore[arg-type]
        "w_ib_b: an array of float64 is expected, not int64": ImuSamples(stamps, w.astype(int), f),
        "w_ib_b: shape": ImuSamples(stamps, w.T, f),
        "w_ib_b: shape \\(3, 10\\) is expected, not \\(3, 9\\)": ImuSamples(stamps, w[:, 1:], f),
        "f_ib_b: shape": ImuSamples(stamps, w, f[0]),
        "f_ib_b: an array of float64 is expected, not NoneType": ImuSamples(stamps, w, None),  # type: ignore[arg-type]
    }


@pytest.mark.parametrize("message", wrong_arrays())
def test_wrong_arrays_are_refused_at_the_door(message: str) -> None:
    session = Session(CONFIG)
    with pytest.raises(ValueError, match=message):
        session.add_imu(wrong_arrays()[message])
    assert_add_up(session, 0)


def test_no_samples_at_all() -> None:
    session, updates = run(imu().select(slice(0, 0)))
    assert not updates
    assert session.status.reason == "no IMU data"


# -- an estimator that breaks down


class Broken:
    """An aligner whose numbers go wrong after some blocks."""

    made = 0
    singular = False

    def __init__(self, _: object, __: object) -> None:
        Broken.made += 1
        self._count = 0
        self._stamp_ns = 0

    def update(self, block: ImuBlock) -> list[Advance]:
        self._count += 1
        self._stamp_ns = int(block.stamp_ns[-1])
        if self.singular and self._count == 3:
            raise np.linalg.LinAlgError("not positive definite")
        return [Advance(self._stamp_ns, self.estimate)]

    @property
    def estimate(self) -> Estimate:
        bad = self._count == 3
        zero = np.zeros(3)
        covariance = 1e-8 * np.eye(3)
        covariance[2, 2] = math.nan if bad else 1e-8
        q_nb = np.array([1.0, 0.0, 0.0, 0.0])
        return Estimate(self._stamp_ns, q_nb, covariance, zero, zero, zero, zero)

    def propagate(self, _: ImuBlock) -> Estimate:
        return self.estimate

    conclude = propagate


@pytest.mark.parametrize("singular", [False, True])
def test_an_estimate_that_breaks_down_is_never_shown(
    monkeypatch: pytest.MonkeyPatch, singular: bool
) -> None:
    monkeypatch.setattr("sins_align.aligners.make_aligner", Broken)
    monkeypatch.setattr(Broken, "singular", singular)
    Broken.made = 0
    session, updates = run(imu(duration_s=7.0))
    states = [u.status.state for u in updates]
    assert states[2] is states[5] is State.FAILED
    assert ("positive definite" if singular else "broke down") in updates[2].status.reason
    assert updates[2].status.remedy
    assert all(u.estimate is None or is_sound(u.estimate) for u in updates)
    assert Broken.made == 3
    assert session.estimate is not None


def test_what_is_sound() -> None:
    good = Broken(None, None).estimate
    assert is_sound(good)
    for P in (np.diag([1.0, 1.0, -1e-30]), np.diag([1.0, math.inf, 1.0])):
        assert not is_sound(dataclasses.replace(good, misalignment_covariance=P))
    assert not is_sound(dataclasses.replace(good, q_nb=np.full(4, math.nan)))


@pytest.mark.parametrize(
    ("factor", "key", "size", "helps"),
    [
        (0.0, "gravity_removed", "0 m/s^2", "gravity included"),
        (1.0 / 9.80665, "force_in_g", "in g, not in m/s^2", "multiply by 9.80665"),
        (0.5, "gravity_removed", "4.87 m/s^2", "gravity included"),
        (2.0, "force_size", "19.5 m/s^2", "units and scale"),
    ],
)
def test_a_force_that_is_not_gravity_is_told(
    factor: float, key: str, size: str, helps: str
) -> None:
    """In g, with gravity removed, or doubled: refused by name, and never an attitude."""
    samples = imu(duration_s=20.0)
    wrong = ImuSamples(samples.stamp_ns, samples.w_ib_b, factor * samples.f_ib_b)
    session, updates = run(wrong)
    assert session.estimate is None
    assert updates and all(u.status.state is State.FAILED for u in updates)
    assert all(u.status.keys == (key,) for u in updates)
    assert size in session.status.reason and helps in session.status.remedy
    assert "gravity" in session.status.reason + session.status.remedy
    # Mended on the way, it begins by itself.
    session.add_imu(shifted(imu(), 20 * SECOND + 10_000_000))
    assert session.status.state in (State.COARSE, State.FINE)
    assert session.estimate is not None
