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
from sins_align.swing.paper_differentiator import (
    Differentiator,
    make_differentiator,
    noise_gain,
)
from sins_align.swing.paper_error_model import Earth
from sins_align.swing.paper_fine import FineAlignment
from sins_align.swing.paper_lever import LeverRegression, RegressionNoise
from sins_align.swing.paper_navigation import Motion, make_grid, navigate_attitude
from sins_align.swing.paper_schedule import Event, events
from sins_align.swing.paper_stream import SampleStream, Stretch
from sins_align.types import Advance, Array, Estimate, ImuBlock, ImuSampling, LeverArm, Position


class PaperAligner:
    """Aligner of method `paper`: the closed loop of Mu and Fang, Fig. 2.

    It starts from the configured initial attitude: there is no coarse alignment. In the level
    phase the gyros carry the attitude, and the least squares that find the lever arm correct
    its levels. Then the velocity at the swing centre, which ought to be zero, tells a Kalman
    filter the attitude. At the switching times its state is fed back and it begins anew; every
    30 s it gets the lever arm found so far. Feedback waits for the end of the block; a switch
    waits until the filter knows the heading to 10 deg, which with gyros like the paper's it
    does at once, and a new lever arm until it is better than the one in use.

    Nothing tells the heading before the filter runs: there is no estimate in the level phase,
    and after it the covariance starts with 10, 10, 30 deg. A start whose heading is wrong by
    nearly 180 deg does not converge; `consistency` is then far above 1, and above 10 the
    covariance is that of the start again.

    The covariance covers white noise, the lever arm's error, the lag of the derivative, and the
    biases of the grade, which the method does not estimate. It grows with `consistency` where
    that is above 1. It does not cover scale factors, sensor misalignment, or a motion of the
    swing centre that the innovations do not show.

    Samples: instantaneous values are used as they are, one sample behind the block. Interval
    means give the rotation over their interval, and averages of two neighbours stand for the
    values at the stamp between; that is two samples behind. The gyros carry the estimate to
    the block's end.

    Parameters
    ----------
    config : the settings; `config.paper` are the paper's
    position : of the swing centre
    """

    def __init__(self, config: SwingConfig, position: Position) -> None:
        self._config = config
        self._grade = config.grade
        self._earth = Earth.at(position)
        self._gravity = normal_gravity(position.latitude, position.altitude)
        self._stream = SampleStream(config.sampling)
        self._differentiate = self._make_differentiator()
        self._regression: LeverRegression | None = None
        self._lever = LeverArm(
            config.lever_arm_prior,
            config.lever_arm_prior_sigma**2 * np.eye(3),
            (False, False, False),
        )
        self._Q = quaternion_from_dcm(dcm_from_rpy(*config.paper.initial_rpy))
        self._fine: FineAlignment | None = None
        self._switch_due = False
        self._first_ns = self._stamp_ns = 0

    @property
    def lever_arm(self) -> LeverArm:
        """The one in use: of the last correction of the levels, or of the fine alignment."""
        return self._lever

    def _make_differentiator(self) -> Differentiator:
        paper = self._config.paper
        return make_differentiator(paper.differentiator, paper.eso_bandwidth)

    def foresee(self, heading: float) -> float:
        """Not known: what its covariance will be depends on what it feeds back when."""
        estimate = self.estimate
        known = estimate is not None and bool(estimate.sigma[2] < heading)
        return 0.0 if known else math.nan

    def next_step(self, ahead_s: float) -> float:
        """See `Aligner`: steps are a second or two apart."""
        return ahead_s

    def update(self, block: ImuBlock) -> list[Advance]:
        """Take in the next block of samples; a step, unless the estimate is an older one."""
        self._take_in(block)
        stamp_ns, estimate = int(block.stamp_ns[-1]), self.estimate
        if estimate is not None and estimate.stamp_ns != stamp_ns:
            return []
        return [Advance(stamp_ns, estimate)]

    def _take_in(self, block: ImuBlock) -> None:
        if self._regression is None:
            self._first_ns = self._stamp_ns = int(block.stamp_ns[0])
            self._regression = self._make_regression(block)
        stretch = self._stream.extend(block)
        begin_ns, self._stamp_ns = self._stamp_ns, int(block.stamp_ns[-1])
        if stretch is None:
            return
        motion = self._navigate(stretch, self._regression)
        begin_s, end_s = ((ns - self._first_ns) * 1e-9 for ns in (begin_ns, self._stamp_ns))
        for event in events(self._config.paper, begin_s, end_s):
            self._feed_back(event, motion, self._regression)
        if self._fine is not None and self._switch_due and self._fine.knows_heading(self._Q):
            self._switch_due = False
            self._Q = self._fine.corrected(self._Q)
            self._fine.switch(self._Q, motion, self._lever)
            self._regression.restart()

    def _make_regression(self, block: ImuBlock) -> LeverRegression:
        interval = float(block.stamp_ns[-1] - block.stamp_ns[0]) * 1e-9 / (block.stamp_ns.size - 1)
        density = 1.0 / math.sqrt(interval)
        averaged = self._config.sampling is ImuSampling.MEAN
        noise = RegressionNoise(
            self._grade.accel_vrw * density,
            self._grade.accel_bias,
            self._grade.gyro_arw
            * density
            * noise_gain(self._make_differentiator(), interval, averaged),
            self._differentiate.lag(interval),
        )
        return LeverRegression(
            self._gravity,
            self._config.paper.regression == "epls",
            self._config.lever_arm_prior,
            self._config.lever_arm_prior_sigma,
            noise,
        )

    def _navigate(self, stretch: Stretch, regression: LeverRegression) -> Motion:
        t = stretch.t[1:-1]
        w_in_n = self._earth.w_ie_n if self._fine is None else self._earth.rate_n(self._fine.V)
        Q = navigate_attitude(self._Q, t, stretch.theta, w_in_n)
        self._Q = Q[:, -1]
        dw = self._differentiate(stretch.t, stretch.w_ib_b)
        w = stretch.w_ib_b[:, 1:-1]
        motion = Motion(t, Q, dcm_from_quaternion(Q), w, dw, stretch.f_ib_b)
        grid = make_grid(t)
        ends = grid.navigation[grid.filter]
        ddw = np.gradient(dw[:, ends], t[ends], axis=1)
        k = ends[1:]
        regression.add(motion.C_nb[:, :, k], w[:, k], dw[:, k], motion.f_ib_b[:, k], ddw[:, 1:])
        if self._fine is not None:
            self._fine.run(motion, grid, self._lever)
        return motion

    def _feed_back(self, event: Event, motion: Motion, regression: LeverRegression) -> None:
        if event is Event.LEVEL:
            solution = regression.solve()
            regression.restart()
            self._lever = solution.lever_arm
            tilt = np.array([*solution.level, 0.0])
            self._Q = multiply_quaternions(quaternion_from_rotation_vector(-tilt), self._Q)
        elif event is Event.FINE:
            h = float(motion.t[-1]) / (motion.t.size - 1)
            self._fine = FineAlignment(
                self._earth, self._gravity, self._grade, h, self._differentiate.lag(h)
            )
            self._fine.start(self._Q, motion, self._lever)
        elif event is Event.LEVER and self._fine is not None:
            lever = regression.solve().lever_arm
            # After a restart the fit may still be poorer than the one in use.
            if np.trace(lever.covariance) < np.trace(self._lever.covariance):
                self._fine.change_lever_arm(motion, lever.r_b - self._lever.r_b)
                self._lever = lever
        elif event is Event.SWITCH:
            self._switch_due = True

    @property
    def estimate(self) -> Estimate | None:
        """At the last stamp of the last block; None before the end of the level phase."""
        return self._carried(self._stamp_ns, *self._stream.ahead()) if self._fine else None

    def propagate(self, block: ImuBlock) -> Estimate | None:
        """`estimate` carried to the end of `block` by the gyros; changes nothing."""
        if self._fine is None:
            return None
        return self._carried(int(block.stamp_ns[-1]), *self._stream.ahead(block))

    def conclude(self, block: ImuBlock) -> Estimate | None:
        """As `propagate`: this method leaves nothing for later."""
        return self.propagate(block)

    def _carried(self, stamp_ns: int, elapsed: float, theta: Array) -> Estimate:
        assert self._fine is not None
        Q = self._fine.corrected(self._Q)
        t = np.linspace(0.0, elapsed, theta.shape[1] + 1)
        return Estimate(
            stamp_ns=stamp_ns,
            q_nb=navigate_attitude(Q, t, theta, self._earth.rate_n(self._fine.V))[:, -1],
            misalignment_covariance=self._fine.tilt_covariance(self._Q),
            gyro_bias=np.zeros(3),
            gyro_bias_sigma=np.full(
                3, math.hypot(self._grade.gyro_bias, self._grade.gyro_bias_instability)
            ),
            accel_bias=np.zeros(3),
            accel_bias_sigma=np.full(3, self._grade.accel_bias),
            lever_arm=self._lever,
            consistency=self._fine.consistency,
        )
