"""Lever arms and mounting as poses: what a node publishes latched."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sins_align.rotation import dcm_from_rpy, quaternion_from_dcm
from sins_align.types import Array, Estimate, LeverArm, OdometerEstimate

_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


class Pose(NamedTuple):
    """A frame in the IMU's.

    position : (3,) [m]
    q : (4,) orientation, Hamilton, scalar first
    covariance : (6, 6) of the position and of small rotations about the IMU's axes
        [m^2], [rad^2]
    """

    position: Array
    q: Array
    covariance: Array


def lever_arm_pose(lever_arm: LeverArm) -> Pose:
    """Swing centre to IMU in the IMU's axes; the orientation says nothing."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = lever_arm.covariance
    return Pose(lever_arm.r_b, _IDENTITY, covariance)


def mounting_pose(odometer: OdometerEstimate) -> Pose:
    """The vehicle's axes at the odometer's reference point."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = odometer.lever_arm_covariance
    covariance[3:, 3:] = odometer.mounting_covariance
    roll, pitch, yaw = odometer.mounting_rpy.tolist()
    q = quaternion_from_dcm(dcm_from_rpy(roll, pitch, yaw))
    return Pose(odometer.lever_arm_b, q, covariance)


def latched_poses(estimate: Estimate) -> dict[str, Pose]:
    """The poses that a node publishes with this estimate, by the name of their topic."""
    poses = {}
    if estimate.lever_arm is not None:
        poses["lever_arm"] = lever_arm_pose(estimate.lever_arm)
    if estimate.odometer is not None:
        poses["mounting"] = mounting_pose(estimate.odometer)
    return poses
