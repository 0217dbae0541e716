"""What was simulated of a drive: the truth that an alignment is judged by."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sins_align.simulate.vehicle_track import Track
from sins_align.types import Array, IntArray

Stamps = int | IntArray


@dataclass(frozen=True, eq=False)
class VehicleTruth:
    """Truth of a simulated drive. Times outside the run are refused where noted.

    stamp_ns : of the last IMU sample
    q_nb_wxyz : (4,) body (FLU) to ENU at `stamp_ns`, Hamilton, w >= 0
    latitude_deg, longitude_deg, altitude_m : of the IMU at the start
    gyro_bias_rad_s, accel_bias_m_s2 : (3,) the constant part; the drift comes on top
    odometer_scale_error : measured over true distance, minus 1, before any step of it
    odometer_lever_arm_m : (3,) IMU to the odometer's reference point, FLU
    mounting_rpy_deg : (3,) of C_bm = Rz Ry Rx, vehicle axes to b
    odometer_latency_s : by how much the odometer's stamps are late
    scenario, grade : names; a grade of one's own is 'custom'
    sampling : 'instantaneous' or 'mean'
    """

    stamp_ns: int
    q_nb_wxyz: Array
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    gyro_bias_rad_s: Array
    accel_bias_m_s2: Array
    odometer_scale_error: float
    odometer_lever_arm_m: Array
    mounting_rpy_deg: Array
    odometer_latency_s: float
    seed: int
    scenario: str
    grade: str
    rate_hz: float
    sampling: str
    start_stamp_ns: int = field(repr=False)
    track: Track = field(repr=False)

    def C_nb_at(self, stamp_ns: Stamps) -> Array:
        """(3, 3), or (3, 3, N) for (N,) stamps [ns]: C_nb, FLU body to ENU."""
        C_nb = self.track.motion.attitude(self._elapsed(stamp_ns)).C_nb
        return _shaped(C_nb, stamp_ns)

    def v_n_at(self, stamp_ns: Stamps) -> Array:
        """(3,), or (3, N) for (N,) stamps [ns]: velocity of the IMU in ENU [m/s].

        Raises
        ------
        ValueError : a stamp outside the run
        """
        return _shaped(self.track.imu_motion(self._elapsed(stamp_ns)).v_n, stamp_ns)

    def position_at(self, stamp_ns: Stamps) -> Array:
        """(3,), or (3, N) for (N,) stamps [ns]: latitude, longitude [rad], altitude [m].

        Raises
        ------
        ValueError : a stamp outside the run
        """
        return _shaped(np.stack(self.track.place(self._elapsed(stamp_ns))), stamp_ns)

    def heading_at(self, stamp_ns: Stamps) -> Array:
        """Of the x axis of b, clockwise from north [0, 2 pi); a number, or (N,) [rad]."""
        forward = self.C_nb_at(stamp_ns)[:, 0]
        return np.mod(np.arctan2(forward[0], forward[1]), math.tau)

    def speed_at(self, stamp_ns: Stamps) -> Array:
        """Of the odometer's reference point along its way, signed; a number, or (N,) [m/s]."""
        return _shaped(self.track.motion.route.speed(self._elapsed(stamp_ns))[1], stamp_ns)

    def distance_at(self, stamp_ns: Stamps) -> Array:
        """Signed travel of the odometer's point since the start; a number, or (N,) [m]."""
        return _shaped(self.track.motion.route.speed(self._elapsed(stamp_ns))[0], stamp_ns)

    def truth_dict(self) -> dict[str, object]:
        """The content of truth.json, plain numbers and lists.

        Beside the keys that INTERFACES.md fixes: `sampling`, and what there is to know about
        the odometer. `lever_arm_m`, from a swing centre, is None.
        """
        return {
            "q_nb_wxyz": self.q_nb_wxyz.tolist(),
            "stamp_ns": self.stamp_ns,
            "lever_arm_m": None,
            "latitude_deg": self.latitude_deg,
            "longitude_deg": self.longitude_deg,
            "altitude_m": self.altitude_m,
            "gyro_bias_rad_s": self.gyro_bias_rad_s.tolist(),
            "accel_bias_m_s2": self.accel_bias_m_s2.tolist(),
            "odometer_scale_error": self.odometer_scale_error,
            "seed": self.seed,
            "scenario": self.scenario,
            "grade": self.grade,
            "rate_hz": self.rate_hz,
            "sampling": self.sampling,
            "odometer_lever_arm_m": self.odometer_lever_arm_m.tolist(),
            "mounting_rpy_deg": self.mounting_rpy_deg.tolist(),
            "odometer_latency_s": self.odometer_latency_s,
        }

    def _elapsed(self, stamp_ns: Stamps | Sequence[int]) -> Array:
        stamps = np.atleast_1d(np.asarray(stamp_ns, dtype=np.int64))
        elapsed: Array = (stamps - self.start_stamp_ns).astype(np.float64) * 1e-9
        return elapsed


def _shaped(values: Array, stamp_ns: Stamps) -> Array:
    """`values` over times on the last axis, without that axis for a single stamp."""
    single: Array = values[..., 0]
    return values if np.ndim(stamp_ns) else single
