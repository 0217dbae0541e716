"""Order of the error states of the aided filters.

Errors are estimate minus truth; those of the sensors are what is left in the corrected
samples. What all filters share comes first: misalignment phi and velocity error, gyro and
accelerometer bias, the gyros' response to turning about the vertical (scale error and
misalignment), the odometer's (`odometer_model`). Then comes what is the frame's own, and last,
in the propagated state only, the path: int of the velocity error over the epoch.
"""

from __future__ import annotations

from sins_align.odo.odometer_model import POSITION, SCALE

PHI = slice(0, 3)
VELOCITY = slice(3, 6)
GYRO_BIAS = slice(6, 9)
ACCEL_BIAS = slice(9, 12)
GYRO_TURN = slice(12, 15)
ODOMETER = slice(15, 29)
SHARED = 29
# Of the odometer's, in the whole state.
ODOMETER_SCALE = ODOMETER.start + SCALE
ODOMETER_POSITION = slice(ODOMETER.start + POSITION.start, ODOMETER.start + POSITION.stop)

# Wander filters: the horizontal part of the Earth's axis, or the azimuth.
AZIMUTH = slice(29, 31)
ALPHA = 29  # of one azimuth state; the second one is then not used
SIZE = 31

# Filters in ENU: phi's vertical part is the azimuth error U, of any size; place: position
# error. Their error model has the Earth's axis, all of it, where the place is.
U = 2
PLACE = AXIS = slice(29, 32)
ENU_SIZE = 32


def path_of(size: int) -> slice:
    """Of the path, in a propagated state of `size` states without it."""
    return slice(size, size + 3)
