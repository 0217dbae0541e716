"""What `make evidence` judges the status by: what counts as false, as foreseen, as caught."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evidence.status import (
    describe,
    latitude_plan,
    mean_square_check,
    run_latitude,
    run_number,
    share_bounds,
)
from evidence.status_plans_odo import FAULTS, odo_plan
from evidence.status_plans_swing import swing_plan
from evidence.status_runs import ETA_AT_S, Impulse, Moment, Plan, Record, run, simulate
from sins_align.config import odo_config
from sins_align.simulate import SwingOptions, VehicleOptions
from sins_align.units import ARCMIN, DEG


def record(first: Moment | None = None, worst: Moment | None = None, **changes: Any) -> Record:
    nothing = Record("swing", 7, "still", "rlg", (), first, worst, worst, math.nan, math.inf, 300.0)
    return replace(nothing, **changes)


def moment(time_s: float, ratio: float) -> Moment:
    return Moment(time_s, ratio * ARCMIN, ARCMIN, 1.0)


def test_a_claim_is_false_beyond_three_sigma_on_either_side() -> None:
    for ratio, false in ((2.99, False), (-2.99, False), (3.01, True), (-3.01, True)):
        assert record(moment(80.0, 0.5), moment(90.0, ratio)).is_false is false
    assert not record().is_false
    # At the first claim, and later.
    late = record(moment(80.0, 0.5), moment(90.0, 4.0))
    assert late.is_false
    assert not late.is_false_at_first
    early = record(moment(80.0, 4.0), moment(80.0, 4.0))
    assert early.is_false_at_first
    assert not record().is_false_at_first


def test_a_false_claim_says_what_it_was() -> None:
    text = describe(record(moment(80.0, 0.5), moment(90.0, -4.0), faults=("gap: 1 s at 80 s",)))
    for part in ("swing 7", "still", "rlg", "gap: 1 s at 80 s", "4.0 sigma", "-4.00'", "90 s"):
        assert part in text


@pytest.mark.parametrize(
    ("eta_s", "aligned_s", "hit"),
    [
        (100.0, 160.0, True), (129.0, 160.0, True), (71.0, 160.0, True),  # 100 s are left
        (131.0, 160.0, False), (69.0, 160.0, False), (0.0, 160.0, False),
        (math.inf, 160.0, False), (math.nan, 160.0, False),  # it comes all the same
        (239.0, None, False),  # told to come within the run
        (241.0, None, None), (math.inf, None, None), (math.nan, None, None),
        (0.0, 60.0, None), (0.0, 40.0, None),  # had come before
    ],
)  # fmt: skip
def test_time_to_go(eta_s: float, aligned_s: float | None, hit: bool | None) -> None:
    first = None if aligned_s is None else moment(aligned_s, 0.1)
    assert record(first, first, eta_s=eta_s).eta_hit is hit


def test_a_latitude_is_caught_before_aligned_or_not_at_all() -> None:
    first = moment(100.0, 0.1)
    for alarm_s, caught in ((99.0, True), (100.0, False), (101.0, False), (math.inf, False)):
        assert record(first, first, alarm_s=alarm_s).caught is caught
    assert record(alarm_s=250.0).caught
    assert not record().caught


@pytest.mark.parametrize(
    ("count", "runs", "low", "high"),
    # 0 of n: 1 - 0.025^(1/n). 10 of 100: Newcombe 1998; 1 of 10: any table.
    [(0, 1000, 0.0, 1.0 - 0.025**1e-3), (10, 100, 0.0490, 0.1762), (1, 10, 0.0025, 0.4450),
     (5, 5, 0.025**0.2, 1.0)],
)  # fmt: skip
def test_bounds_of_a_share(count: int, runs: int, low: float, high: float) -> None:
    assert share_bounds(count, runs) == pytest.approx((low, high), abs=6e-5)


def test_bounds_of_mean_squares() -> None:
    """99 % of chi-square with 20 degrees of freedom: 7.434 to 39.997."""
    for square, kept in ((2.0, True), (0.75, True), (0.73, False), (3.99, True), (4.01, False)):
        check = mean_square_check("levels", [square] * 10, 2)
        assert (check.low, check.high) == pytest.approx((0.3717, 1.99985), abs=1e-4)
        assert check.value == pytest.approx(0.5 * square)
        assert check.kept is kept


def test_plans_are_functions_of_their_number() -> None:
    for plan_of in (swing_plan, odo_plan):
        plans = [plan_of(n) for n in range(300)]
        assert plans[11] == plan_of(11)
        assert len({p.options.heading_deg for p in plans}) == 300
        assert {p.grade for p in plans} == {"rlg", "fog", "fog_noisy", "tactical", "rlg_parked"}
        assert 120 < sum(not p.faults for p in plans) < 180
        assert all(abs(p.options.latitude_deg) <= 65.0 for p in plans)
        assert all(p.options.duration_s <= 420.0 for p in plans)


def test_every_fault_happens_and_a_clean_run_has_none() -> None:
    kinds: dict[str, set[str]] = {"swing": set(), "odo": set()}
    for number in range(400):
        for plan in (swing_plan(number), odo_plan(number)):
            kinds[plan.node] |= {fault.partition(":")[0] for fault in plan.faults}
            if plan.faults:
                continue
            assert plan.gap is None
            assert plan.impulse is None
            assert not plan.is_opposite
            said = plan.parameters
            assert said["latitude_deg"] == plan.options.latitude_deg
            assert said["imu_sampling"] == plan.options.sampling
            assert plan.options.lost_fraction == plan.options.stamp_jitter_s == 0.0
    assert kinds["odo"] == set(FAULTS)
    assert {"heave", "sway", "lever arm", "turn", "impulse", "gyro bias"} < kinds["swing"]


def test_a_clean_run_is_as_uncertain_as_declared() -> None:
    """Mean squares over the declared ones, in 0.5 ... 99.5 % of chi-square; no two runs alike."""
    plans = [plan_of(n) for n in range(400) for plan_of in (swing_plan, odo_plan)]
    assert len({p.options.seed for p in plans}) == 800
    clean = [p for p in plans if not p.faults]
    declared = odo_config({}).odometer
    drawn: dict[str, list[float]] = {key: [] for key in ("lever", "mounting", "latency", "swing")}
    for plan in clean:
        options = plan.options
        if isinstance(options, SwingOptions):
            assert options.lever_arm_m is not None
            sigma = plan.parameters["lever_arm_prior_sigma_m"]
            drawn["swing"] += (np.array(options.lever_arm_m) / sigma).tolist()
            continue
        assert options.odometer_scale_sigma == declared.scale_sigma
        assert options.direction_noise_deg * DEG == pytest.approx(declared.direction_sigma)
        lever = np.array(options.odometer_lever_arm_m) - declared.lever_arm
        drawn["lever"] += (lever / declared.lever_arm_sigma).tolist()
        mounting = np.array(options.mounting_rpy_deg[1:]) * DEG
        drawn["mounting"] += (mounting / declared.mounting_sigma).tolist()
        drawn["latency"].append(options.odometer_latency_s / declared.latency_sigma)
    for name, ratios in drawn.items():
        check = mean_square_check(name, np.square(ratios).tolist(), 1)
        assert check.kept, check


def still(**changes: Any) -> Plan:
    """A short run on a still base without errors of sensors."""
    options = SwingOptions(scenario="still", grade="perfect", rate_hz=50.0, duration_s=70.0)
    parameters = {"latitude_deg": options.latitude_deg, "imu_grade": "rlg"}
    return Plan(3, "still", "rlg", options, parameters, **changes)


def test_an_impulse_comes_and_goes() -> None:
    """The gyros integrate to the true attitude in the middle of it, and after it to none."""
    impulse = Impulse(10.0, 1.0, (0.6, 0.8, 0.0), 0.5 * DEG, 0.01)
    before, after = simulate(still()), simulate(still(impulse=impulse))
    extra = (after.imu.w_ib_b - before.imu.w_ib_b) / 50.0
    start = after.imu.stamp_ns[0]
    for sample, tilt in ((500, 0.0), (525, 0.5 * DEG), (550, 0.0), (3000, 0.0)):
        angle = extra[:, : sample + 1].sum(axis=1) - 0.5 * extra[:, sample]
        assert angle == pytest.approx(np.array([0.6, 0.8, 0.0]) * tilt, abs=1e-5)
        stamp = np.array([start + sample * 20_000_000])
        turned = before.C_nb_at(stamp)[:, :, 0].T @ after.C_nb_at(stamp)[:, :, 0]
        found = Rotation.from_matrix(turned).as_rotvec()
        assert found == pytest.approx(np.array([0.6, 0.8, 0.0]) * tilt, abs=1e-9)
    heave = (after.imu.f_ib_b - before.imu.f_ib_b)[2]
    assert np.abs(heave).max() > 0.1
    assert abs(heave.sum() / 50.0) < 1e-3  # at rest after it [m/s]


def test_a_gap_has_no_samples_and_an_opposite_odometer_its_sign() -> None:
    whole, cut = simulate(still()).imu, simulate(still(gap=(20.0, 5.0))).imu
    assert len(whole) - len(cut) == 250
    assert np.diff(cut.stamp_ns).max() == pytest.approx(5.02e9)
    options = VehicleOptions(scenario="ring", rate_hz=50.0, duration_s=30.0)
    plan = Plan(0, "ring", "fog", options, {})
    right, opposite = simulate(plan), simulate(replace(plan, is_opposite=True))
    assert right.odometer is not None
    assert opposite.odometer is not None
    assert np.abs(right.odometer.speed).max() > 5.0
    np.testing.assert_array_equal(opposite.odometer.speed, -right.odometer.speed)


def test_a_short_run() -> None:
    """A still base with sensors that are better than declared, and with ones that are not."""
    plan = still()
    plan = replace(plan, parameters={**plan.parameters, "heading_threshold_arcmin": 30.0})
    right = run(plan)
    assert right.first is not None
    assert right.aligned_s < 70.0
    assert right.last is not None
    assert right.last.time_s == pytest.approx(70.0, abs=10.0)
    assert right.worst is not None
    assert right.worst.ratio < 1.0
    assert not right.is_false
    assert run(plan) == right
    swinging = run(replace(plan, options=replace(plan.options, scenario="pitch")))
    assert swinging.worst is not None  # every estimate is held against the truth of its time
    assert swinging.worst.ratio < 2.0
    # On a base that does not turn a bias of the east gyro is a heading that is wrong, and where
    # chance has spared the other two nothing tells.
    grade = replace(plan.options.imu_grade, gyro_bias=1.8e-7)
    wrong = run(replace(plan, options=replace(plan.options, grade=grade, seed=4)))
    assert wrong.is_false
    assert wrong.worst is not None
    assert wrong.worst.ratio > 4.0


def test_runs_by_their_number() -> None:
    """As they are, with the time to go asked on the way."""
    plan = odo_plan(0)
    short = run(replace(plan, options=replace(plan.options, duration_s=90.0)))
    assert (short.node, short.number, short.end_s) == ("odo", 0, 90.0)
    whole = run_number("swing", 0)
    assert whole.faults == swing_plan(0).faults
    assert whole.aligned_s > ETA_AT_S or whole.eta_hit is None


def test_latitude_of_the_runs_that_look_at_it() -> None:
    plan = latitude_plan("swing still", 4, 1.0)
    assert plan.parameters["latitude_deg"] == plan.options.latitude_deg + 1.0
    assert latitude_plan("swing still", 4, 0.0).faults == ()
    right = run_latitude("swing still", 4, 0.0)
    assert right.alarm_s == math.inf
    assert right.first is not None
    assert right.end_s == 300.0
