"""What was simulated: the truth that an alignment is judged by."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from sins_align.simulate.base_motion import BaseMotion
from sins_align.types import Array, IntArray


@dataclass(frozen=True, eq=False)
class SwingTruth:
    """Truth of a simulated swing.

    stamp_ns : of the last sample
    q_nb_wxyz : (4,) body (FLU) to ENU at `stamp_ns`, Hamilton, w >= 0
    lever_arm_m : (3,) swing centre to IMU, FLU
    gyro_bias_rad_s, accel_bias_m_s2 : (3,) the constant part; the drift comes on top
    odometer_scale_error : None, there is no odometer
    scenario, grade : names; a grade of one's own is 'custom'
    sampling : 'instantaneous' or 'mean'
    paper_axes : the axes, 'b' or 'b2', in which the paper prints the lever arm
    C_paper_b : (3, 3) from b (FLU) to these
    drive_stamp_ns : begin and end of the drive, which may lie after the run; None without one
    """

    stamp_ns: int
    q_nb_wxyz: Array
    lever_arm_m: Array
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    gyro_bias_rad_s: Array
    accel_bias_m_s2: Array
    odometer_scale_error: float | None
    seed: int
    scenario: str
    grade: str
    rate_hz: float
    sampling: str
    paper_axes: str
    C_paper_b: Array
    drive_stamp_ns: tuple[int, int] | None
    start_stamp_ns: int = field(repr=False)
    base: BaseMotion = field(repr=False)

    def C_nb_at(self, stamp_ns: int | IntArray) -> Array:
        """Attitude at any time, also outside the run.

        Parameters
        ----------
        stamp_ns : one stamp, or (N,) of them [ns]

        Returns
        -------
        (3, 3), or (3, 3, N): C_nb, FLU body to ENU
        """
        stamps = np.atleast_1d(np.asarray(stamp_ns, dtype=np.int64))
        elapsed: Array = (stamps - self.start_stamp_ns).astype(np.float64) * 1e-9
        C_nb = self.base.attitude(elapsed).C_nb
        return C_nb if np.ndim(stamp_ns) else C_nb[:, :, 0]

    def truth_dict(self) -> dict[str, object]:
        """The content of truth.json, plain numbers and lists.

        Beside the keys that INTERFACES.md fixes: `sampling`, `paper_axes` with the name and
        the matrix (from b, FLU) of the axes of the paper's tables, and `drive_stamp_ns`.
        """
        return {
            "q_nb_wxyz": self.q_nb_wxyz.tolist(),
            "stamp_ns": self.stamp_ns,
            "lever_arm_m": self.lever_arm_m.tolist(),
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
            "paper_axes": {"name": self.paper_axes, "C_paper_b": self.C_paper_b.tolist()},
            "drive_stamp_ns": list(self.drive_stamp_ns) if self.drive_stamp_ns else None,
        }


def quaternion_of(C: Array) -> Array:
    """(4,) Hamilton quaternion, scalar first and not negative, of the matrix C (3, 3)."""
    x, y, z, w = Rotation.from_matrix(C).as_quat(canonical=True)
    return np.array([w, x, y, z])
