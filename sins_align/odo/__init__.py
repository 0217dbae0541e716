"""Alignment of a moving vehicle, aided by an odometer."""

from sins_align.config import OdoConfig
from sins_align.odo.aligner import OdoAligner
from sins_align.protocols import AidedAligner
from sins_align.types import Position


def make_odo_aligner(config: OdoConfig, position: Position) -> AidedAligner:
    """The estimator that `config.method` names."""
    return OdoAligner(config, position)
