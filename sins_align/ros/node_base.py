"""What the alignment nodes share: parameters, topics, services, diagnostics, result file."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from sins_align.config import completion_of
from sins_align.reasons import IMU_SILENT, NO_IMU, Finding
from sins_align.ros import messages
from sins_align.ros.command import error_text
from sins_align.ros.diagnostics import diagnostic_status, key_values
from sins_align.ros.eta import EtaClock
from sins_align.ros.fix import position_from_fix
from sins_align.ros.imu_inbox import ImuInbox, SilenceWatch
from sins_align.ros.parameter_node import ParameterNode
from sins_align.ros.portable_messages import pose_message, ros_types
from sins_align.ros.pose import latched_poses
from sins_align.ros.publish_grid import PublishGrid, find_sample
from sins_align.ros.result_file import ResultFile
from sins_align.ros.status_log import StatusLog
from sins_align.session import Session
from sins_align.types import Estimate, ImuSamples, State, Status, Update

RCLError = rclpy_implementation.RCLError

IMU_QOS = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
FIX_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
# An attitude every 20 ms, and nobody who misses half a second of them.
OUTPUT_QOS = QoSProfile(depth=25)

FLUSH_S = 0.1  # no sample waits longer for the next one


class AlignNode(ParameterNode):
    """A node around a `Session`.

    The payloads of `imu` are kept as they come and decoded many at a time, when an output
    is due on the grid of stamps or, when the stream pauses, by a timer. The session's
    numbers do not depend on how many samples it gets in one call.

    Parameters
    ----------
    node_name : its parameters are those of the table for this name
    make_session : from the parameter values
    pose_topic : what is published latched beside the attitude, a name of `latched_poses`

    Raises
    ------
    ConfigError : a parameter that cannot be used; names the key
    OSError : the result file could not be written; names it
    """

    def __init__(
        self,
        node_name: str,
        make_session: Callable[[dict[str, Any]], Session],
        pose_topic: str,
    ) -> None:
        super().__init__(node_name)
        self._pose_topic = pose_topic
        self.executor_kind: str = self.values["executor"]
        self.session = make_session(self.values)
        self._result = ResultFile(
            node_name, self.values["result_file"], self.values["initial_result_file"]
        )
        self._grid = PublishGrid(self.values["publish_rate_hz"])
        self._inbox = ImuInbox()
        self._frames_warned = False
        self._silence = SilenceWatch()
        self._eta = EtaClock()
        self._log = StatusLog(self.get_logger, self.session)
        self._aligned = False
        self._create_outputs()
        self._create_inputs()

    def create_output(self, message_type: type, topic: str, qos: QoSProfile) -> Publisher:
        """A publisher without rclpy's own event handlers.

        Each of them would be looked at for every sample that comes in.
        """
        return self.create_publisher(
            message_type,
            topic,
            qos,
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
        )

    def create_input(
        self,
        message_type: type,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile,
        *,
        raw: bool = False,
    ) -> Subscription:
        """A subscription whose QoS parameters can override."""
        options = QoSOverridingOptions.with_default_policies()
        return self.create_subscription(
            message_type, topic, callback, qos, raw=raw, qos_overriding_options=options
        )

    def _create_outputs(self) -> None:
        self._attitude = self.create_output(Imu, "~/attitude", OUTPUT_QOS)
        self._misalignment = self.create_output(
            PoseWithCovarianceStamped, "~/misalignment", OUTPUT_QOS
        )
        self._pose = self.create_output(
            PoseWithCovarianceStamped, f"~/{self._pose_topic}", LATCHED_QOS
        )
        self._aligned_publisher = self.create_output(Bool, "~/aligned", LATCHED_QOS)
        self._diagnostics = self.create_output(DiagnosticArray, "/diagnostics", OUTPUT_QOS)
        self._processed = self.create_output(Time, "~/processed", LATCHED_QOS)
        self._aligned_publisher.publish(Bool(data=False))

    def _create_inputs(self) -> None:
        self.create_input(Imu, "imu", self._on_imu, IMU_QOS, raw=True)
        self.create_input(NavSatFix, "fix", self._on_fix, FIX_QOS)
        self.create_service(Trigger, "~/restart", self._on_restart)
        self.create_service(Trigger, "~/save", self._on_save)
        wall = Clock(clock_type=ClockType.STEADY_TIME)  # also when the time of the data stands
        self.create_timer(FLUSH_S, self._flush, clock=wall)
        self.create_timer(1.0, self._publish_diagnostics, clock=wall)

    def send(self, publisher: Publisher, message: Any) -> None:
        """Publish, unless ROS has gone down meanwhile: data still here must be taken in."""
        try:
            publisher.publish(message)
        except RCLError:
            if self.context.ok():
                raise

    def use_changed(self, changed: dict[str, Any]) -> None:
        """Nothing is lost: what has come goes on to count."""
        self._flush()
        self.session.set_completion(completion_of(self.values), self.values["latitude_check"])
        if "publish_rate_hz" in changed:
            self._grid = PublishGrid(changed["publish_rate_hz"])
        if "result_file" in changed:
            self._result.set_path(changed["result_file"])
            if self._aligned:
                self._save()

    def take_in_aiding(self) -> list[Update]:
        """Hand over what has come beside the IMU. Nothing here; for a node's own inputs."""
        return []

    def input_findings(self) -> list[Finding]:
        """What is wrong with an input of the node's own. Nothing here."""
        return []

    def diagnostic_texts(self, estimate: Estimate | None) -> dict[str, str]:
        """Keys of the diagnostics that only this node has. None here."""
        return {}

    def _on_imu(self, payload: bytes) -> None:
        stamp_ns = self._inbox.put(payload)
        if self._grid.reached(stamp_ns):
            samples = self._flush()
            if samples is not None:
                self._publish_attitude(samples, stamp_ns)

    def _flush(self) -> ImuSamples | None:
        """Hand what has come to the session; the IMU samples of it, None where there are none."""
        samples = self._inbox.take()
        self._look_at_frames()
        begin = time.perf_counter()
        updates = self.take_in_aiding()
        if samples is not None:
            updates += self.session.add_imu(samples)
        self._result.estimate_s += time.perf_counter() - begin
        for update in updates:
            if update.estimate is not None:
                self._publish_pose(update.estimate)
            self._announce(update.status)
        self._announce(self.session.status)  # a restart is no update
        if samples is not None:
            self.send(self._processed, messages.time_message(int(samples.stamp_ns[-1])))
        return samples

    def _publish_pose(self, estimate: Estimate) -> None:
        pose = latched_poses(estimate).get(self._pose_topic)
        if pose is not None:
            message = pose_message(ros_types, estimate.stamp_ns, self._inbox.frame_id, pose)
            self.send(self._pose, message)

    def _look_at_frames(self) -> None:
        """Warn, once, of a second frame_id."""
        if self._inbox.frames_warning and not self._frames_warned:
            self._frames_warned = True
            self.get_logger().warning(f"topic imu: {self._inbox.frames_warning}")

    def _announce(self, status: Status) -> None:
        """Log what is new of the status, and publish a change of `aligned`."""
        self._log.tell(status)
        aligned = status.state is State.ALIGNED
        if aligned != self._aligned:
            self._aligned = aligned
            self.send(self._aligned_publisher, Bool(data=aligned))
            if aligned:
                self._save()

    def _publish_attitude(self, samples: ImuSamples, stamp_ns: int) -> None:
        estimate = self.session.estimate
        sample = find_sample(samples, stamp_ns, estimate)
        if estimate is None or sample is None:
            return
        attitude = messages.attitude_message(estimate, *sample, self._inbox.frame_id)
        self.send(self._attitude, attitude)
        misalignment = messages.misalignment_message(estimate, self.values["nav_frame"])
        self.send(self._misalignment, misalignment)

    def _on_fix(self, fix: NavSatFix) -> None:
        position = position_from_fix(fix)
        if position is None or self.session.position is not None:
            return
        self._flush()
        self.session.set_position(position)
        self.get_logger().info(
            f"position from topic fix: {fix.latitude:.6f} deg, {fix.longitude:.6f} deg"
        )

    def _on_restart(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._flush()
        if self._aligned:
            self._save()  # the best of it: this is what stays
        self.session.restart()
        self._announce(self.session.status)
        response.success, response.message = True, "started again"
        return response

    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._flush()
        if not self._result.path:
            response.message = "parameter result_file is empty: nowhere to write to"
            return response
        problem = self._save()
        response.success = not problem
        response.message = problem or f"written to {self._result.path}"
        return response

    def _save(self) -> str:
        """Write the result file, if there is to be one; what went wrong, '' if nothing."""
        try:
            self._result.write(self.session)
        except OSError as error:
            problem = f"result_file could not be written: {error_text(error)}"
            self.get_logger().error(problem)
            return problem
        return ""

    def finish(self) -> None:
        """Take in what has come and write the result file; works after the shutdown of ROS.

        Raises
        ------
        OSError : the result file could not be written; names it
        """
        self._flush()
        if not self._result.write_last(self.session):
            state = self.session.status.state.value
            self.get_logger().warning(
                f"{self._result.path} keeps the alignment that was complete; the state is {state}"
            )

    def _publish_diagnostics(self) -> None:
        self._flush()
        estimate = self.session.estimate
        name = self.get_fully_qualified_name().lstrip("/")  # two nodes may differ in no more
        inputs = self.input_findings()
        silent_s = self._silence.silent_s(self.session.counts)
        if silent_s is not None:
            never = self.session.counts.imu_samples == 0
            inputs.append(NO_IMU() if never else IMU_SILENT(silent_s=silent_s))
        self._log.tell_inputs(inputs)
        # Without samples no time to go runs down.
        eta_s = math.nan if inputs and not self._aligned else self._eta.eta_s(self.session)
        status = diagnostic_status(self.session, name, estimate, eta_s, tuple(inputs))
        status.values += key_values(self.diagnostic_texts(estimate))
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self.send(self._diagnostics, message)
