"""aligned.mcap: the attitude and the lever arm of a replay, as the live node publishes them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sins_align.ros.bags_write import BagWriter
from sins_align.ros.replay import AttitudeRecord, Replay
from sins_align.types import Array, ImuSamples, LeverArm

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_NS = 1_000_000_000


def write_attitude_bag(path: Path, replay: Replay, node: str, frame_id: str) -> None:
    """Write /NODE/attitude and /NODE/lever_arm to a bare MCAP file, in place of an older one.

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
            if estimate is not None and estimate.lever_arm is not None:
                message = _lever_arm(types, estimate.stamp_ns, estimate.lever_arm, frame_id)
                bag.write(f"/{node}/lever_arm", estimate.stamp_ns, message)
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


def _types() -> dict[str, Any]:
    from rosbags.typesys import Stores, get_typestore

    store: Typestore = get_typestore(Stores.ROS2_JAZZY)
    return dict(store.types)


def _lever_arm(types: dict[str, Any], stamp_ns: int, lever_arm: LeverArm, frame_id: str) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, _NS)
    x, y, z = lever_arm.r_b.tolist()
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = lever_arm.covariance
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types["geometry_msgs/msg/PoseWithCovarianceStamped"](
        header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id),
        pose=types["geometry_msgs/msg/PoseWithCovariance"](
            pose=types["geometry_msgs/msg/Pose"](
                position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z),
                orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            ),
            covariance=covariance.ravel(),
        ),
    )
