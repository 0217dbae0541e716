"""Self-alignment on a base that swings about a fixed, unknown centre."""

from sins_align.config import SwingConfig
from sins_align.protocols import Aligner
from sins_align.swing.guarded import GuardedAligner
from sins_align.swing.inertial import InertialAligner
from sins_align.types import Position


def make_aligner(config: SwingConfig, position: Position) -> Aligner:
    """The estimator that `config.method` names, guarded against a vehicle that drives off."""
    return GuardedAligner(lambda: _make(config, position), position, config.sampling)


def _make(config: SwingConfig, position: Position) -> Aligner:
    if config.method == "paper":
        from sins_align.swing.paper import PaperAligner  # what it imports is slow to import

        return PaperAligner(config, position)
    return InertialAligner(config, position)
