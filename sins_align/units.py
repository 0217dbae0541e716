"""Factors to SI: `value_in_unit * UNIT` is in SI.

Used where values are read or printed, and nowhere between.
"""

import math

DEG = math.pi / 180.0
ARCMIN = DEG / 60.0
ARCSEC = DEG / 3600.0
DEG_PER_H = DEG / 3600.0
DEG_PER_SQRT_H = DEG / 60.0
STANDARD_GRAVITY = 9.80665
MICRO_G = 1e-6 * STANDARD_GRAVITY
PPM = 1e-6
