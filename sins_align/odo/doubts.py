"""Why what a filter of `odo_align` says is not to be believed, beyond what can be seen of it."""

from __future__ import annotations

import math

from sins_align.config import OdoConfig
from sins_align.latitudes import combine_latitudes
from sins_align.limits import DOUBTED_LATITUDE_RATIO, MAX_LATITUDE_RATIO
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.imu_model import imu_noise
from sins_align.odo.loudness import Loudness
from sins_align.odo.plausibility import OdometerPlausibility
from sins_align.odo.standing_latitude import StandingLatitude
from sins_align.odo.wander import WanderFilter
from sins_align.reasons import LATITUDE_DOUBTED, ODOMETER_SILENT, Finding
from sins_align.rotation import dcm_from_rpy
from sins_align.types import LatitudeEstimate

# An odometer that says nothing for longer is silent [s].
SILENT_S = 5.0


class Doubts:
    """Watches the odometer, and the latitude and the gyros' noise that the data tell.

    latitude : the one that was given [rad]
    """

    def __init__(self, config: OdoConfig, latitude: float) -> None:
        self._latitude = latitude
        self._noise = imu_noise(config.grade)
        forward_b = dcm_from_rpy(*config.odometer.mounting_rpy.tolist())[:, 0]
        self._plausibility = None if config.stationary else OdometerPlausibility(forward_b)
        self._standing = StandingLatitude(config.grade, latitude)
        self._silent_s = 0.0
        self._loudness: Loudness | None = None

    def follow(self, filter_: WanderFilter | None) -> None:
        """After an epoch of the filter; another filter, or none, ends the test of the gyros."""
        if filter_ is None:
            self._loudness = None
        elif self._loudness is None or self._loudness.filter is not filter_:
            self._loudness = Loudness(filter_, self._noise)
        else:
            self._loudness.follow()

    def add(self, epoch: AidedEpoch, standing: bool) -> bool:
        """Take in an epoch as measured; whether an odometer that was wrong has become right."""
        self._standing.add(epoch, standing)
        if self._plausibility is None:
            return False
        heard = standing or epoch.travel is not None
        self._silent_s = 0.0 if heard else self._silent_s + epoch.duration_s
        return self._plausibility.add(epoch)

    def latitude(self, own: LatitudeEstimate | None) -> LatitudeEstimate | None:
        """The one that the data tell; own : by the filter alone."""
        return combine_latitudes(own, self._standing.latitude)

    def findings(self, own: LatitudeEstimate | None, has_estimate: bool) -> tuple[Finding, ...]:
        """What there is to doubt; own : the latitude that the data tell."""
        findings: list[Finding] = []
        if self._plausibility is not None:
            findings += self._plausibility.findings
        if self._silent_s > SILENT_S:
            findings.append(ODOMETER_SILENT(silent_s=self._silent_s))
        if self._loudness is not None:
            findings += self._loudness.findings
        if own is not None:
            # One that is far out keeps heading from ever being known.
            most = DOUBTED_LATITUDE_RATIO if has_estimate else MAX_LATITUDE_RATIO
            ratio = abs(own.latitude - self._latitude) / own.sigma
            if ratio > most:
                sigma = math.degrees(own.sigma)
                findings.append(LATITUDE_DOUBTED(ratio=ratio, sigma_deg=sigma))
        return tuple(findings)
