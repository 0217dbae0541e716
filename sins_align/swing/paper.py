"""Self-alignment by the method of Mu and Fang, with its misprints corrected."""

from __future__ import annotations

import math

import numpy as np

from sins_align.config import SwingConfig
from sins_align.earth import normal_gravity
from sins_align.rotation import (
    dcm_from_quaternion,
    dcm_from_rpy,
    multiply_quaternions,
    quaternion_from_dcm,
    quaternion_from_rotation_vector,
)
from sins_align.swing.paper_differentiator import make_differentiator
from sins_align.swing.paper_error_model import Earth, G
from sins_align.swing.paper_error_model import A as system_matrix
from sins_align.swing.paper_filter import QuaternionFilter
from sins_align.swing.paper_lever import LeverRegression
from sins_align.swing.paper_navigation import (
    centre_specific_force,
    integrate,
    make_grid,
    navigate_attitude,
)
from sins_align.swing.paper_schedule import Event, events
from sins_align.swing.paper_stream import SampleStream, Stretch
from sins_align.types import Array, Estimate, ImuBlock, Position

_TILT_SIGMA = np.radians([10.0, 10.0, 30.0])  # where the filter starts, and at each switch
_VELOCITY_SIGMA = 1e-3  # [m/s]
_VELOCITY_NOISE = 1e-5  # R of the filter [m/s]


class PaperAligner:
    """Aligner of method `paper`."""

    def __init__(self, config: SwingConfig, position: Position) -> None:
        self._config = config
        self._grade = config.grade
        self._earth = Earth.at(position)
        self._gravity = normal_gravity(position.latitude, position.altitude)
        self._stream = SampleStream(config.sampling)
        self._differentiate = make_differentiator(
            config.paper.differentiator, config.paper.eso_bandwidth
        )
        self._filter = QuaternionFilter(_TILT_SIGMA, _VELOCITY_SIGMA)
        self._regression: LeverRegression | None = None
        self._lever = None
        self._Q = quaternion_from_dcm(dcm_from_rpy(*config.paper.initial_rpy))
        self._V = np.zeros(2)
        self._fine = False
        self._first_ns: int | None = None
        self._stamp_ns = 0

    def update(self, block: ImuBlock) -> None:
        """Take in the next block of samples."""
        if self._first_ns is None:
            self._first_ns = self._stamp_ns = int(block.stamp_ns[0])
            self._regression = self._make_regression(block)
        stretch = self._stream.extend(block)
        begin_ns, self._stamp_ns = self._stamp_ns, int(block.stamp_ns[-1])
        if stretch is None:
            return
        self._navigate(stretch)
        begin_s, end_s = ((ns - self._first_ns) * 1e-9 for ns in (begin_ns, self._stamp_ns))
        for event in events(self._config.paper, begin_s, end_s):
            self._feed_back(event, stretch)

    def _make_regression(self, block):
        h = float(block.stamp_ns[-1] - block.stamp_ns[0]) * 1e-9 / (block.stamp_ns.size - 1)
        rate_noise = self._grade.gyro_arw / math.sqrt(h)
        r = LeverRegression(
            self._gravity,
            self._config.paper.regression == "epls",
            self._config.lever_arm_prior,
            self._config.lever_arm_prior_sigma,
            self._grade.accel_vrw / math.sqrt(h),
            math.sqrt(2) * rate_noise / h,
        )
        self._lever = r.solve().lever_arm
        return r

    def _navigate(self, stretch: Stretch) -> None:
        t, w = stretch.t[1:-1], stretch.w_ib_b[:, 1:-1]
        dw = self._differentiate(stretch.t, stretch.w_ib_b)
        Q = navigate_attitude(self._Q, t, stretch.theta, self._earth.rate_n(self._V))
        C_nb = dcm_from_quaternion(Q)
        grid = make_grid(t)
        ends = grid.navigation[grid.filter]
        s = ends[1:]
        self._regression.add(C_nb[:, :, s], w[:, s], dw[:, s], stretch.f_ib_b[:, s])
        if self._fine:
            f = centre_specific_force(w, dw, stretch.f_ib_b, self._lever.r_b)
            self._run_filter(t, Q, C_nb, w, f, grid)
        self._Q = Q[:, -1]

    def _run_filter(self, t, Q, C_nb, w, f, grid):
        du = integrate(t, np.einsum("ijn,jn->in", C_nb[:2], f), grid.navigation[grid.filter])
        n = grid.navigation
        A = system_matrix(Q[:, n].T, self._V, w[:, n].T, f[:, n].T, self._earth)
        d = np.diff(t[n])[:, None, None] * 0.5 * (A[1:] + A[:-1])
        steps = np.eye(6) + d + 0.5 * d @ d
        q = np.diag(np.repeat([self._grade.gyro_arw**2, self._grade.accel_vrw**2], 3))
        R = _VELOCITY_NOISE**2 * np.eye(2)
        for k, (a, b) in enumerate(zip(grid.filter[:-1], grid.filter[1:])):
            transition = np.eye(6)
            for step in steps[a:b]:
                transition = step @ transition
            end = n[b]
            duration = t[n[b]] - t[n[a]]
            noise = G(Q[:, end], C_nb[:, :, end])
            self._filter.predict(transition, noise @ q @ noise.T * duration)
            self._V = self._V + du[:, k] + self._earth.coriolis(self._V) * duration
            self._filter.correct(self._V, R)

    def _feed_back(self, event: Event, stretch: Stretch) -> None:
        regression = self._regression
        if event is Event.LEVEL:
            solution = regression.solve()
            self._lever = solution.lever_arm
            psi = np.append(solution.level, 0.0)
            self._Q = multiply_quaternions(quaternion_from_rotation_vector(-psi), self._Q)
            regression.restart()
        elif event is Event.FINE:
            self._fine = True
            self._V = np.zeros(2)
            self._filter.reset(self._Q)
        elif event is Event.SWITCH:
            Q = self._Q - self._filter.x[:4]
            self._Q = Q / np.linalg.norm(Q)
            self._V = self._V - self._filter.x[4:]
            self._filter.reset(self._Q)
            if RESTART:
                regression.restart()
        elif event is Event.LEVER:
            lever = regression.solve().lever_arm
            C_nb = dcm_from_quaternion(self._Q)
            step = -(C_nb @ np.cross(stretch.w_ib_b[:, -2], lever.r_b - self._lever.r_b))[:2]
            self._V = self._V + step
            self._filter.move_velocity(step)
            self._lever = lever

    @property
    def estimate(self) -> Estimate | None:
        """At the last stamp of the last block; None before there is one."""
        if not self._fine:
            return None
        return self._estimate_at(self._stamp_ns, *self._stream.ahead())

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block`; changes nothing."""
        if not self._fine:
            return None
        return self._estimate_at(int(block.stamp_ns[-1]), *self._stream.ahead(block))

    def _estimate_at(self, stamp_ns: int, elapsed: float, theta: Array) -> Estimate:
        Q = self._Q - self._filter.x[:4]
        w_in_n = self._earth.rate_n(self._V)
        Q = navigate_attitude(Q, np.linspace(0, elapsed, theta.shape[1] + 1), theta, w_in_n)[:, -1]
        return Estimate(
            stamp_ns,
            Q,
            self._filter.tilt_covariance(self._Q),
            np.zeros(3),
            np.full(3, self._grade.gyro_bias),
            np.zeros(3),
            np.full(3, self._grade.accel_bias),
            self._lever,
            self._filter.consistency,
        )
RESTART = True
