"""The table of reasons and the cases do not drift apart."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

import node_reasons_odo as odo
import node_reasons_swing as swing

from sins_align.reasons import REASONS

# Where else a node is made to give them, or why none can be.
ELSEWHERE = {
    "vehicle_moves": "a drive-off has tests of its own",
    "stored_check": "a stored alignment has tests of its own",
    "stored_confirm": "likewise",
    "stored_dropped": "likewise",
}


def test_every_reason_of_the_table_is_produced() -> None:
    produced = odo.BESIDE | swing.BESIDE
    for case in (*odo.CASES, *swing.CASES):
        produced |= case.keys
    assert produced.isdisjoint(ELSEWHERE)
    assert produced | set(ELSEWHERE) == {reason.key for reason in REASONS}
