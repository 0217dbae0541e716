"""Parameters from files, the command line and code; grades."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from sins_align.config import ConfigError, ImuGrade, load_grade, swing_config
from sins_align.config_path import shipped_config
from sins_align.grades import GRADE_KEYS, grade_from_values, grade_names
from sins_align.parameters import (
    GRADE_OVERRIDES,
    Parameter,
    check_values,
    parameters_of,
    parse_override,
    read_parameter_file,
)
from sins_align.types import ImuSampling
from sins_align.units import ARCMIN, ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G, PPM

NODE = "swing_align"
TABLE = parameters_of(NODE)
NUMBERS = [p for p in TABLE.values() if isinstance(p.default, int | float)]
TEXTS = [p for p in TABLE.values() if isinstance(p.default, str)]
ARRAYS = [p for p in TABLE.values() if isinstance(p.default, list)]

# The table of the interface: gyro bias deg/h, ARW deg/sqrt(h), bias instability deg/h,
# accelerometer bias ug, VRW ug/sqrt(Hz), gyro and accelerometer scale ppm, misalignment arcsec.
GRADES = """
| perfect | 0 | 0 | 0 | 0 | 0 | 0 / 0 | 0 |
| paper_swing | 0 | 5.27e-7 | 0 | 0 | 0.632 | 0 / 0 | 0 |
| paper_odo | 0.02 | 1.667e-4 | 0 | 100 | 10 | 0 / 0 | 0 |
| rlg | 0.003 | 0.0005 | 0 | 20 | 5 | 0 / 0 | 0 |
| rlg_parked | 0.01 | 0.0005 | 0 | 50 | 10 | 0 / 0 | 0 |
| fog | 0.02 | 0.002 | 0.005 | 100 | 20 | 10 / 50 | 5 |
| fog_noisy | 0.02 | 0.005 | 0 | 100 | 20 | 0 / 0 | 0 |
| tactical | 1.0 | 0.06 | 0.3 | 1000 | 100 | 200 / 300 | 40 |
"""


def grade_table() -> dict[str, ImuGrade]:
    grades = {}
    for line in GRADES.split("\n")[1:-1]:
        name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        bias, arw, drift, accel_bias, vrw, scales, misalignment = cells
        gyro_scale, accel_scale = scales.split("/")
        grades[name] = ImuGrade(
            gyro_bias=float(bias) * DEG_PER_H,
            gyro_arw=float(arw) * DEG_PER_SQRT_H,
            gyro_bias_instability=float(drift) * DEG_PER_H,
            accel_bias=float(accel_bias) * MICRO_G,
            accel_vrw=float(vrw) * MICRO_G,
            gyro_scale=float(gyro_scale) * PPM,
            accel_scale=float(accel_scale) * PPM,
            misalignment=float(misalignment) * ARCSEC,
        )
    return grades


def fails(text: str, **values: object) -> None:
    """The message is one line and names the key first."""
    with pytest.raises(ConfigError) as caught:
        swing_config(values)
    (key,) = values
    message = str(caught.value)
    assert message.startswith(f"{key}: ")
    assert text in message
    assert "\n" not in message


# -- grades


def test_shipped_grades_are_the_published_ones() -> None:
    assert {name: load_grade(name) for name in grade_names()} == grade_table()


def test_units_of_a_grade() -> None:
    """0.003 deg/h, 0.0005 deg/sqrt(h), 20 ug, 5 ug/sqrt(Hz), in SI."""
    rlg = load_grade("rlg")
    assert rlg.gyro_bias == pytest.approx(1.4544e-8, rel=1e-4)
    assert rlg.gyro_arw == pytest.approx(1.4544e-7, rel=1e-4)
    assert rlg.accel_bias == pytest.approx(1.96133e-4)
    assert rlg.accel_vrw == pytest.approx(4.903325e-5)


def test_unknown_grade_lists_the_known() -> None:
    with pytest.raises(ConfigError, match=r"imu_grade: no grade 'mems'.*rlg_parked"):
        load_grade("mems")
    fails("rlg_parked", imu_grade="mems")


@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf, "1", None, True, [1.0], 10**400])
def test_values_that_no_grade_has(value: object) -> None:
    for key in GRADE_KEYS:
        with pytest.raises(ConfigError, match=key):
            grade_from_values({key: value})


def test_a_grade_made_by_hand_is_checked_too() -> None:
    for field in ("gyro_arw", "misalignment"):
        with pytest.raises(ConfigError, match=field):
            ImuGrade(**{field: math.nan})
    with pytest.raises(ConfigError, match="gyro_bias_correlation_s"):
        ImuGrade(gyro_bias_correlation_s=0.0)
    with pytest.raises(ConfigError, match="gyro_noise: unknown"):
        grade_from_values({"gyro_noise": 1.0})


def test_single_values_override_the_grade() -> None:
    grade = swing_config({"imu_grade": "fog", "gyro_arw_deg_sqrt_h": 0.1, "accel_bias_ug": 0}).grade
    fog = load_grade("fog")
    assert grade.gyro_arw == 0.1 * DEG_PER_SQRT_H
    assert grade.accel_bias == 0.0
    assert (grade.gyro_bias, grade.misalignment) == (fog.gyro_bias, fog.misalignment)
    assert set(GRADE_OVERRIDES) <= set(GRADE_KEYS)
    assert len(GRADE_OVERRIDES) == 5


# -- settings


def test_defaults() -> None:
    config = swing_config()
    assert config.position is None
    assert config.method == "inertial"
    assert config.grade == load_grade("rlg")
    assert config.sampling is ImuSampling.INSTANTANEOUS
    assert config.position_walk == pytest.approx(0.4 * config.position_noise)
    assert config.paper.eso_bandwidth is None
    assert config.paper.switch_times_s == (15.0, 30.0, 70.0)


def test_units_are_converted_once() -> None:
    config = swing_config({
        "latitude_deg": -33.5, "heading_threshold_arcmin": 2, "level_threshold_arcsec": 3.0,
        "imu_sampling": "mean", "lever_arm_prior_m": (1, 2.5, -3), "initial_rpy_deg": [0, 90, 180],
        "eso_bandwidth_rad_s": 50, "position_walk_m_sqrt_s": 0.0,
    })  # fmt: skip
    assert config.position is not None
    assert (config.position.latitude, config.position.longitude) == (-33.5 * DEG, 0.0)
    assert config.completion.heading_threshold == 2.0 * ARCMIN
    assert config.completion.level_threshold == 3.0 * ARCSEC
    assert config.sampling is ImuSampling.MEAN
    np.testing.assert_array_equal(config.lever_arm_prior, [1.0, 2.5, -3.0])
    assert config.paper.initial_rpy == (0.0, 0.5 * math.pi, math.pi)
    assert config.paper.eso_bandwidth == 50.0
    assert config.position_walk == 0.0


def test_unknown_keys_fail() -> None:
    fails("unknown parameter of swing_align", latitude=40.0)
    fails("unknown parameter of swing_align", odom_type="Odometry")
    with pytest.raises(ConfigError, match="None: unknown"):
        check_values(NODE, {None: 1})  # type: ignore[dict-item]


@pytest.mark.parametrize("parameter", NUMBERS, ids=lambda p: p.name)
def test_numbers(parameter: Parameter) -> None:
    for value in ("40", None, True, [1.0], {}, 1j):
        fails("is not a number", **{parameter.name: value})
    for value in (math.inf, -math.inf, 10**400, np.nextafter(parameter.low, -math.inf)):
        fails("outside [", **{parameter.name: value})
    fails("outside [", **{parameter.name: np.nextafter(parameter.high, math.inf)})
    for value in (parameter.low, parameter.high, np.float64(parameter.high)):
        assert check_values(NODE, {parameter.name: value})[parameter.name] == value
    if isinstance(parameter.default, int) or not math.isnan(parameter.default):
        fails("outside [", **{parameter.name: math.nan})
    else:
        assert math.isnan(check_values(NODE, {parameter.name: math.nan})[parameter.name])  # type: ignore[arg-type]


def test_whole_numbers() -> None:
    fails("is not a whole number", passes=2.5)
    for value in (2, 2.0, np.int64(2)):
        found = check_values(NODE, {"passes": value})["passes"]
        assert (found, type(found)) == (2, int)
    # And a whole number is good for a real one.
    found = check_values(NODE, {"latitude_deg": 40})["latitude_deg"]
    assert (found, type(found)) == (40.0, float)


@pytest.mark.parametrize("parameter", TEXTS, ids=lambda p: p.name)
def test_texts(parameter: Parameter) -> None:
    for value in (1, None, True, ["a"]):
        fails("is not a text", **{parameter.name: value})
    if parameter.choices:
        fails(", ".join(parameter.choices), **{parameter.name: "Mean"})
        for choice in parameter.choices:
            assert check_values(NODE, {parameter.name: choice})[parameter.name] == choice


def test_off_may_stand_without_quotes() -> None:
    """YAML reads it as false, which is nothing where there is no such choice."""
    for value in (False, parse_override("latitude_check:=off", NODE)[1]):
        assert check_values(NODE, {"latitude_check": value})["latitude_check"] == "off"
    fails("is not a text", nav_frame=False)


@pytest.mark.parametrize("parameter", ARRAYS, ids=lambda p: p.name)
def test_arrays(parameter: Parameter) -> None:
    for value in (1.0, "1, 2, 3", None, {1: 2}):
        fails("is not a list of numbers", **{parameter.name: value})
    for element in (math.nan, math.inf, 2.0 * parameter.high, 10**400):
        fails("outside", **{parameter.name: [0.0, element, 0.0]})
    for element in ("1", None, True, [1.0]):
        fails("is not a number", **{parameter.name: [0.0, element, 0.0]})
    if parameter.length is not None:
        fails(f"has not {parameter.length} elements", **{parameter.name: [0.0] * 4})
        fails(f"has not {parameter.length} elements", **{parameter.name: []})
    found = check_values(NODE, {parameter.name: np.array([1.0, 2.0, 3.0])})[parameter.name]
    assert found == [1.0, 2.0, 3.0]


def test_defaults_cannot_be_changed_by_accident() -> None:
    check_values(NODE, {})["lever_arm_prior_m"][0] = 99.0  # type: ignore[index]
    assert check_values(NODE, {})["lever_arm_prior_m"] == [0.0, 0.0, 0.0]


def test_every_default_passes_its_own_check() -> None:
    for name, parameter in TABLE.items():
        value = parameter.check(parameter.default)
        assert value == parameter.default or math.isnan(value), name  # type: ignore[arg-type]
        assert parameter.description


# -- -p name:=value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("latitude_deg:=40", 40.0),
        ("latitude_deg:=-4.05e1", -40.5),
        ("latitude_deg:= 40.5 ", 40.5),
        ("gyro_arw_deg_sqrt_h:=1e-6", 1e-6),
        ("gyro_arw_deg_sqrt_h:=5.27E-7", 5.27e-7),
        ("gyro_arw_deg_sqrt_h:=.5e-3", 0.5e-3),
        ("gyro_arw_deg_sqrt_h:=+1.e2", 100.0),
        ("lever_arm_prior_m:=[1, -2.5, 3e-1]", [1.0, -2.5, 0.3]),
        ("lever_arm_prior_m:=[1e-3,1e3,0]", [1e-3, 1e3, 0.0]),
        ("method:=paper", "paper"),
        ("method:='paper'", "paper"),
        ("nav_frame:=odom:=x", "odom:=x"),
        ("result_file:=", None),
        ("passes:=2", 2),
    ],
)
def test_overrides(text: str, value: object) -> None:
    name, parsed = parse_override(text, NODE)
    assert name == text.partition(":=")[0]
    assert parsed == value
    if value is not None:
        assert check_values(NODE, {name: parsed})[name] == value


@pytest.mark.parametrize("text", [".nan", ".NaN", "nan"])
def test_an_override_may_unset(text: str) -> None:
    assert math.isnan(parse_override(f"latitude_deg:={text}", NODE)[1])  # type: ignore[arg-type]


@pytest.mark.parametrize("text", ["true", "on", "yes", "[1]", "~", "{a: 1}", "2001-01-01"])
def test_overrides_of_another_type_fail_by_name(text: str) -> None:
    with pytest.raises(ConfigError, match=r"latitude_deg: .*not a number"):
        check_values(NODE, dict([parse_override(f"latitude_deg:={text}", NODE)]))
    with pytest.raises(ConfigError, match=r"nav_frame: .*not a text"):
        check_values(NODE, dict([parse_override(f"nav_frame:={text}", NODE)]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("latitude_deg", "name:=value is expected"),
        ("latitude_deg=40", "name:=value is expected"),
        (":=40", "name:=value is expected"),
        ("", "name:=value is expected"),
        ("latitude:=40", "latitude: unknown parameter"),
        ("latitude_deg:=[40", "latitude_deg: '\\[40' is no valid YAML"),
        ("latitude_deg:=north", "latitude_deg: 'north' is not a number"),
        ("latitude_deg:=!!python/name:os.system", "latitude_deg: .* is no valid YAML"),
    ],
)
def test_overrides_that_fail(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_override(text, NODE)


# -- parameter files


def read(tmp_path: Path, text: str | bytes) -> dict[str, object]:
    path = tmp_path / "params.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_parameter_file(path, NODE)


def test_the_shipped_file_holds_every_parameter_with_its_default() -> None:
    values = read_parameter_file(shipped_config("swing_align.yaml"), NODE)
    assert set(values) == set(TABLE)
    for name, value in check_values(NODE, values).items():
        default = TABLE[name].default
        assert value == default or (math.isnan(value) and math.isnan(default)), name  # type: ignore[arg-type]


@pytest.mark.parametrize("section", ["/**", "swing_align", "/swing_align"])
def test_sections(tmp_path: Path, section: str) -> None:
    text = f"{section}:\n  ros__parameters:\n    latitude_deg: 40\n    gyro_bias_deg_h: 1e-3\n"
    assert read(tmp_path, text) == {"latitude_deg": 40, "gyro_bias_deg_h": 1e-3}


NODE_SECTION = "swing_align:\n  ros__parameters: {latitude_deg: 1.0}\n"
WILD_SECTION = "/**:\n  ros__parameters: {latitude_deg: 2.0, passes: 2}\n"
OTHER_SECTION = "camera:\n  ros__parameters: {exposure: 2.0}\n"


@pytest.mark.parametrize(
    "text", [NODE_SECTION + WILD_SECTION, OTHER_SECTION + WILD_SECTION + NODE_SECTION]
)
def test_the_nodes_own_section_wins_wherever_it_stands(tmp_path: Path, text: str) -> None:
    """As rclpy has it."""
    assert read(tmp_path, text) == {"latitude_deg": 1.0, "passes": 2}


def test_numbers_in_a_file_are_those_of_ros(tmp_path: Path) -> None:
    """PyYAML takes numbers with an exponent but no dot or no sign for texts."""
    values = read(
        tmp_path,
        "/**:\n  ros__parameters:\n    gyro_arw_deg_sqrt_h: 5e-7\n    accel_bias_ug: 1.0e2\n"
        "    lever_arm_prior_m: [1e-3, 2E0, -3]\n    altitude_m: .nan\n    nav_frame: 1e5x\n",
    )
    assert values["gyro_arw_deg_sqrt_h"] == 5e-7
    assert values["accel_bias_ug"] == 100.0
    assert values["lever_arm_prior_m"] == [1e-3, 2.0, -3]
    assert math.isnan(values["altitude_m"])  # type: ignore[arg-type]
    assert values["nav_frame"] == "1e5x"


@pytest.mark.parametrize("empty", ["ros__parameters:\n", "ros__parameters: {}\n"])
def test_a_section_may_be_empty(tmp_path: Path, empty: str) -> None:
    assert read(tmp_path, f"swing_align:\n  {empty}") == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not a ROS 2 parameter file"),
        ("# nothing\n", "not a ROS 2 parameter file"),
        ("- a\n- b\n", "not a ROS 2 parameter file"),
        ("latitude_deg: 40\n", "has no section for swing_align"),
        (OTHER_SECTION, "has no section for swing_align"),
        ("odo_align:\n  ros__parameters: {}\n", "has no section for swing_align"),
        ("1: 2\n", "has no section for swing_align"),
        ("/**:\n  latitude_deg: 40\n", "/\\*\\*: 'ros__parameters' is expected"),
        ("/**:\n  ros__parameters: {}\n  a: 1\n", "'ros__parameters' is expected, and only that"),
        ("/**:\n", "'ros__parameters' is expected"),
        ("/**:\n  ros__parameters: [1, 2]\n", "a map of names is expected"),
        ("/**:\n  ros__parameters: 40\n", "a map of names is expected"),
        ("/**:\n  ros__parameters: {a: [1\n", "no valid YAML"),
        ("/**:\n\tros__parameters: {}\n", "no valid YAML"),
        ("a: 1\n---\nb: 2\n", "no valid YAML"),
        ("/**: !!python/object:os.system {}\n", "no valid YAML"),
        (b"\xff\xfe\x00", "cannot be read"),
        (b"a: \x00\n", "no valid YAML"),
    ],
)
def test_files_that_fail(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as caught:
        read(tmp_path, text)
    assert "params.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    for path in (tmp_path / "nothing.yaml", tmp_path):
        with pytest.raises(ConfigError, match="cannot be read"):
            read_parameter_file(path, NODE)


def test_wrong_keys_in_a_file_fail_by_name(tmp_path: Path) -> None:
    values = read(tmp_path, "/**:\n  ros__parameters: {imu: {rate: 1}, 7: 8}\n")
    for key in values:
        with pytest.raises(ConfigError, match=f"{key}: unknown parameter"):
            check_values(NODE, {key: values[key]})


def test_shipped_config_names_what_is_missing() -> None:
    with pytest.raises(FileNotFoundError, match=r"no_such\.yaml"):
        shipped_config("no_such.yaml")
    document = yaml.safe_load(shipped_config("imu_grades.yaml").read_text())
    assert set(document) == set(grade_names())
