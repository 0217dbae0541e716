"""The node `odo_align`: alignment of a vehicle that stands or drives, aided by its odometer."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

# Small matrices: threads cost more than they bring. It counts before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rclpy.qos import QoSProfile, ReliabilityPolicy

from sins_align.config import odo_config
from sins_align.reasons import ODOMETER_TYPE, Finding
from sins_align.ros.bags_topics import odometer_type
from sins_align.ros.diagnostics import odometer_texts
from sins_align.ros.node_base import AlignNode
from sins_align.ros.odometer import OdometerRow, odometer_row, odometer_samples
from sins_align.ros.portable_messages import ros_types
from sins_align.ros.run_node import prepare_aligner, run_node
from sins_align.session import Session
from sins_align.types import Estimate, Update

NAME = "odo_align"
ODOM_QOS = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)


class OdoAlignNode(AlignNode):
    """Adds the odometer to what all alignment nodes do."""

    def __init__(self) -> None:
        super().__init__(NAME, lambda values: Session(odo_config(values)), "mounting")
        self._rows: list[OdometerRow] = []
        self._odom_type = odometer_type(self.values["odom_type"])
        self._odom = self.create_input(ros_types(self._odom_type), "odom", self._on_odom, ODOM_QOS)

    def _on_odom(self, message: Any) -> None:
        self._rows.append(odometer_row(message))

    def take_in_aiding(self) -> list[Update]:
        """Hand over the odometer samples that have come."""
        if not self._rows:
            return []
        rows, self._rows = self._rows, []
        return self.session.add_odometer(odometer_samples(rows))

    def input_findings(self) -> list[Finding]:
        """Says so where the topic carries another type, which ROS does not."""
        if self.values["aiding"] == "stationary":
            return []  # none is needed
        publishers = self.get_publishers_info_by_topic(self._odom.topic_name)
        types = {publisher.topic_type for publisher in publishers}
        if not types or self._odom_type in types:
            return []
        return [ODOMETER_TYPE(other=min(types), wanted=self.values["odom_type"])]

    def diagnostic_texts(self, estimate: Estimate | None) -> dict[str, str]:
        """The keys of the odometer."""
        return odometer_texts(estimate)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; returns its exit status."""
    return run_node(NAME, OdoAlignNode, prepare_aligner, args)


if __name__ == "__main__":
    sys.exit(main())
