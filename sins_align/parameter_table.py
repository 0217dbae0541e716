"""The parameters: one table for YAML, the command line, the node and the README.

Values here keep the unit that their name carries; `sins_align.config` converts them.
"""

from __future__ import annotations

from functools import partial

from sins_align.grades import GRADE_KEYS, grade_names
from sins_align.parameter import NAN, Parameter

_swing = partial(Parameter, nodes=("swing_align",))
_odo = partial(Parameter, nodes=("odo_align",))


def _grade_override(name: str, what: str) -> Parameter:
    return Parameter(name, NAN, f"{what}; NaN: as the grade says", low=0.0, high=1e9)


COMMON_PARAMETERS: tuple[Parameter, ...] = (
    Parameter(
        "latitude_deg",
        NAN,
        "geodetic latitude, north positive; NaN: from topic fix",
        low=-90.0,
        high=90.0,
    ),
    Parameter(
        "longitude_deg",
        NAN,
        "longitude, east positive; NaN: from topic fix, else 0",
        low=-180.0,
        high=360.0,
    ),
    Parameter(
        "altitude_m",
        NAN,
        "height above the ellipsoid; NaN: from topic fix, else 0",
        low=-1000.0,
        high=20000.0,
    ),
    Parameter("imu_grade", "rlg", "noise grade, a name in imu_grades.yaml", choices=grade_names()),
    _grade_override("gyro_bias_deg_h", "gyro bias, 1 sigma"),
    _grade_override("gyro_arw_deg_sqrt_h", "angle random walk"),
    _grade_override("gyro_bias_instability_deg_h", "gyro bias instability over 300 s, 1 sigma"),
    _grade_override("accel_bias_ug", "accelerometer bias, 1 sigma"),
    _grade_override("accel_vrw_ug_sqrt_hz", "velocity random walk"),
    Parameter(
        "imu_sampling",
        "instantaneous",
        "what a sample stands for: the mean over the interval that ends at its stamp, or the"
        " instantaneous value",
        choices=("mean", "instantaneous"),
    ),
    Parameter(
        "heading_threshold_arcmin",
        6.0,
        "aligned when sigma of heading is below",
        low=1e-6,
        high=10800.0,
        runtime=True,
    ),
    Parameter(
        "level_threshold_arcsec",
        30.0,
        "aligned when sigma of both levels is below",
        low=1e-6,
        high=324000.0,
        runtime=True,
    ),
    Parameter("hold_s", 10.0, "and has been for so long", low=0.0, high=3600.0, runtime=True),
    Parameter(
        "latitude_check",
        "warn",
        "where the latitude is not that of the data: warn, fail, or off (not looked at)",
        choices=("warn", "fail", "off"),
        runtime=True,
    ),
    Parameter(
        "publish_rate_hz",
        50.0,
        "rate of the attitude output",
        low=0.1,
        high=1000.0,
        runtime=True,
    ),
    Parameter("nav_frame", "map", "frame_id of the ENU frame", runtime=True),
    Parameter("result_file", "", "result.json is written here; empty: nowhere", runtime=True),
    Parameter(
        "initial_result_file",
        "",
        "a result.json to go on from, if the vehicle has not moved since; empty: none",
    ),
    Parameter("executor", "single", "rclpy executor of the node", choices=("single", "events")),
)

SWING_PARAMETERS: tuple[Parameter, ...] = (
    _swing("method", "inertial", "estimation method", choices=("inertial", "paper")),
    _swing(
        "passes",
        3,
        "at most so many backtracking passes over the stored increments",
        low=1,
        high=10,
    ),
    _swing(
        "lever_arm_prior_m",
        [0.0, 0.0, 0.0],
        "prior of the lever arm, swing centre to IMU, FLU",
        low=-1000.0,
        high=1000.0,
        length=3,
    ),
    _swing(
        "lever_arm_prior_sigma_m",
        10.0,
        "its 1 sigma per axis; 0: the prior is exact",
        low=0.0,
        high=1000.0,
    ),
    _swing(
        "position_noise_m",
        0.0005,
        "floor of the swing centre's position noise at each filter step, 1 sigma; it grows"
        " with the innovations",
        low=0.0,
        high=100.0,
    ),
    _swing(
        "position_walk_m_sqrt_s",
        NAN,
        "random walk of the swing centre; NaN: 0.4 position_noise_m per sqrt(s)",
        low=0.0,
        high=100.0,
    ),
    _swing(
        "differentiator",
        "eso",
        "paper: source of the angular acceleration",
        choices=("eso", "central"),
    ),
    _swing(
        "regression",
        "epls",
        "paper: lever arm by least squares with (epls) or without (ls) the misalignment columns",
        choices=("ls", "epls"),
    ),
    _swing(
        "eso_bandwidth_rad_s",
        NAN,
        "paper: bandwidth of the observer; NaN: 1 / sampling interval, as printed at 1 kHz",
        low=1e-3,
        high=1e5,
    ),
    _swing(
        "switch_times_s",
        [15.0, 30.0, 70.0],
        "paper: times of the filter's closed-loop switches, counted from the level phase's end",
        low=0.0,
        high=1e5,
    ),
    _swing("level_phase_s", 120.0, "paper: duration of the level phase", low=1.0, high=1e5),
    _swing(
        "initial_rpy_deg",
        [0.0, 0.0, 0.0],
        "paper: attitude it starts from: roll, pitch, yaw of FLU in ENU (REP-103)",
        low=-360.0,
        high=360.0,
        length=3,
    ),
)

LARGE_AZIMUTH_METHODS = ("sghf", "ghf", "ckf", "ekf", "ukf")
WANDER_METHODS = ("wander_kf", "wander_ekf")

ODO_PARAMETERS: tuple[Parameter, ...] = (
    _odo("method", "sghf", "estimation method", choices=(*LARGE_AZIMUTH_METHODS, *WANDER_METHODS)),
    _odo(
        "coarse",
        "wander",
        "what sghf, ghf, ckf, ekf, ukf start from: wander, wander_kf, which then goes on as a"
        " witness; inertial, the coarse alignment alone",
        choices=("wander", "inertial"),
    ),
    _odo(
        "fading",
        "guarded",
        "strong tracking of sghf: guarded, where the mismatch is; published, as in the paper; none",
        choices=("guarded", "published", "none"),
    ),
    _odo(
        "gauss_hermite_nodes",
        3,
        "nodes over the azimuth of sghf and ghf; 3 are as good as the paper's 7",
        low=2,
        high=31,
    ),
    _odo(
        "passes",
        1,
        "backtracking passes; there is only one over a moving vehicle's data",
        low=1,
        high=1,
    ),
    _odo(
        "aiding",
        "odometer",
        "odometer, or stationary: the vehicle stands, no odometer is needed",
        choices=("odometer", "stationary"),
    ),
    _odo(
        "odom_type",
        "TwistStamped",
        "message type of topic odom",
        choices=("TwistStamped", "TwistWithCovarianceStamped", "Odometry"),
    ),
    _odo(
        "odom_timeout_s",
        2.0,
        "the IMU waits for the odometer so long, and no longer",
        low=0.0,
        high=60.0,
    ),
    _odo(
        "odometer_latency_s",
        0.0,
        "by how much the odometer's stamps are late, as far as known; the rest is estimated",
        low=-10.0,
        high=10.0,
    ),
    _odo("odometer_latency_sigma_s", 0.15, "its 1 sigma; 0: exact", low=0.0, high=2.0),
    _odo(
        "odometer_latency_walk_s_sqrt_s",
        0.0003,
        "random walk of the latency, for a clock that drifts",
        low=0.0,
        high=1.0,
    ),
    _odo(
        "odometer_lever_arm_m",
        [0.0, 0.0, 0.0],
        "from the IMU to the odometer's reference point, FLU, as far as known",
        low=-100.0,
        high=100.0,
        length=3,
    ),
    _odo(
        "odometer_lever_arm_sigma_m",
        [1.5, 0.5, 0.5],
        "its 1 sigma per axis; 0: exact",
        low=0.0,
        high=100.0,
        length=3,
    ),
    _odo("odometer_scale_sigma", 0.02, "scale error, 1 sigma", low=0.0, high=0.2),
    _odo(
        "odometer_scale_walk_sqrt_s",
        1e-5,
        "random walk of the scale error",
        low=0.0,
        high=0.01,
    ),
    _odo(
        "odometer_quantum_m",
        NAN,
        "distance of one count; NaN: found from the data",
        low=0.0,
        high=10.0,
    ),
    _odo(
        "odometer_noise_m",
        [0.001, 0.00075, 0.00075],
        "noise of the displacement in a second, forward, lateral, up, 1 sigma: a floor",
        low=1e-5,
        high=100.0,
        length=3,
    ),
    _odo(
        "odometer_noise_per_m",
        [0.00015, 0.00025, 0.00035],
        "what it grows by with the distance travelled in the second",
        low=0.0,
        high=1.0,
        length=3,
    ),
    _odo(
        "odometer_direction_sigma_deg",
        0.1,
        "slow part of the direction of travel against the vehicle's axis, lateral and up, 1 sigma",
        low=0.0,
        high=10.0,
    ),
    _odo(
        "mounting_rpy_deg",
        [0.0, 0.0, 0.0],
        "rotation of the vehicle's axes in the IMU's: roll, pitch, yaw (REP-103)",
        low=-360.0,
        high=360.0,
        length=3,
    ),
    _odo("mounting_sigma_deg", 1.0, "its pitch and yaw, 1 sigma", low=0.0, high=10.0),
)

PARAMETERS = COMMON_PARAMETERS + SWING_PARAMETERS + ODO_PARAMETERS
GRADE_OVERRIDES = tuple(p.name for p in COMMON_PARAMETERS if p.name in GRADE_KEYS)
