"""ROS messages from estimates and positions."""

from __future__ import annotations

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion
from sensor_msgs.msg import Imu, NavSatFix, NavSatStatus
from std_msgs.msg import Header

from sins_align.types import Array, Estimate, Position
from sins_align.units import DEG

_NS = 1_000_000_000


def time_message(stamp_ns: int) -> Time:
    """A time [ns]."""
    return Time(sec=stamp_ns // _NS, nanosec=stamp_ns % _NS)


def header_message(stamp_ns: int, frame_id: str) -> Header:
    """Header of a time [ns] and a frame."""
    return Header(stamp=time_message(stamp_ns), frame_id=frame_id)


def attitude_message(estimate: Estimate, w_ib_b: Array, f_ib_b: Array, frame_id: str) -> Imu:
    """Attitude, with the rate and the specific force freed from their estimated biases.

    Parameters
    ----------
    estimate : at the time of the sample
    w_ib_b, f_ib_b : (3,) the sample [rad/s], [m/s^2]
    frame_id : of the IMU

    Returns
    -------
    Orientation is body to ENU, its covariance that of the misalignment [rad^2]. The other
    two covariances are those of the biases.
    """
    message = Imu(header=header_message(estimate.stamp_ns, frame_id))
    message.orientation = _quaternion(estimate.q_nb)
    message.orientation_covariance = estimate.misalignment_covariance.ravel()
    _set_vector(message.angular_velocity, w_ib_b - estimate.gyro_bias)
    _set_vector(message.linear_acceleration, f_ib_b - estimate.accel_bias)
    message.angular_velocity_covariance = np.diag(estimate.gyro_bias_sigma**2).ravel()
    message.linear_acceleration_covariance = np.diag(estimate.accel_bias_sigma**2).ravel()
    return message


def misalignment_message(estimate: Estimate, nav_frame: str) -> PoseWithCovarianceStamped:
    """Orientation body to ENU, and the misalignment covariance in the rotation block."""
    message = PoseWithCovarianceStamped(header=header_message(estimate.stamp_ns, nav_frame))
    message.pose.pose.orientation = _quaternion(estimate.q_nb)
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = estimate.misalignment_covariance
    message.pose.covariance = covariance.ravel()
    return message


def fix_message(stamp_ns: int, position: Position, frame_id: str) -> NavSatFix:
    """A fix at a position."""
    return NavSatFix(
        header=header_message(stamp_ns, frame_id),
        status=NavSatStatus(status=NavSatStatus.STATUS_FIX, service=NavSatStatus.SERVICE_GPS),
        latitude=position.latitude / DEG,
        longitude=position.longitude / DEG,
        altitude=position.altitude,
    )


def _quaternion(q_nb: Array) -> Quaternion:
    w, x, y, z = q_nb.tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def _set_vector(vector: object, values: Array) -> None:
    vector.x, vector.y, vector.z = values.tolist()  # type: ignore[attr-defined]
