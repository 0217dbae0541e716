"""Fine alignment of Mu and Fang: velocity navigated at the swing centre, and its filter."""

from __future__ import annotations

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.rotation import cross, skew
from sins_align.swing.paper_error_model import A, Earth, G
from sins_align.swing.paper_filter import QuaternionFilter
from sins_align.swing.paper_navigation import Grid, Motion, centre_specific_force, integrate
from sins_align.types import Array, IntArray, LeverArm

# Where the filter begins, and begins anew at every switch.
_TILT_SIGMA = np.radians([10.0, 10.0, 30.0])
_VELOCITY_SIGMA = 1e-3  # [m/s]
# Floor of the measurement noise [m/s].
_VELOCITY_NOISE = 1e-5
# The lag's error swings with the base instead of being white: it stays for so many filter
# steps, and as white noise it must count for as many.
_LAG_STEPS = 10.0


class FineAlignment:
    """The velocity at the swing centre, which ought to be zero, tells the attitude.

    The attitude itself is the caller's; the filter holds what it is wrong by.

    Parameters
    ----------
    gravity : [m/s^2]
    interval_s : of the samples [s]
    lag_s : of the angular acceleration [s]
    """

    def __init__(
        self, earth: Earth, gravity: float, grade: ImuGrade, interval_s: float, lag_s: float
    ) -> None:
        self._earth = earth
        self._gravity = gravity
        self._noise = np.diag(np.repeat([grade.gyro_arw**2, grade.accel_vrw**2], 3))
        self._rate_variance = grade.gyro_arw**2 / interval_s
        self._lag_s = lag_s
        self._filter = QuaternionFilter(_TILT_SIGMA, _VELOCITY_SIGMA)
        self.V = np.zeros(2)

    def reset(self, Q: Array) -> None:
        """Begin at the attitude Q (4,), its error unknown."""
        self._filter.reset(Q)
        self._lag_force = np.zeros(2)
        self._lag_time = 0.0

    def corrected(self, Q: Array) -> Array:
        """The navigated attitude Q (4,) without the error found: a unit quaternion."""
        corrected = Q - self._filter.x[:4]
        return np.asarray(corrected / np.linalg.norm(corrected))

    def switch(self, Q: Array) -> None:
        """The caller has corrected its attitude to Q (4,): correct the velocity, begin anew."""
        self.V = self.V - self._filter.x[4:]
        self.reset(Q)

    def change_lever_arm(self, motion: Motion, step_b: Array) -> None:
        """The lever arm changes by `step_b` (3,) [m] at the end of `motion`.

        The velocity navigated so far has -C (w x r) in it.
        """
        step = -(motion.C_nb[:2, :, -1] @ np.cross(motion.w_ib_b[:, -1], step_b))
        self.V = self.V + step
        self._filter.move_velocity(step)

    def run(self, motion: Motion, grid: Grid, lever: LeverArm) -> None:
        """Navigate the velocity over a stretch of motion, correct at every filter step."""
        nodes = grid.navigation
        ends = nodes[grid.filter]
        f_b = centre_specific_force(motion.w_ib_b, motion.dw_ib_b, motion.f_ib_b, lever.r_b)
        dV = integrate(motion.t, np.einsum("ijn,jn->in", motion.C_nb[:2], f_b), ends)
        transitions = self._transitions(motion, nodes, f_b)
        for k, end in enumerate(ends[1:]):
            transition = np.eye(6)
            for step in transitions[grid.filter[k] : grid.filter[k + 1]]:
                transition = step @ transition
            duration = float(motion.t[end] - motion.t[ends[k]])
            input_matrix = G(motion.Q[:, end], motion.C_nb[:, :, end])
            noise = input_matrix @ self._noise @ input_matrix.T * duration
            self._filter.predict(transition, noise)
            self.V = self.V + dV[:, k] + self._earth.coriolis(self.V) * duration
            self._filter.correct(self.V, self._measurement_noise(motion, end, lever))
        self._add_lag_force(motion, ends[1:], lever.r_b)

    def _transitions(self, motion: Motion, nodes: IntArray, f_b: Array) -> Array:
        """I + A dt + (A dt)^2 / 2 of every navigation step, A the mean of its ends: (M, 6, 6)."""
        A_nodes = A(
            motion.Q[:, nodes].T,
            self.V,
            motion.w_ib_b[:, nodes].T,
            f_b[:, nodes].T,
            self._earth,
        )
        dt = np.diff(motion.t[nodes])[:, np.newaxis, np.newaxis]
        A_dt = 0.5 * dt * (A_nodes[1:] + A_nodes[:-1])
        transitions: Array = np.eye(6) + A_dt + 0.5 * A_dt @ A_dt
        return transitions

    def _measurement_noise(self, motion: Motion, end: int, lever: LeverArm) -> Array:
        """Noise of the velocity (2, 2) [m^2/s^2] at the index `end`.

        C (w x r) is taken off the accelerometers' velocity: errors of r, noise of w and, with
        the derivative late by tau, tau C (dw x r) stay in it.
        """
        C = motion.C_nb[:2, :, end]
        C_w = C @ skew(motion.w_ib_b[:, end])
        C_r = C @ skew(lever.r_b)
        late = self._lag_s * (C_r @ motion.dw_ib_b[:, end])
        floor = _VELOCITY_NOISE**2 + 0.5 * _LAG_STEPS * float(late @ late)
        noise: Array = C_w @ lever.covariance @ C_w.T + self._rate_variance * C_r @ C_r.T
        return noise + floor * np.eye(2)

    def _add_lag_force(self, motion: Motion, ends: IntArray, r_b: Array) -> None:
        """Mean of the specific force that a late derivative feigns.

        -tau C (ddw x r) has the mean of tau C (w x (dw x r)): the rest is a derivative.
        """
        w, dw, C = motion.w_ib_b[:, ends], motion.dw_ib_b[:, ends], motion.C_nb[:2, :, ends]
        force = np.einsum("ijn,jn->in", C, cross(w, cross(dw, np.outer(r_b, np.ones(ends.size)))))
        self._lag_force += self._lag_s * force.sum(axis=1)
        self._lag_time += ends.size

    def tilt_covariance(self, Q: Array) -> Array:
        """(3, 3) of the misalignment, east, north, up [rad^2], for the navigated Q (4,)."""
        east, north = self._lag_force / (self._gravity * max(self._lag_time, 1.0))
        lag_tilt = np.array([-north, east, 0.0])
        growth = max(1.0, self.consistency) if self.consistency == self.consistency else 1.0
        covariance: Array = growth * self._filter.tilt_covariance(Q)
        return covariance + np.outer(lag_tilt, lag_tilt)

    @property
    def consistency(self) -> float:
        """Mean normalised innovation squared over 2, since the filter began anew."""
        return self._filter.consistency
