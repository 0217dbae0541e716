"""What sensors, latitude and time allow, against the textbook and against the filter."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from swing_filtered import LATITUDE_DEG, OPTIONS, filter_run, still_grade

from sins_align.grades import ImuGrade, load_grade
from sins_align.limits import heading_limit, latitude_differs, level_limit
from sins_align.types import LatitudeEstimate
from sins_align.units import ARCMIN, ARCSEC, DEG, DEG_PER_H, DEG_PER_SQRT_H, MICRO_G

LATITUDE = LATITUDE_DEG * DEG
HORIZONTAL = 15.041067 * DEG_PER_H * math.cos(LATITUDE)  # of the Earth's rate [rad/s]


def test_the_bias_is_the_limit_that_time_does_not_mend() -> None:
    """Issue's own example: 0.02 deg/h at mid latitude, 6 minutes of arc."""
    grade = ImuGrade(gyro_bias=0.02 * DEG_PER_H)
    assert heading_limit(grade, LATITUDE) == pytest.approx(0.02 * DEG_PER_H / HORIZONTAL, rel=1e-6)
    assert heading_limit(grade, LATITUDE) == pytest.approx(5.97 * ARCMIN, rel=1e-3)
    assert heading_limit(grade, LATITUDE, 1.0) == heading_limit(grade, LATITUDE, 1e6)


def test_the_instability_adds_in_squares() -> None:
    grade = ImuGrade(gyro_bias=3e-7, gyro_bias_instability=4e-7)
    assert heading_limit(grade, LATITUDE) == pytest.approx(5e-7 / HORIZONTAL, rel=1e-6)


@pytest.mark.parametrize("time_s", [10.0, 60.0, 600.0])
def test_the_gyro_noise_falls_with_the_root_of_time(time_s: float) -> None:
    grade = ImuGrade(gyro_arw=0.002 * DEG_PER_SQRT_H)
    expected = 0.002 * DEG_PER_SQRT_H / (HORIZONTAL * math.sqrt(time_s))
    assert heading_limit(grade, LATITUDE, time_s) == pytest.approx(expected, rel=1e-6)
    assert heading_limit(grade, LATITUDE) == 0.0


@pytest.mark.parametrize("time_s", [10.0, 60.0, 600.0])
def test_the_accelerometer_noise_falls_with_its_cube(time_s: float) -> None:
    """Slope of a velocity: sigma = sqrt(12 / T^3) VRW / (g Omega cos L), in radians."""
    vrw = 20.0 * MICRO_G
    expected = math.sqrt(12.0 / time_s**3) * vrw / (9.78 * HORIZONTAL)
    grade = ImuGrade(accel_vrw=vrw)
    assert heading_limit(grade, LATITUDE, time_s) == pytest.approx(expected, rel=1e-3)


def test_the_terms_add_in_squares() -> None:
    grade, time_s = load_grade("fog"), 100.0
    alone = [
        ImuGrade(**{name: getattr(grade, name)})
        for name in ("gyro_bias", "gyro_bias_instability", "gyro_arw", "accel_vrw")
    ]
    parts = [heading_limit(one, LATITUDE, time_s) for one in alone]
    assert min(parts) > 0.0
    assert heading_limit(grade, LATITUDE, time_s) == pytest.approx(math.hypot(*parts))


def test_latitude_only_by_its_cosine() -> None:
    grade = load_grade("rlg")
    equator = heading_limit(grade, 0.0, 100.0)
    for degrees in (-60.0, 60.0):
        assert heading_limit(grade, degrees * DEG, 100.0) == pytest.approx(2.0 * equator)


@pytest.mark.parametrize("latitude", [0.5 * math.pi, -0.5 * math.pi])
def test_no_limit_at_the_pole(latitude: float) -> None:
    assert math.isnan(heading_limit(load_grade("rlg"), latitude, 100.0))


@pytest.mark.parametrize("time_s", [0.0, -1.0, math.nan])
def test_no_limit_at_no_time(time_s: float) -> None:
    assert math.isnan(heading_limit(load_grade("rlg"), LATITUDE, time_s))


@pytest.mark.parametrize("name", ["rlg", "fog_noisy", "fog", "tactical", "paper_odo"])
@pytest.mark.parametrize("duration_s", [120.0, 240.0])
def test_the_filter_gets_there_on_a_still_base(name: str, duration_s: float) -> None:
    """Neither better than the limit, nor much worse: the centre's noise is in the filter only."""
    grade = still_grade(load_grade(name))
    options = replace(OPTIONS, scenario="still", grade=grade, duration_s=duration_s)
    filtered = filter_run(options)
    found = filtered.heading_sigma(filtered.filter)
    limit = heading_limit(grade, LATITUDE, duration_s)
    assert 0.97 < found / limit < 1.1


def test_level_limit() -> None:
    assert level_limit(ImuGrade(accel_bias=100.0 * MICRO_G)) == pytest.approx(
        1e-4 * 9.80665 / 9.7803, rel=1e-4
    )
    assert level_limit(ImuGrade(accel_bias=100.0 * MICRO_G)) == pytest.approx(
        20.68 * ARCSEC, rel=1e-3
    )


@pytest.mark.parametrize(("sigma_deg", "bound_deg"), [(0.0, 0.1), (0.02, 0.1), (0.03, 0.15)])
def test_latitude_differs(sigma_deg: float, bound_deg: float) -> None:
    for share, differs in ((0.999, False), (1.001, True), (-0.999, False), (-1.001, True)):
        own = LatitudeEstimate(LATITUDE + share * bound_deg * DEG, sigma_deg * DEG)
        assert latitude_differs(LATITUDE, own) is differs
