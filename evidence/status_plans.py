"""Draws by number what a run of `swing_align` or `odo_align` is: scenario, grade, place, faults."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from evidence.status_runs import Impulse, Plan
from sins_align.grades import ImuGrade, load_grade
from sins_align.limits import heading_limit, level_limit
from sins_align.simulate import VehicleOptions
from sins_align.units import ARCMIN, ARCSEC, DEG

GRADES = ("rlg", "fog", "fog_noisy", "tactical", "rlg_parked")
MOST_LATITUDE_DEG = 65.0
# Thresholds are so many times what the declared sensors allow a base that stands so long [s].
FACTORS, STANDING_S = (1.2, 3.0), 200.0
# How likely a run has faults, and if so one, two or three.
FAULTY = 0.5
HOW_MANY = (0.6, 0.3, 0.1)


class Dice:
    """Random figures of one run.

    run_seed : for the simulator; no other run's, or both nodes would get the same sensors
    """

    def __init__(self, *seed: int) -> None:
        self.stream = np.random.default_rng(seed)
        self.run_seed = int(np.random.SeedSequence(seed).generate_state(1)[0])

    def between(self, low: float, high: float) -> float:
        """Uniform."""
        return float(self.stream.uniform(low, high))

    def size(self, low: float, high: float) -> float:
        """Uniform in the logarithm: a small one is as likely as a large one."""
        return math.exp(self.between(math.log(low), math.log(high)))

    def sign(self) -> float:
        """-1 or 1."""
        return 1.0 if self.stream.random() < 0.5 else -1.0

    def happens(self, chance: float) -> bool:
        """True by that chance."""
        return bool(self.stream.random() < chance)

    def one_of(self, names: tuple[str, ...]) -> str:
        """Any of them."""
        return names[int(self.stream.integers(len(names)))]

    def how_many(self) -> int:
        """Number of faults of a run."""
        if not self.happens(FAULTY):
            return 0
        return 1 + int(self.stream.choice(len(HOW_MANY), p=HOW_MANY))

    def normal(self, sigma: float) -> tuple[float, float, float]:
        """Three numbers."""
        x, y, z = (sigma * self.stream.standard_normal(3)).tolist()
        return x, y, z


@dataclass
class Draft:
    """A plan in the making: what the faults change.

    options : of the simulator; parameters : of the node; more : of `Plan`
    """

    dice: Dice
    scenario: str
    grade: str
    options: dict[str, Any]
    parameters: dict[str, Any]
    more: dict[str, Any] = field(default_factory=dict)

    def worsen(self, **changes: Any) -> None:
        """The sensors are not what is declared."""
        self.options["grade"] = replace(self.options["grade"], **changes)

    @property
    def sensors(self) -> ImuGrade:
        """What is simulated."""
        return self.options["grade"]

    def moment(self) -> float:
        """Any time that leaves something before and after it [s]."""
        return self.dice.between(20.0, 0.9 * self.options["duration_s"])


def draw_common(dice: Dice, duration: tuple[float, float]) -> Draft:
    """IMU, place and thresholds; what is declared is right."""
    grade = dice.one_of(GRADES)
    latitude = dice.between(-MOST_LATITUDE_DEG, MOST_LATITUDE_DEG)
    sampling = dice.one_of(("mean", "instantaneous"))
    options: dict[str, Any] = {
        "seed": dice.run_seed,
        "grade": load_grade(grade),
        "rate_hz": 50.0 if dice.happens(0.5) else 100.0,
        "duration_s": round(dice.between(*duration)),
        "latitude_deg": latitude,
        "heading_deg": dice.between(0.0, 360.0),
        "sampling": sampling,
    }
    heading = heading_limit(load_grade(grade), latitude * DEG, STANDING_S)
    level = level_limit(load_grade(grade))
    parameters = {
        "latitude_deg": latitude,
        "altitude_m": VehicleOptions().altitude_m,
        "imu_grade": grade,
        "imu_sampling": sampling,
        "heading_threshold_arcmin": dice.between(*FACTORS) * heading / ARCMIN,
        "level_threshold_arcsec": dice.between(*FACTORS) * level / ARCSEC,
    }
    return Draft(dice, "", grade, options, parameters)


def draw_faults(draft: Draft, faults: Mapping[str, Any]) -> tuple[str, ...]:
    """Let some of the faults happen; what they are."""
    count = draft.dice.how_many()
    kinds = draft.dice.stream.permutation(len(faults))[:count]
    names = list(faults)
    return tuple(f"{names[k]}: {faults[names[k]](draft)}" for k in kinds)


def lost_samples(draft: Draft) -> str:
    """IMU samples lost at random."""
    draft.options["lost_fraction"] = share = draft.dice.size(0.001, 0.1)
    return f"{100.0 * share:.1f} %"


def stamp_jitter(draft: Draft) -> str:
    """Of the IMU."""
    jitter = draft.dice.size(0.01, 0.25) / draft.options["rate_hz"]
    draft.options["stamp_jitter_s"] = jitter
    return f"{1e3 * jitter:.2f} ms"


def gap(draft: Draft) -> str:
    """No IMU samples for a while."""
    draft.more["gap"] = begin, length = draft.moment(), draft.dice.size(0.05, 5.0)
    return f"{length:.2f} s at {begin:.0f} s"


def wrong_sampling(draft: Draft) -> str:
    """The other imu_sampling."""
    true = draft.options["sampling"]
    said = "mean" if true == "instantaneous" else "instantaneous"
    draft.parameters["imu_sampling"] = said
    return f"{true}, said to be {said}, {draft.options['rate_hz']:.0f} Hz"


def gyro_noise(draft: Draft) -> str:
    """Beyond the declared grade."""
    factor = draft.dice.size(2.0, 10.0)
    draft.worsen(gyro_arw=factor * draft.sensors.gyro_arw)
    return f"{factor:.1f} times"


def gyro_bias(draft: Draft) -> str:
    """Beyond the declared grade."""
    factor = draft.dice.size(2.0, 10.0)
    draft.worsen(gyro_bias=factor * draft.sensors.gyro_bias)
    return f"{factor:.1f} times"


def wrong_latitude(draft: Draft) -> str:
    """By up to 1 deg."""
    off = draft.dice.between(-1.0, 1.0)
    draft.parameters["latitude_deg"] += off
    return f"{off:+.2f} deg"


def impulse(draft: Draft) -> str:
    """Someone jumps on the base."""
    dice = draft.dice
    azimuth = dice.between(0.0, math.tau)
    jump = Impulse(
        begin_s=draft.moment(),
        length_s=dice.between(0.3, 1.5),
        axis_b=(math.cos(azimuth), math.sin(azimuth), 0.0),
        tilt=dice.size(0.02, 1.0) * DEG,
        heave=dice.size(0.001, 0.03),
    )
    draft.more["impulse"] = jump
    return (
        f"{jump.tilt / DEG:.2f} deg, {1e3 * jump.heave:.0f} mm for {jump.length_s:.1f} s"
        f" at {jump.begin_s:.0f} s"
    )


IMU_FAULTS: Mapping[str, Any] = {
    "lost samples": lost_samples,
    "stamp jitter": stamp_jitter,
    "gap": gap,
    "imu_sampling": wrong_sampling,
    "gyro noise": gyro_noise,
    "gyro bias": gyro_bias,
    "latitude": wrong_latitude,
}


def make_plan(draft: Draft, number: int, options: Any, faults: tuple[str, ...]) -> Plan:
    """The plan of a draft; `options` is the class of the simulator's."""
    return Plan(
        number, draft.scenario, draft.grade, options(**draft.options), draft.parameters, faults,
        **draft.more,
    )  # fmt: skip
