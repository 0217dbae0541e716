"""One epoch of a moving vehicle's data, integrated: what every aided filter works on."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from sins_align.odo.pairing import Paired

from sins_align.gaps import has_gap, is_even
from sins_align.rotation import exp_rotation, multiply_quaternions, quaternion_from_rotation_vector
from sins_align.types import Array, ImuBlock, ImuSampling, IntArray
from sins_align.windows import integrate_window


class Travel(NamedTuple):
    """What the odometer says of an epoch.

    M : (3, 3) int C dS [m]: its columns are the displacements, had the vehicle travelled
        along x, y, z of b, with S the measured distance
    M_rate : (3, 3) its derivative by the odometer's latency [m/s]
    distance : over the epoch, negative in reverse [m]
    speed_start, speed_end : at its ends [m/s]
    variance : of the distance, beyond the noise that is declared [m^2]
    """

    M: Array
    M_rate: Array
    distance: float
    speed_start: float
    speed_end: float
    variance: float

    def later(self, delay_s: float) -> Travel:
        """With the odometer's stamps taken as so much later, to first order."""
        return self._replace(
            M=self.M + delay_s * self.M_rate,
            distance=self.distance + delay_s * (self.speed_end - self.speed_start),
        )


class AidedEpoch(NamedTuple):
    """Integrals over an epoch, in the axes of b at its start, frozen in inertial space.

    stamp_ns : end of the epoch; duration_s : its length
    C_end, q_end : (3, 3), (4,) rotation of b at the end to b at the start
    u, s : (3,) int C f dt, int int C f dt dt [m/s], [m]
    B, BB : (3, 3) int C dt, int int C dt dt [s], [s^2]
    interval_s : between two samples
    unrest : root of the summed variances of the axes, of rate and of specific force in the
        epoch [rad/s], [m/s^2]
    travel : None where there is no odometer for all of the epoch
    gap_s : longest time without a sample, beyond the usual interval
    """

    stamp_ns: int
    duration_s: float
    C_end: Array
    q_end: Array
    u: Array
    s: Array
    B: Array
    BB: Array
    interval_s: float
    unrest: tuple[float, float]
    travel: Travel | None
    gap_s: float = 0.0


def integrate_epoch(paired: Paired, sampling: ImuSampling, bias: Array | None = None) -> AidedEpoch:
    """The integrals over the samples of one epoch.

    bias : (6,) of rate and specific force, taken off [rad/s], [m/s^2]
    """
    block = paired.block
    values = np.concatenate((block.w_ib_b, block.f_ib_b))
    if bias is not None:
        values -= bias[:, None]
    n = values.shape[1] - 1
    inner = values[:, 1:]
    sums, squares = inner.sum(axis=1).tolist(), np.einsum("in,in->i", inner, inner).tolist()
    travelled = None
    if paired.distance is not None and paired.speed is not None:
        travelled = np.array((paired.distance, paired.speed))
    window = integrate_window(block.stamp_ns, values, sampling, travelled)
    travel = None
    if travelled is not None and window.paths is not None:
        (start, speed_start), (end, speed_end) = travelled[:, [0, -1]].T.tolist()
        M, M_rate = window.paths
        travel = Travel(M, M_rate, end - start, speed_start, speed_end, paired.variance)
    epoch = AidedEpoch(
        stamp_ns=int(block.stamp_ns[-1]),
        duration_s=window.duration_s,
        C_end=window.C_end,
        q_end=window.q_end,
        u=window.u,
        s=window.s,
        B=window.B,
        BB=window.BB,
        interval_s=window.duration_s / n,
        unrest=(_spread(sums[:3], squares[:3], n), _spread(sums[3:], squares[3:], n)),
        travel=travel,
        gap_s=_longest_gap(block.stamp_ns),
    )
    if paired.before is None or sampling is ImuSampling.MEAN:
        return epoch
    return _mend_edge(epoch, paired.before, block)


def as_measured(epoch: AidedEpoch, bias: Array) -> AidedEpoch:
    """Velocity and rotation of an epoch with the biases that were taken off its samples put back.

    bias : (6,) of rate and specific force, in b [rad/s], [m/s^2]

    To first order C turns by theta = int C b_g dt more, which grows with time, and so

        u = int C f dt + B b_a + theta x (int C f t dt) / T,    int C f t dt = T u - s

    The other integrals stay as they are.
    """
    theta = epoch.B @ bias[:3]
    turned = np.cross(theta, epoch.u - epoch.s / epoch.duration_s)
    return epoch._replace(
        C_end=exp_rotation(theta) @ epoch.C_end, u=epoch.u + epoch.B @ bias[3:] + turned
    )


def _mend_edge(epoch: AidedEpoch, before: ImuBlock, block: ImuBlock) -> AidedEpoch:
    """Make up for the edge between two epochs of point values, with the samples of both.

    Inside an epoch what a cubic misses of a vibration cancels from one interval to the next. Next
    to the edge the cubics lie to one side: the integrals differ from those through all samples by
    h/24 d^4 w for either interval, d^4 a fourth difference. With an edge every second, a vibration
    of whole hertz would be a constant rate.
    """
    stamps = np.concatenate((before.stamp_ns, block.stamp_ns[:5]))
    if stamps.shape[0] < 8 or not is_even(stamps):
        return epoch
    values = [
        np.concatenate((x[:, :3], y[:, :4]), axis=1)
        for x, y in zip(before[1:], block[1:], strict=True)
    ]
    fourth = np.diff(np.concatenate(values), 4, axis=1)
    missing = (-1.0 / 24.0 * epoch.interval_s) * (fourth[:, 0] + fourth[:, 2])
    angle, dv = missing[:3], missing[3:]
    R, travel = exp_rotation(angle), epoch.travel
    if travel is not None:
        travel = travel._replace(M=R @ travel.M, M_rate=R @ travel.M_rate)
    q = quaternion_from_rotation_vector(angle[:, None])[:, 0]
    return epoch._replace(
        C_end=R @ epoch.C_end,
        q_end=multiply_quaternions(q, epoch.q_end),
        u=R @ epoch.u + dv,
        s=R @ epoch.s + epoch.duration_s * dv,
        B=R @ epoch.B,
        BB=R @ epoch.BB,
        travel=travel,
    )


def _spread(sums: list[float], squares: list[float], n: int) -> float:
    """Root of the summed variances of the axes, from their sums and sums of squares."""
    variance = sum(q / n - (x / n) ** 2 for x, q in zip(sums, squares, strict=True))
    return math.sqrt(max(variance, 0.0))


def _longest_gap(stamp_ns: IntArray) -> float:
    """Longest time without a sample, beyond the usual interval [s]."""
    if not has_gap(stamp_ns):
        return 0.0
    steps = stamp_ns[1:] - stamp_ns[:-1]
    longest = int(steps.max())
    missing = longest - int(np.median(steps))
    return missing * 1e-9 if 3 * missing >= longest else 0.0
