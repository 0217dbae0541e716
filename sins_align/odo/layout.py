"""Order of the error states of the aided filters.

Errors are estimate minus truth; those of the sensors are what is left in the corrected
samples. In the order of the state: misalignment phi and velocity error in the navigation
frame, azimuth, gyro and accelerometer bias, the gyros' response to turning about the vertical
(scale error and misalignment), then the odometer's (`odometer_model`).
"""

from __future__ import annotations

PHI = slice(0, 3)
VELOCITY = slice(3, 6)
AZIMUTH = slice(6, 8)
ALPHA = 6  # of one azimuth state; the second one is then not used
GYRO_BIAS = slice(8, 11)
ACCEL_BIAS = slice(11, 14)
GYRO_TURN = slice(14, 17)
ODOMETER = slice(17, 31)
SIZE = 31
# int of the velocity error over the epoch: of the propagated state only.
PATH = slice(31, 34)
EXTENDED = 34
