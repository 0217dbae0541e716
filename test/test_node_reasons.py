"""The table of reasons and the tests that produce them do not drift apart."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy")

import test_node_reasons_odo as odo
import test_node_reasons_stored as stored
import test_node_reasons_swing as swing

from sins_align.reasons import REASONS


def test_every_reason_of_the_table_is_produced() -> None:
    produced = odo.BESIDE | swing.BESIDE | stored.BESIDE
    for case in (*odo.CASES, *swing.CASES):
        produced |= case.keys
    assert produced == {reason.key for reason in REASONS}
