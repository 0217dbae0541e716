"""Messages made alike for ROS and for bags: the classes differ, their fields do not."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from sins_align.ros.odometer import OdometerRow
from sins_align.ros.pose import Pose
from sins_align.types import Array

Types = Callable[[str], Any]
"""The class of a message type such as "std_msgs/msg/Header"; of rosbags: `store.types.get`."""

_NS = 1_000_000_000


def ros_types(name: str) -> Any:
    """The class of ROS's own for a message type."""
    package, _, short = name.partition("/msg/")
    return getattr(import_module(f"{package}.msg"), short)


def pose_message(types: Types, stamp_ns: int, frame_id: str, pose: Pose) -> Any:
    """A pose in the IMU's axes, whose frame is `frame_id`, as PoseWithCovarianceStamped."""
    return types("geometry_msgs/msg/PoseWithCovarianceStamped")(
        header=_header(types, stamp_ns, frame_id),
        pose=_pose_with_covariance(types, pose.position, pose.q, pose.covariance),
    )


def odometer_message(types: Types, message_type: str, row: OdometerRow, frame_id: str) -> Any:
    """An odometer sample as one of the message types of kind "odom".

    What an odometer does not tell is zero, with the identity for a pose. A variance that is
    not known is 0, as ROS has it.
    """
    header = _header(types, row.stamp_ns, frame_id)
    twist = types("geometry_msgs/msg/Twist")(
        linear=_vector(types, np.array([row.speed, 0.0, 0.0])),
        angular=_vector(types, np.zeros(3)),
    )
    if message_type == "geometry_msgs/msg/TwistStamped":
        return types(message_type)(header=header, twist=twist)
    covariance = np.zeros(36)
    covariance[0] = row.variance
    twist = types("geometry_msgs/msg/TwistWithCovariance")(twist=twist, covariance=covariance)
    if message_type == "geometry_msgs/msg/TwistWithCovarianceStamped":
        return types(message_type)(header=header, twist=twist)
    identity = np.array([1.0, 0.0, 0.0, 0.0])
    pose = _pose_with_covariance(types, np.zeros(3), identity, np.zeros((6, 6)))
    return types(message_type)(header=header, child_frame_id=frame_id, pose=pose, twist=twist)


def _header(types: Types, stamp_ns: int, frame_id: str) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, _NS)
    stamp = types("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)
    return types("std_msgs/msg/Header")(stamp=stamp, frame_id=frame_id)


def _vector(types: Types, values: Array) -> Any:
    x, y, z = values.tolist()
    return types("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)


def _pose_with_covariance(types: Types, position: Array, q: Array, covariance: Array) -> Any:
    """position (3,), q (4,) scalar first, covariance (6, 6)."""
    x, y, z = position.tolist()
    w, qx, qy, qz = q.tolist()
    return types("geometry_msgs/msg/PoseWithCovariance")(
        pose=types("geometry_msgs/msg/Pose")(
            position=types("geometry_msgs/msg/Point")(x=x, y=y, z=z),
            orientation=types("geometry_msgs/msg/Quaternion")(x=qx, y=qy, z=qz, w=w),
        ),
        covariance=covariance.ravel(),
    )
