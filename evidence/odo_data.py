"""The real recordings: a parked laser gyro, and a drive in a town with an IMU of 1 deg/h."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from evidence.checks import Case, Cases, Check, upper
from evidence.odo_recording import Moment, RecordedSession
from evidence.odo_runs import false_claims
from sins_align.config import OdoConfig, odo_config
from sins_align.config_path import shipped_config
from sins_align.parameters import read_parameter_file
from sins_align.rotation import heading_from_yaw, rpy_from_dcm
from sins_align.session import Update
from sins_align.types import Array, ImuSamples, OdometerSamples, Position
from sins_align.units import ARCMIN, DEG

DATA = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
KINGSTON, KINGSTON_REFERENCE = DATA / "kingston_a", DATA / "kingston_a_reference.csv"
LASERGYRO = DATA / "lasergyro_a"

STARTS_S = (0, 300, 500, 600, 700, 900)
WINDOW_S = 600
REFERENCE_NS = 1_700_000_000 * 10**9
LASERGYRO_HEADING_DEG = 90.60


class Recording(NamedTuple):
    """What a bag holds; odometer: empty where there is none."""

    imu: ImuSamples
    odometer: OdometerSamples
    position: Position


def read_recording(path: Path) -> Recording:
    """All of a bag, with the position of its first fix."""
    from sins_align.ros.bags import open_bag

    with open_bag([path]) as bag:
        parts = list(bag.read_imu(bag.find_topic("imu").name))
        imu = ImuSamples(
            *(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True))
        )
        odom = bag.find_optional_topic("odom")
        nothing = OdometerSamples(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        odometer = nothing if odom is None else bag.read_odometer(odom.name).samples
        position = bag.read_fix(bag.find_topic("fix").name)
    assert position is not None
    return Recording(imu, odometer, position)


def window(data: Recording, start_s: float, duration_s: float) -> Recording:
    """The part of it that begins so long after the first IMU sample."""
    begin = int(data.imu.stamp_ns[0]) + round(start_s * 1e9)
    end = begin + round(duration_s * 1e9)

    def within(stamps: Array) -> Array:
        return (stamps >= begin) & (stamps <= end)

    return Recording(
        data.imu.select(within(data.imu.stamp_ns)),
        data.odometer.select(within(data.odometer.stamp_ns)),
        data.position,
    )


def kingston_config(position: Position, **changes: object) -> OdoConfig:
    """The shipped file, at the place of the first fix."""
    values = read_parameter_file(shipped_config("odo_kingston.yaml"), "odo_align")
    return odo_config({**values, **_place(position), **changes})


def lasergyro_config(position: Position, **changes: object) -> OdoConfig:
    """For a parked laser gyro."""
    values = {"aiding": "stationary", "imu_sampling": "mean", "imu_grade": "rlg_parked"}
    return odo_config({**values, **_place(position), **changes})


def _place(position: Position) -> Mapping[str, Any]:
    return {
        "latitude_deg": position.latitude / DEG,
        "longitude_deg": position.longitude / DEG,
        "altitude_m": position.altitude,
    }


def align_recording(data: Recording, config: OdoConfig) -> tuple[RecordedSession, list[Update]]:
    """All of it through the session."""
    session = RecordedSession(config)
    updates = [] if config.stationary else session.add_odometer(data.odometer)
    return session, updates + session.add_imu(data.imu)


def heading_of(moment: Moment) -> float:
    """Clockwise from north [rad]."""
    return heading_from_yaw(rpy_from_dcm(moment.C_nb)[2])


def kingston_heading(stamp_ns: Array) -> Array:
    """The reference at the stamps [rad]."""
    table = np.genfromtxt(KINGSTON_REFERENCE, delimiter=",", names=True)
    time_s = table["unix_s"] - REFERENCE_NS * 1e-9
    heading = np.unwrap(np.radians(table["heading_deg"]))
    return np.interp((stamp_ns - REFERENCE_NS) * 1e-9, time_s, heading)


def wrap(angle: Array) -> Array:
    """To -pi..pi."""
    return (angle + math.pi) % math.tau - math.pi


def recordings(seeds: int) -> Cases:
    """Real data: kingston_a with the shipped settings, lasergyro_a without an odometer."""
    del seeds
    if DATA.is_dir():
        for method in ("wander_kf", "sghf"):
            yield from _kingston(method)
            yield _lasergyro(method)
    else:
        yield Case(f"skipped: there is no {DATA}", 0, [], [])


def _kingston(method: str) -> Cases:
    whole = read_recording(KINGSTON)
    for start_s in STARTS_S:
        data = window(whole, start_s, WINDOW_S)
        config = kingston_config(whole.position, method=method)
        session, updates = align_recording(data, config)
        moments = session.moments
        stamps = np.array([m.stamp_ns for m in moments])
        time_s = (stamps - int(data.imu.stamp_ns[0])) * 1e-9
        headings = np.array([heading_of(m) for m in moments])
        error = wrap(headings - kingston_heading(stamps)) / DEG
        sigma = np.array([math.sqrt(m.covariance[2, 2]) for m in moments]) / DEG
        fine = (sigma < 2.0) & np.array([m.published for m in moments])
        strict, strict_updates = align_recording(data, kingston_config(
            whole.position, method=method, heading_threshold_arcmin=30.0))  # fmt: skip
        wrong = false_claims(updates, config) + false_claims(strict_updates, strict.config)
        ratio = np.abs(error / sigma)[fine].max() if fine.any() else 0.0
        scale, scale_sigma = moments[-1].scale
        lines = [
            f"      {t:4d} s  error {error[k]:8.3f} deg  sigma {sigma[k]:8.3f} deg"
            f"  consistency {moments[k].consistency:5.2f}  scale {100 * moments[k].scale[0]:6.2f} %"
            for t in (60, 120, 300, 450, 600)
            for k in (int(np.abs(time_s - t).argmin()),)
        ]
        first = f"{time_s[fine][0]:.0f} s" if fine.any() else "never"
        lines.append(
            f"      sigma below 2 deg from {first}; {session.status.state.value},"
            f" aligned at {session.status.aligned_at_s} s; refused {session.counts.odom_rejected}"
            f" odometer samples; scale sigma {100 * scale_sigma:.2f} %"
        )
        checks = [
            upper("largest error / sigma once sigma < 2 deg", ratio, 2.5),
            upper("heading error at the end [deg]", error[-1], 2.5),
            Check("scale error [%]", 100.0 * scale, -1.5, -0.5),
            upper("claims of alignment above the threshold", wrong, 0.0),
        ]
        yield Case(f"{method}, kingston_a from {start_s} s", 1, lines, checks)


def _lasergyro(method: str) -> Case:
    data = read_recording(LASERGYRO)
    config = lasergyro_config(data.position, method=method)
    session, updates = align_recording(data, config)
    moments = session.moments
    lines, checks = [], []
    for t in (30, 60, 120, 180, 300, 540):
        elapsed = [(m.stamp_ns - int(data.imu.stamp_ns[0])) * 1e-9 for m in moments]
        moment = moments[int(np.abs(np.array(elapsed) - t).argmin())]
        error = float(wrap(heading_of(moment) - LASERGYRO_HEADING_DEG * DEG)) / ARCMIN
        sigma = math.sqrt(moment.covariance[2, 2]) / ARCMIN
        roll, pitch, _ = np.degrees(rpy_from_dcm(moment.C_nb))
        lines.append(
            f"      {t:4d} s  heading error {error:7.2f}'  sigma {sigma:6.2f}'"
            f"  roll {roll:7.4f}  pitch {pitch:7.4f} deg  consistency {moment.consistency:.2f}"
        )
        if t == 300:
            checks = [
                upper("heading error at 300 s [']", error, 6.0),
                upper("heading error at 300 s / sigma", error / sigma, 3.0),
            ]
    wrong = false_claims(updates, config)
    checks.append(upper("claims of alignment above the threshold", wrong, 0.0))
    return Case(f"{method}, lasergyro_a, aiding: stationary", 1, lines, checks)


SECTIONS = (recordings,)
