"""The simulated run as a whole: stamps, faults, seeds, truth, settings."""

import dataclasses
import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sins_align.grades import ImuGrade
from sins_align.simulate import SCENARIOS, SingleAxisSwing, SwingOptions, SwingRun, simulate_swing
from sins_align.simulate.random_streams import random_streams
from sins_align.types import ImuSamples, ImuSampling

SHORT = SwingOptions(duration_s=20.0, grade="fog", seed=5)
BEGIN = SHORT.start_stamp_ns


def run(**changes: object) -> SwingRun:
    return simulate_swing(dataclasses.replace(SHORT, **changes))


def assert_same(a: ImuSamples, b: ImuSamples) -> None:
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)


def test_stamps_are_exact_and_reach_the_end() -> None:
    imu = run(rate_hz=300.0, duration_s=10.0).imu
    assert len(imu) == 3001
    assert imu.stamp_ns.dtype == np.int64
    assert imu.stamp_ns[[0, 1, 2, -1]].tolist() == [
        BEGIN, BEGIN + 3_333_333, BEGIN + 6_666_667, BEGIN + 10_000_000_000,
    ]  # fmt: skip
    assert imu.w_ib_b.shape == imu.f_ib_b.shape == (3, 3001)


def test_same_seed_same_numbers() -> None:
    assert_same(run().imu, run().imu)


def test_another_seed_other_numbers() -> None:
    one, other = run(), run(seed=6)
    assert not np.any(one.imu.w_ib_b == other.imu.w_ib_b)
    assert not np.any(one.truth.gyro_bias_rad_s == other.truth.gyro_bias_rad_s)


@pytest.mark.parametrize(
    "changes",
    [
        {"heave_m": 0.2, "sway_m": 0.1},
        {"turn_deg": 90.0, "turn_duration_s": 10.0},
        {"drive_m": 50.0, "drive_duration_s": 10.0, "drive_shake_m_s2": 0.3},
        {"scenario": "erect"},
        {"sampling": "mean"},
        {"stamp_jitter_s": 1e-5},
    ],
)
def test_other_options_keep_the_noise(changes: dict[str, object]) -> None:
    """Scale errors aside, what the sensors add does not depend on the motion."""
    grade = dataclasses.replace(SHORT.imu_grade, gyro_scale=0.0, accel_scale=0.0, misalignment=0.0)

    def noise(**more: object) -> tuple[np.ndarray, np.ndarray]:
        real, perfect = run(grade=grade, **more).imu, run(grade="perfect", **more).imu
        return real.w_ib_b - perfect.w_ib_b, real.f_ib_b - perfect.f_ib_b

    for plain, changed in zip(noise(), noise(**changes), strict=True):
        np.testing.assert_allclose(changed, plain, rtol=0, atol=2e-14)


@pytest.mark.parametrize(("purpose", "position"), [("attitude_phases", 0), ("vehicle_course", 23)])
def test_a_new_purpose_leaves_the_old_streams(purpose: str, position: int) -> None:
    expected = np.random.default_rng(np.random.SeedSequence(7, spawn_key=(position,)))
    assert random_streams(7)[purpose].integers(2**62) == expected.integers(2**62)


def test_grade_keeps_the_motion() -> None:
    stamp = BEGIN + 7_000_000_000
    np.testing.assert_array_equal(
        run().truth.C_nb_at(stamp), run(grade="perfect").truth.C_nb_at(stamp)
    )


def test_lost_samples_are_missing_and_nothing_else() -> None:
    whole, holed = run(duration_s=100.0).imu, run(duration_s=100.0, lost_fraction=0.1).imu
    lost = len(whole) - len(holed)
    expected, sigma = 0.1 * len(whole), math.sqrt(0.1 * 0.9 * len(whole))
    assert abs(lost - expected) < 4.0 * sigma
    assert holed.stamp_ns[[0, -1]].tolist() == whole.stamp_ns[[0, -1]].tolist()
    assert_same(holed, whole.select(np.isin(whole.stamp_ns, holed.stamp_ns)))


def test_jitter_moves_stamps_only() -> None:
    plain, jittered = run(duration_s=100.0), run(duration_s=100.0, stamp_jitter_s=1e-4)
    error_s = (jittered.imu.stamp_ns - plain.imu.stamp_ns) * 1e-9
    # 20001 samples: the sigma of sigma is 0.5 %.
    assert error_s.std() == pytest.approx(1e-4, rel=0.02)
    assert abs(error_s.mean()) < 4.0 * 1e-4 / math.sqrt(error_s.size)
    np.testing.assert_array_equal(jittered.imu.w_ib_b, plain.imu.w_ib_b)
    np.testing.assert_array_equal(jittered.imu.f_ib_b, plain.imu.f_ib_b)


def test_strong_jitter_keeps_the_order() -> None:
    imu = run(duration_s=100.0, stamp_jitter_s=0.25 / 200.0).imu
    assert np.diff(imu.stamp_ns).min() > 0


@pytest.mark.parametrize("jitter", [0.0, 1e-3])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_truth_is_at_the_last_stamp(scenario: str, jitter: float) -> None:
    swing = run(scenario=scenario, stamp_jitter_s=jitter, turn_deg=30.0, turn_duration_s=30.0,
                turn_start_s=1.0)  # fmt: skip
    truth = swing.truth
    assert truth.stamp_ns == swing.imu.stamp_ns[-1]
    w, x, y, z = truth.q_nb_wxyz
    C_nb = Rotation.from_quat([x, y, z, w]).as_matrix()
    np.testing.assert_allclose(C_nb, truth.C_nb_at(truth.stamp_ns), atol=1e-14)
    assert w >= 0.0


def test_attitude_of_many_stamps() -> None:
    truth = run().truth
    stamps = np.array([BEGIN - 10**9, BEGIN, BEGIN + 10**10])
    many = truth.C_nb_at(stamps)
    assert many.shape == (3, 3, 3)
    for k, stamp in enumerate(stamps):
        np.testing.assert_allclose(many[:, :, k], truth.C_nb_at(int(stamp)), atol=1e-15)


def test_truth_dict_is_what_the_interface_says() -> None:
    truth = run(scenario="erect", rate_hz=100, latitude_deg=-33.0).truth
    content = json.loads(json.dumps(truth.truth_dict(), allow_nan=False))
    assert list(content) == [
        "q_nb_wxyz", "stamp_ns", "lever_arm_m", "latitude_deg", "longitude_deg", "altitude_m",
        "gyro_bias_rad_s", "accel_bias_m_s2", "odometer_scale_error", "seed", "scenario", "grade",
        "rate_hz", "sampling", "paper_axes", "drive_stamp_ns",
    ]  # fmt: skip
    assert content["stamp_ns"] == BEGIN + 20_000_000_000
    assert content["scenario"] == "erect"
    assert content["grade"] == "fog"
    assert content["latitude_deg"] == -33.0
    assert content["odometer_scale_error"] is None
    assert content["paper_axes"]["name"] == "b2"
    r_b2 = np.array(content["paper_axes"]["C_paper_b"]) @ content["lever_arm_m"]
    np.testing.assert_allclose(r_b2, [4.0, 2.0, 3.0], atol=1e-14)


def test_own_scenario_and_grade() -> None:
    truth = run(scenario=SingleAxisSwing(axis="y"), grade=ImuGrade()).truth
    assert (truth.scenario, truth.grade) == ("single_axis", "custom")


def test_lever_arm_of_ones_own() -> None:
    np.testing.assert_array_equal(run(lever_arm_m=(1, 2, 3)).truth.lever_arm_m, [1.0, 2.0, 3.0])


def test_chunks_are_the_run() -> None:
    swing = run(lost_fraction=0.2)
    pieces = list(swing.chunks(0.05))
    assert all(0 < len(piece) <= 10 for piece in pieces)
    assert_same(
        ImuSamples(*(np.concatenate(x, axis=-1) for x in zip(*pieces, strict=True))), swing.imu
    )
    with pytest.raises(ValueError, match="duration_s"):
        next(swing.chunks(0.0))


def test_sampling_takes_the_enumeration() -> None:
    assert_same(run(sampling=ImuSampling.MEAN).imu, run(sampling="mean").imu)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("scenario", "upside_down"),
        ("grade", "gold"),
        ("seed", -1),
        ("rate_hz", 0.0),
        ("rate_hz", math.inf),
        ("duration_s", -1.0),
        ("duration_s", 0.001),
        ("latitude_deg", 91.0),
        ("latitude_deg", math.nan),
        ("longitude_deg", math.inf),
        ("altitude_m", math.nan),
        ("sampling", "sometimes"),
        ("lever_arm_m", (1.0, 2.0)),
        ("lever_arm_m", (1.0, 2.0, math.nan)),
        ("heading_deg", math.nan),
        ("turn_deg", math.inf),
        ("turn_duration_s", 0.0),
        ("heave_m", math.nan),
        ("heave_period_s", 0.0),
        ("sway_period_s", -3.0),
        ("drive_m", -1.0),
        ("drive_m", 1001.0),
        ("drive_m", math.nan),
        ("drive_duration_s", 0.0),
        ("drive_duration_s", math.inf),
        ("drive_azimuth_deg", math.nan),
        ("drive_shake_m_s2", -0.1),
        ("drive_shake_m_s2", math.nan),
        ("drive_shake_m_s2", 101.0),
        ("lost_fraction", 1.0),
        ("lost_fraction", -0.1),
        ("stamp_jitter_s", 0.002),
        ("stamp_jitter_s", math.nan),
        ("start_stamp_ns", -1),
    ],
)
def test_bad_option_is_named(field: str, value: object) -> None:
    with pytest.raises(ValueError, match=field):
        run(**{field: value})


def test_unknown_scenario_lists_the_known() -> None:
    with pytest.raises(ValueError, match="pitch, erect, level, single_axis, still"):
        run(scenario="upside_down")


@pytest.mark.parametrize("start", [-1.0, 20.0])
def test_turn_outside_the_run_is_refused(start: float) -> None:
    with pytest.raises(ValueError, match="turn_start_s"):
        run(turn_deg=90.0, turn_start_s=start)


def test_unknown_axis_is_refused() -> None:
    with pytest.raises(ValueError, match="axis"):
        SingleAxisSwing(axis="w")
