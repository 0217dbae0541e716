"""sins_align: initial alignment of strapdown inertial navigation systems.

This page states the conventions that every module keeps.

Frames
------
b   body, REP-103: x forward, y left, z up (FLU). Mu & Fang and Wu et al. use x right,
    y forward, z up: (x, y, z)_FLU = (y, -x, z)_RFU.
n   navigation, local ENU (x east, y north, z up) at the swing centre or the vehicle.
b0  the body axes at the first sample, frozen in inertial space.
n0  the navigation axes at the first sample, frozen in inertial space.
a   wander azimuth: level like ENU, but turned about up by an angle alpha, v_n = Rz(alpha) v_a.
m   the vehicle's axes, in which it travels along x; C_bm is the mounting of the IMU.
i   inertial; e Earth-fixed.

Symbols
-------
``C_nb``     maps body to navigation, v_n = C_nb @ v_b: adjacent letters cancel.
``q_nb``     the same rotation as a Hamilton quaternion, scalar first (w, x, y, z).
``w_ib_b``   angular rate of b against i, resolved in b [rad/s].
``f_ib_b``   specific force, resolved in b [m/s^2]; a body at rest with z up reads +g.
``phi``      misalignment, a small rotation in ENU axes:
             C_nb_estimated = (I - [phi x]) C_nb_true. Its covariance is (3, 3) [rad^2],
             axes east, north, up.
``r_b``      lever arm, swing centre to IMU, in b [m].
heading      clockwise from true north [0, 2 pi); yaw = pi/2 - heading, counter-clockwise
             from east. roll, pitch, yaw: C_nb = Rz(yaw) Ry(pitch) Rx(roll) (REP-103),
             so that pitch is positive nose down.

Units are SI and radians everywhere; a name that ends in another unit (``_deg``,
``_arcmin``) occurs only where values are read or printed. Time is integer nanoseconds of
``header.stamp``. Vectors over samples are stored (3, N): one axis a row.
"""

__version__ = "0.1.0"
