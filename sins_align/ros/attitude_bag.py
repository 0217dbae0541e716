"""aligned.mcap: attitude and lever arm or mounting of a replay, as the live node publishes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sins_align.ros.bags_write import BagWriter
from sins_align.ros.portable_messages import Types, pose_message
from sins_align.ros.pose import latched_poses
from sins_align.ros.replay import AttitudeRecord, Replay
from sins_align.types import Array, ImuSamples


def write_attitude_bag(path: Path, replay: Replay, node: str, frame_id: str) -> None:
    """Write /NODE/attitude and /NODE/lever_arm or /NODE/mounting to a bare MCAP file.

    An older one is replaced.

    Raises
    ------
    BagError : the file cannot be written
    OSError : nor renamed
    """
    temporary = path.with_name(f".{path.name}.new.mcap")
    temporary.unlink(missing_ok=True)
    with BagWriter(temporary) as bag:
        if replay.records:
            samples, orientation, covariance = _columns(replay.records)
            bag.write_imu(
                samples, topic=f"/{node}/attitude", frame_id=frame_id,
                orientation=orientation, orientation_covariance=covariance,
            )  # fmt: skip
        types = _types()
        for update in replay.updates:
            estimate = update.estimate
            if estimate is None:
                continue
            for name, pose in latched_poses(estimate).items():
                message = pose_message(types, estimate.stamp_ns, frame_id, pose)
                bag.write(f"/{node}/{name}", estimate.stamp_ns, message)
    temporary.replace(path)


def _columns(records: list[AttitudeRecord]) -> tuple[ImuSamples, Array, Array]:
    """Bias-free samples, orientation (4, N) and its covariance (9, N)."""
    estimates = [record.estimate for record in records]
    stamp_ns = np.array([estimate.stamp_ns for estimate in estimates], dtype=np.int64)
    w_ib_b = np.stack([r.w_ib_b - r.estimate.gyro_bias for r in records], axis=1)
    f_ib_b = np.stack([r.f_ib_b - r.estimate.accel_bias for r in records], axis=1)
    covariances = [estimate.misalignment_covariance.ravel() for estimate in estimates]
    return (
        ImuSamples(stamp_ns, w_ib_b, f_ib_b),
        np.stack([estimate.q_nb for estimate in estimates], axis=1),
        np.stack(covariances, axis=1),
    )


def _types() -> Types:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY).types.__getitem__
