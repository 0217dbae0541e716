"""Going on from a stored alignment with an odometer, which tells whether the vehicle stands."""

from __future__ import annotations

import numpy as np

from sins_align.config import OdoConfig
from sins_align.protocols import AidedAligner
from sins_align.resume import ResumingAligner
from sins_align.stored import StoredAlignment
from sins_align.stored_check import CHECK_S
from sins_align.types import Advance, ImuBlock, OdometerSamples, Position

# So much earlier than the check the samples of the odometer that count for it end [ns].
LATENCY_MARGIN_NS = 1_000_000_000
# The vehicle drives when its odometer says so for half of the check [m/s].
DRIVING_SPEED = 0.1

DRIVES = "the vehicle drives"


class ResumingAidedAligner(ResumingAligner):
    """`ResumingAligner` for one that needs an odometer; fulfils `AidedAligner`."""

    def __init__(
        self,
        aligner: AidedAligner,
        config: OdoConfig,
        position: Position,
        stored: StoredAlignment,
    ) -> None:
        super().__init__(aligner, config, position, stored)
        self._aided = aligner
        self._latency_ns = round(config.odometer.latency * 1e9)
        self._samples: list[OdometerSamples] = []  # while the check goes on

    def update(self, block: ImuBlock) -> list[Advance]:
        """Take in the next block; a step for each of the aligner proper."""
        self._keep(block)
        return self._pass_on(self._aided.update(block))

    def aid(self, samples: OdometerSamples) -> list[Advance]:
        """Take in samples of the odometer; a step for each of the aligner proper."""
        if self._check is not None:
            self._samples.append(samples)
        return self._pass_on(self._aided.aid(samples))

    def _doubt(self) -> str:
        """A vehicle that drives straight on is as still as one that stands.

        By samples that the aligner proper has not come so far without, whatever latency it finds.
        """
        begin_ns = self._stamp_ns - round(CHECK_S * 1e9) + self._latency_ns
        end_ns = self._stamp_ns - LATENCY_MARGIN_NS + self._latency_ns
        speeds = [
            speed
            for samples in self._samples
            for stamp_ns, speed in zip(samples.stamp_ns.tolist(), samples.speed, strict=True)
            if begin_ns <= stamp_ns <= end_ns
        ]
        self._samples = []
        return DRIVES if speeds and float(np.median(np.abs(speeds))) > DRIVING_SPEED else ""
