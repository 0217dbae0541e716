"""Every reason that a status can give, and its remedy: one table for code and operators' page.

A `Reason` is a row; called with its figures it becomes a `Finding`, which is what aligners and
session hand on. `kind` says what it does: WAIT, the alignment cannot begin; FAULT, nothing can
be made of the data; LIMIT, a threshold is out of reach, unless the motion helps; DOUBT, the
estimate is not believed; PROGRESS, it is on its way; HINT, said while a sigma is above its
threshold; NOTE, said, and nothing else.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import NamedTuple


class Kind(enum.Enum):
    """What a reason does to the state."""

    WAIT = "waiting"
    FAULT = "failed"
    LIMIT = "out of reach"
    DOUBT = "not believed"
    PROGRESS = "on its way"
    HINT = "why it takes so long"
    NOTE = "said only"

    @property
    def forbids_claim(self) -> bool:
        """Whether aligned is not claimed while a reason of this kind stands."""
        return self in (Kind.LIMIT, Kind.DOUBT)


@dataclass(frozen=True)
class Reason:
    """A row of the table.

    key : names it in diagnostics and tests; nodes : who can give it
    says : the text, with figures to be filled in; remedy : what the operator can do
    ends : what is behind it, and when it ends
    """

    key: str
    kind: Kind
    says: str
    remedy: str
    ends: str
    nodes: str = "both"

    def __call__(self, **figures: object) -> Finding:
        """The reason with its figures."""
        return Finding(self, self.says.format(**figures), self.remedy.format(**figures))


class Finding(NamedTuple):
    """A reason, in words with figures."""

    reason: Reason
    text: str
    remedy: str


def texts(findings: tuple[Finding, ...]) -> tuple[str, str]:
    """Reason and remedy of all of them as one text each; what is said twice is said once."""
    said = dict.fromkeys(f.text for f in findings)
    helps = dict.fromkeys(f.remedy for f in findings if f.remedy)
    return "; ".join(said), "; ".join(helps)


NO_IMU = Reason(
    "no_imu",
    Kind.WAIT,
    "no IMU data",
    "check that the IMU publishes on topic imu, and its QoS",
    "No sample has come. Ends with the first one.",
)
IMU_SILENT = Reason(
    "imu_silent",
    Kind.WAIT,
    "no usable IMU data for {silent_s:.0f} s",
    "check that the IMU publishes on topic imu, and its QoS",
    "Samples came, and come no more. State and ~/aligned stay those of the last sample, for by the"
    " stamps nothing may be missing yet. Ends with the next one; after more than 0.5 s of missing"
    " samples the alignment begins anew.",
)
IMU_REFUSED = Reason(
    "imu_refused",
    Kind.WAIT,
    "{refused} of {total} IMU samples refused",
    "check the IMU's stamps, units and rate",
    "Most samples are not finite, out of range, repeated, or older than others. Ends when most"
    " can be used.",
)
NO_POSITION = Reason(
    "no_position",
    Kind.WAIT,
    "no latitude",
    "set latitude_deg, or publish a NavSatFix on topic fix",
    "Earth rate and gravity are unknown. Ends with the first valid fix.",
)
NO_ODOMETER = Reason(
    "no_odometer",
    Kind.WAIT,
    "no odometer",
    "publish topic odom, or set aiding to stationary if the vehicle stands",
    "No odometer sample covers the time of the IMU's. Ends with the first that does.",
    "odo",
)
ODOMETER_TYPE = Reason(
    "odometer_type",
    Kind.WAIT,
    "topic odom carries {other}, and odom_type is {wanted}",
    "set odom_type to the type that is published, and restart the node",
    "ROS delivers nothing where the types differ.",
    "odo",
)
LEVELLING = Reason(
    "levelling",
    Kind.WAIT,
    "the levels are not known yet ({elapsed_s:.0f} s)",
    "",
    "Gravity is being measured. Ends after some seconds.",
)
BEGAN_ANEW = Reason(
    "began_anew",
    Kind.NOTE,
    "began anew: {cause}",
    "",
    "Said until there is an estimate again: on request, after a gap of more than 0.5 s, when"
    " stamps jumped back (a bag that loops), or after the vehicle has moved.",
)
VEHICLE_MOVES = Reason(
    "vehicle_moves",
    Kind.WAIT,
    "the vehicle moves: the swing centre has left its place by {moved_m:.1f} m",
    "stop the vehicle: the alignment begins anew by itself once it is still for {still_s:.0f} s",
    "The data are not used, and nothing is given out. Ends when the centre is still again.",
    "swing",
)

SLOW_IMU = Reason(
    "slow_imu",
    Kind.FAULT,
    "the IMU gives {rate_hz:.1f} samples a second, 10 are the least",
    "check the IMU's stamps, units and rate",
    "Ends by itself with the first second of usable data.",
)
FORCE_IN_G = Reason(
    "force_in_g",
    Kind.FAULT,
    "a specific force of {force:.3g} is that of gravity in g, not in m/s^2",
    "have the driver give linear_acceleration in m/s^2: multiply by 9.80665",
    "Ends by itself with the first second of usable data.",
)
GRAVITY_REMOVED = Reason(
    "gravity_removed",
    Kind.FAULT,
    "a specific force of {force:.3g} m/s^2: gravity has been removed",
    "have the driver give specific force, gravity included, not linear acceleration",
    "Ends by itself with the first second of usable data.",
)
FORCE_SIZE = Reason(
    "force_size",
    Kind.FAULT,
    "a specific force of {force:.3g} m/s^2 is not that of a base at rest",
    "the IMU has to give specific force in m/s^2, gravity included: check its units and scale",
    "Gravity may lie on any axis, but it has to have its size. Ends by itself with the first"
    " second of usable data.",
)
GYRO_IN_DEGREES = Reason(
    "gyro_in_degrees",
    Kind.FAULT,
    "by the gyros gravity has turned by {angle_deg:.0f} deg in {span_s:.0f} s, read as degrees a"
    " second by {scaled_deg:.1f} deg: they give degrees, not radians",
    "have the driver give angular_velocity in rad/s: multiply by 0.0174533",
    "Looked for 30 and 60 s after a start, of a vehicle that may drive only while it stands, and"
    " every 30 s until it has gone; the alignment then begins anew by itself.",
)
ESTIMATE_BROKE = Reason(
    "estimate_broke",
    Kind.FAULT,
    "the estimate broke down: {cause}",
    "check latitude_deg, imu_grade and the IMU's units",
    "The alignment begins anew by itself.",
)
LATITUDE_WRONG = Reason(
    "latitude_wrong",
    Kind.FAULT,
    "the latitude is {given_deg:.3f} deg, and by the IMU it is {found_deg:.3f} deg"
    " (sigma {sigma_deg:.3f})",
    "check latitude_deg or the fix; if they are right, a gyro's bias is far beyond imu_grade, or"
    " the base turns slowly about up",
    "With latitude_check: fail. Ends when the two agree, after a restart with the right one.",
)

AXES_DIFFER = Reason(
    "axes_differ",
    Kind.HINT,
    "the base tilts by {tilt_deg:.1f} deg, and the gyros, instead of explaining it, make it"
    " {left_deg:.1f} deg: gyros and accelerometers may have different axes",
    "check axes and signs of angular_velocity and linear_acceleration: both x forward, y left,"
    " z up, or both turned alike",
    "Looked for 30 and 60 s after a start, of a base that does not drive. Said until sigma is below"
    " the thresholds: on a long lever arm and a fast swing it may be wrong.",
)
AT_POLE = Reason(
    "at_pole",
    Kind.LIMIT,
    "there is no heading at the pole",
    "check latitude_deg or the fix",
    "The Earth's rate has no horizontal part. Said as long as the position is such.",
)
UNOBSERVABLE_HERE = Reason(
    "unobservable_here",
    Kind.LIMIT,
    "heading is unobservable so near to a pole: the declared gyro bias allows {limit_deg:.1f} deg",
    "check latitude_deg or the fix; if they are right, take heading from elsewhere, as from two"
    " GNSS antennas",
    "Within 1.1 deg of a pole. Ends with a start farther from it.",
    "odo",
)
AZIMUTH_LOST = Reason(
    "azimuth_lost",
    Kind.DOUBT,
    "the azimuth was lost (samples missing, or an odometer that misleads): beginning anew",
    "check the odometer, imu_grade, imu_sampling and aiding",
    "Ends when the azimuth is known again.",
    "odo",
)
HEADING_COARSE = Reason(
    "heading_coarse",
    Kind.PROGRESS,
    "heading is not known yet: {sigma}",
    "",
    "Heading comes with time. Nothing is given out before its sigma is below 3 deg (odo) or 20 deg"
    " (swing), nor while another heading, far off, fits the data too (swing).",
)
HEADING_UNOBSERVABLE = Reason(
    "heading_unobservable",
    Kind.LIMIT,
    "heading cannot be told by a gyro of this bias on a vehicle that does not turn: the limit is"
    " {limit} at this latitude",
    "{motion}",
    "The bias of the east gyro and an error of heading are one and the same until the IMU is"
    " turned. Ends when sigma is below the threshold.",
)
HEADING_SIGMA = Reason(
    "heading_sigma",
    Kind.PROGRESS,
    "heading sigma {sigma:.2f}' not below {threshold:g}'",
    "",
    "Ends with time; eta_s says when, unless a doubt stands.",
)
LEVEL_SIGMA = Reason(
    "level_sigma",
    Kind.PROGRESS,
    'level sigma {sigma:.1f}" not below {threshold:g}"',
    "",
    "Ends with time.",
)
HOLDING = Reason(
    "holding",
    Kind.PROGRESS,
    "below the thresholds for {held_s:.0f} of {hold_s:g} s",
    "",
    "Ends after hold_s.",
)
HEADING_LIMIT = Reason(
    "heading_limit",
    Kind.LIMIT,
    "{threshold:g}' cannot be reached with a gyro bias of {bias_deg_h:g} deg/h at this latitude"
    " on a base that does not turn: the limit is {limit:.1f}'",
    "raise heading_threshold_arcmin, {motion}, or use a better gyro",
    "A threshold below the physical limit of a base that does not turn. Ends when sigma is below"
    " it all the same, or with another threshold.",
)
LEVEL_LIMIT = Reason(
    "level_limit",
    Kind.LIMIT,
    '{threshold:g}" cannot be reached: the declared accelerometer bias allows {limit:.1f}" on a'
    " base that does not tilt",
    "raise level_threshold_arcsec, or use better accelerometers",
    "A threshold below the physical limit. Ends when sigma is below it all the same, or with"
    " another threshold.",
)
SWING_WEAK = Reason(
    "swing_weak",
    Kind.HINT,
    "the swing is too small yet to tell the lever arm: sigma {sigma_m:.2g} m",
    "wait, or swing the base by a degree or more; or give the lever arm: lever_arm_prior_m with"
    " lever_arm_prior_sigma_m",
    "After half a minute it is estimated all the same; its share is in the sigma of the attitude,"
    " for a centre at rest. Ends at 5 cm, or when nothing else is missing.",
    "swing",
)
CENTRE_MOVES = Reason(
    "centre_moves",
    Kind.HINT,
    "the swing centre is not at rest: it moves by {moved_mm:.1f} mm where {declared_mm:.2g} mm is"
    " declared",
    "keep the vehicle in place and people off it, or raise position_noise_m",
    "The position noise has grown with the innovations, and sigma with it. Ends when sigma is"
    " below its threshold.",
    "swing",
)
INCONSISTENT = Reason(
    "inconsistent",
    Kind.DOUBT,
    "the innovations are {ratio:.1f} times what they should be",
    "keep to what the settings say: check imu_grade, imu_sampling, the latitude and the odometer",
    "The mean normalised innovation squared is beyond its bound. Ends when it is inside.",
)
UNPROVEN = Reason(
    "unproven",
    Kind.PROGRESS,
    "there are too few solutions yet to see whether heading stays",
    "",
    "Ends within a minute: a claim needs four earlier headings from which this one differs"
    " by no more than it should.",
    "swing",
)
UNSTEADY = Reason(
    "unsteady",
    Kind.DOUBT,
    "heading has changed by {ratio:.1f} times the sigma of what new data may change:"
    " gyro noise above the declared grade, or a base that creeps",
    "check imu_grade (gyro_arw_deg_sqrt_h) and imu_sampling; keep the vehicle on firm ground",
    "Ends when heading is where it was before, as far as its sigma tells; at the earliest when four"
    " times as much time has passed, where it does not come back; or after a restart.",
    "swing",
)
GYRO_NOISY = Reason(
    "gyro_noisy",
    Kind.DOUBT,
    "the gyros are noisier than declared: {factor:g} times the declared noise explains the data"
    " better, by a factor of e^{log_ratio:.0f}",
    "declare the noise they have (imu_grade, gyro_arw_deg_sqrt_h); see that nothing shakes the IMU,"
    " and that the vehicle stands on firm ground",
    "A slow sway of a swing's centre looks alike. Ends when the declared noise explains the data"
    " again, or after a restart.",
)
STAMP_JITTER = Reason(
    "stamp_jitter",
    Kind.DOUBT,
    "the stamps jitter by {jitter_ms:.2f} ms, which on this motion is {ratio:.1f} times the noise"
    " of the gyros",
    "stamp the samples when they are taken, not when they arrive; or declare the noise that this"
    " makes (gyro_arw_deg_sqrt_h)",
    "The values are smoother by their number than by their stamps. Ends when the stamps are right,"
    " or the base moves less, the later the worse it was: it is a mean over half a minute.",
)
WITNESS_DIFFERS = Reason(
    "witness_differs",
    Kind.DOUBT,
    "{name} beside it differs by {heading:.1f}' in heading, in all by {ratio:.1f} of the sigma of"
    " both",
    "check imu_grade, imu_sampling, the latitude and the odometer; restart if it stays",
    "Another estimate from the same data. Ends when the two agree.",
)
BIAS_BEYOND = Reason(
    "bias_beyond",
    Kind.DOUBT,
    "the estimated {what} is {ratio:.1f} times what is declared",
    "check imu_grade, the IMU's units, the latitude, and that the settings say what the vehicle"
    " does",
    "A bias so far beyond the declared one is no bias. Ends when the estimate is inside again.",
)
LATITUDE_DIFFERS = Reason(
    "latitude_differs",
    Kind.NOTE,
    "the latitude is {given_deg:.3f} deg, and by the IMU it is {found_deg:.3f} deg"
    " (sigma {sigma_deg:.3f})",
    "check latitude_deg or the fix; if they are right, a gyro's bias is far beyond imu_grade, or"
    " the base turns slowly about up",
    "With latitude_check: warn; what it may do to the attitude is in its covariance."
    " Ends when the two agree.",
)
ODOMETER_SILENT = Reason(
    "odometer_silent",
    Kind.DOUBT,
    "no odometer for {silent_s:.0f} s, and the vehicle is not known to stand",
    "publish topic odom again, or stop the vehicle before it falls silent",
    "Errors grow, and nothing is measured. Ends with the next sample.",
    "odo",
)
LATITUDE_UNPROVEN = Reason(
    "latitude_unproven",
    Kind.PROGRESS,
    "by the IMU the latitude is known to {sigma_deg:.2f} deg yet, {most_deg:.2f} deg are needed to"
    " see whether it was given right",
    "",
    "With gyros of navigation grade, 0.01 deg/h or better, and noise to match. Ends within two"
    " minutes or so, near the equator on a large swing within 200 s; or with latitude_check: off.",
    "swing",
)
LATITUDE_DOUBTED = Reason(
    "latitude_doubted",
    Kind.DOUBT,
    "by the IMU the latitude is off by {ratio:.1f} times sigma ({sigma_deg:.3f} deg)",
    "check latitude_deg or the fix",
    "3 sigma, with gyros of navigation grade or latitude_check: fail; 5 while there is no heading"
    " (odo). Ends when more data have told which of the two it is.",
)
ODOMETER_OPPOSITE = Reason(
    "odometer_opposite",
    Kind.DOUBT,
    "the odometer runs opposite to the motion: its speed changes by {slope:.2f} of what the"
    " accelerometers say",
    "turn the sign of the speed on topic odom, or correct mounting_rpy_deg if the IMU looks back",
    "Looked for over the last 30 s with changes of velocity. Ends by itself when the two agree:"
    " the alignment begins anew.",
    "odo",
)
ODOMETER_SCALE = Reason(
    "odometer_scale",
    Kind.DOUBT,
    "the odometer's speed changes by {slope:.2f} of what the accelerometers say",
    "have the odometer give m/s (km/h is 3.6 times as much, mph 2.24), or declare"
    " odometer_scale_sigma honestly",
    "Looked for over the last 30 s with changes of velocity. Ends by itself when the two agree:"
    " the alignment begins anew.",
    "odo",
)
STORED_CHECK = Reason(
    "stored_check",
    Kind.PROGRESS,
    "checking the stored alignment ({elapsed_s:.0f} of {check_s:.0f} s)",
    "keep the base still",
    "Gravity and the Earth's rate are compared with `initial_result_file`.",
)
STORED_CONFIRM = Reason(
    "stored_confirm",
    Kind.PROGRESS,
    "checking the stored alignment: the base sways, and the new heading is not known to"
    " {sigma_deg:.1f} deg yet",
    "keep the base still",
    "A sway hides the Earth's rate; the new alignment has to agree first.",
)
STORED_DROPPED = Reason(
    "stored_dropped",
    Kind.NOTE,
    "the stored alignment is dropped: {why}",
    "clear initial_result_file once the base has been moved",
    "It does not fit, the base moves, or the alignment began anew, after which it is said until"
    " there is an estimate. The alignment goes on as if nothing had been stored.",
)

REASONS: tuple[Reason, ...] = tuple(v for v in list(globals().values()) if isinstance(v, Reason))
