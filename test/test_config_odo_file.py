"""The shipped parameter file of odo_align."""

from __future__ import annotations

import math
import re

from sins_align.config import odo_config
from sins_align.config_path import shipped_config
from sins_align.parameters import check_values, parameters_of, read_parameter_file

NODE = "odo_align"
TABLE = parameters_of(NODE)
FILE = shipped_config("odo_align.yaml")
# For a vehicle with a fibre gyro; the file's head says so.
OTHER = {
    "imu_grade": "fog",
    "heading_threshold_arcmin": 10.0,
    "level_threshold_arcsec": 60.0,
}


def test_it_holds_every_parameter_with_its_default() -> None:
    values = read_parameter_file(FILE, NODE)
    assert set(values) == set(TABLE)
    for name, value in check_values(NODE, values).items():
        expected = OTHER.get(name, TABLE[name].default)
        unset = isinstance(expected, float) and math.isnan(expected)
        assert value == expected or (unset and math.isnan(value)), name  # type: ignore[arg-type]
    assert odo_config(values).grade.gyro_bias > 0.0


def test_what_rclpy_reads_has_the_type_of_the_parameter() -> None:
    """1e-5 is a text to ROS, and 2 no real number."""
    text = FILE.read_text(encoding="utf-8")
    for name, entry in TABLE.items():
        (value,) = re.findall(rf"^    {name}: (.*)$", text, re.MULTILINE)
        if isinstance(entry.default, float | list):
            for number in value.strip("[]").split(", "):
                assert number == ".nan" or re.fullmatch(r"-?\d+\.\d+(e-?\d+)?", number), name
