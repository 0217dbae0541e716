"""What a configuration names: the aligner of a node, and what its status is held against."""

from __future__ import annotations

import math
from typing import NamedTuple

from sins_align.config import OdoConfig, SwingConfig
from sins_align.consistency import Declared
from sins_align.earth import GRAVITY_EQUATOR
from sins_align.odo import make_odo_aligner
from sins_align.odo.publication import TURN_MOTION
from sins_align.protocols import AidedAligner, Aligner
from sins_align.resume import ResumingAligner
from sins_align.resume_aided import ResumingAidedAligner
from sins_align.status import Completer, Expectation
from sins_align.stored import StoredAlignment
from sins_align.swing import make_aligner
from sins_align.types import Position

TURN_BASE = "turn the base by 90 deg or more"


class Aligners(NamedTuple):
    """An aligner, and the same where it takes an odometer, else None."""

    aligner: Aligner
    aided: AidedAligner | None


def make_aligners(
    config: SwingConfig | OdoConfig, position: Position, initial: StoredAlignment | None
) -> Aligners:
    """Those of a node, from the first sample on; initial : a stored alignment to go on from."""
    if isinstance(config, SwingConfig):
        aligner = make_aligner(config, position)
        if initial is not None:
            aligner = ResumingAligner(aligner, config, position, initial)
        return Aligners(aligner, None)
    aided = make_odo_aligner(config, position)
    if initial is not None:
        aided = ResumingAidedAligner(aided, config, position, initial)
    return Aligners(aided, aided)


def make_completer(config: SwingConfig | OdoConfig, position: Position | None) -> Completer:
    """The state machine of a node."""
    grade = config.grade
    bias = math.hypot(grade.gyro_bias, grade.gyro_bias_instability)
    declared, motion = Declared(gyro_bias=bias), TURN_BASE
    if isinstance(config, OdoConfig):
        triad = GRAVITY_EQUATOR * math.hypot(grade.accel_scale, grade.misalignment)
        accel = math.hypot(grade.accel_bias, triad)
        declared, motion = Declared(bias, accel, config.odometer.scale_sigma), TURN_MOTION
    expectation = Expectation(grade, position, declared, config.latitude_check, motion)
    return Completer(config.completion, expectation)
