"""The figures of swing alignment: Mu and Fang's tables, and what the README claims.

`python evidence/run.py` prints each row with its bound, and exits 1 where one is broken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from evidence.checks import Case, Cases, Check, upper
from evidence.monte_carlo import Outcome, heading_nees, make_config, monte_carlo
from sins_align.simulate import SCENARIOS, SwingOptions, simulate_swing
from sins_align.swing.paper import PaperAligner
from sins_align.types import Array, ImuBlock

RIGID = {"position_noise_m": 1e-6}


def _axes(outcomes: list[Outcome], what: Callable[[Outcome], Array]) -> Array:
    return np.array([what(o) for o in outcomes])


def misalignment_deg(outcomes: list[Outcome]) -> Array:
    """(runs, 3) east, north, up [deg]."""
    return np.degrees(_axes(outcomes, lambda o: o.misalignment))


def lever_mm(outcomes: list[Outcome]) -> Array:
    """(runs, 3) in the paper's axes [mm]."""
    return 1e3 * _axes(outcomes, lambda o: o.lever_error_paper)


def lines(outcomes: list[Outcome]) -> Iterable[str]:
    """Mean, SD, RMS and the claimed sigma, of attitude and lever arm."""
    for name, unit, errors, sigma in (
        ("misalignment E N U", "deg", misalignment_deg(outcomes),
         np.degrees(_axes(outcomes, lambda o: o.sigma))),
        ("lever arm x y z", "mm", lever_mm(outcomes),
         1e3 * _axes(outcomes, lambda o: o.lever_sigma_paper)),
    ):  # fmt: skip
        rows = (
            ("mean", errors.mean(axis=0)),
            ("SD", errors.std(axis=0, ddof=1)),
            ("RMS", np.sqrt((errors**2).mean(axis=0))),
            ("sigma", sigma.mean(axis=0)),
        )
        for what, values in rows:
            text = " ".join(f"{v:11.4g}" for v in values)
            yield f"    {name:20s} {what:6s} {text} {unit}"


def make_case(name: str, outcomes: list[Outcome], checks: list[Check]) -> Case:
    """A case with its statistics, where there are runs."""
    return Case(name, len(outcomes), list(lines(outcomes)) if outcomes else [], checks)


def nees_checks(outcomes: list[Outcome], low: float, high: float) -> list[Check]:
    """Mean NEES of the attitude over 3, and of heading alone."""
    return [
        Check("NEES/3", float(np.mean([o.nees for o in outcomes])) / 3.0, low, high),
        Check("heading NEES", heading_nees(outcomes), low, high),
    ]


def paper_tables(seeds: int) -> Cases:
    """Tables 1 and 2: method paper, start wrong by (10, 10, 10) deg."""
    for scenario, switches in (("pitch", [15.0, 30.0, 70.0]), ("erect", [15.0, 30.0])):
        for differentiator in ("eso", "central"):
            parameters: dict[str, Any] = {
                "method": "paper", "differentiator": differentiator, "switch_times_s": switches
            }  # fmt: skip
            options = SwingOptions(scenario=scenario, rate_hz=1000.0)
            outcomes = monte_carlo(options, parameters, range(seeds), start_error_deg=10.0)
            lever, phi = lever_mm(outcomes), misalignment_deg(outcomes)
            checks = []
            if scenario == "pitch":
                for axis, bound in enumerate((0.0026, 0.0019, 0.0039)):
                    checks.append(
                        upper(f"Table 1 SD {'ENU'[axis]} [deg]", phi[:, axis].std(), bound)
                    )
                checks.append(upper("Table 1 lever SD [mm]", lever.std(axis=0).max(), 0.3))
            elif differentiator == "eso":
                checks.append(Check("Table 2 lever bias x [mm]", lever[:, 0].mean(), -1.25, -0.95))
                checks.append(Check("Table 2 lever bias z [mm]", lever[:, 2].mean(), 1.35, 1.65))
            else:
                worst = np.abs(lever.mean(axis=0)).max()
                checks.append(upper("lever bias, central [mm]", worst, 0.1))
            yield make_case(f"paper, {scenario}, {differentiator}, 1 kHz", outcomes, checks)


FIGURE_3_TIMES_S = (10, 20, 40, 80, 120)


def _lever_errors(seed: int, regression: str) -> list[float]:
    """Length of the lever arm's error at the corrections of the level phase [mm]."""
    simulated = simulate_swing(SwingOptions(seed=seed, rate_hz=1000.0, duration_s=121.0))
    config = make_config(simulated, {"method": "paper", "regression": regression}, 10.0)
    assert config.position is not None
    aligner = PaperAligner(config, config.position)
    truth = np.asarray(simulated.truth.lever_arm_m)
    errors = []
    for second in range(max(FIGURE_3_TIMES_S)):
        part = slice(1000 * second, 1000 * (second + 1) + 1)
        aligner.update(ImuBlock(*simulated.imu.select(part)))
        if second + 1 in FIGURE_3_TIMES_S:
            errors.append(1e3 * float(np.linalg.norm(aligner.lever_arm.r_b - truth)))
    return errors


def paper_figure_3(seeds: int) -> Cases:
    """Fig. 3: the lever arm in the level phase, with (EPLS) and without (LS) misalignment."""
    medians = {}
    for regression in ("epls", "ls"):
        runs = Parallel(n_jobs=2)(delayed(_lever_errors)(s, regression) for s in range(seeds))
        medians[regression] = np.median(np.array(runs), axis=0)
        text = " ".join(f"{v:10.3g}" for v in medians[regression])
        print(f"  {regression:5s} median |error| at {FIGURE_3_TIMES_S} s: {text} mm")
    ratio = float(medians["epls"][-1] / medians["ls"][-1])
    yield make_case("paper, Fig. 3", [], [upper("EPLS over LS at 120 s", ratio, 0.05)])


def inertial_rigid(seeds: int) -> Cases:
    """Method inertial on a rigid centre with the paper's noise: the Cramer-Rao bound."""
    cases = [("pitch", rate, 0.0) for rate in (1000.0, 200.0, 100.0)]
    cases += [("erect", rate, 0.0) for rate in (1000.0, 200.0, 100.0)]
    cases += [("pitch", 100.0, heading) for heading in (90.0, 180.0, 270.0)]
    for scenario, rate, heading in cases:
        options = SwingOptions(scenario=scenario, rate_hz=rate, heading_deg=heading)
        outcomes = monte_carlo(options, RIGID, range(seeds))
        lever, phi = lever_mm(outcomes) * 1e3, misalignment_deg(outcomes)
        checks = [
            upper("lever |mean| [um]", np.abs(lever.mean(axis=0)).max(), 5.0),
            upper("lever SD [um]", lever.std(axis=0).max(), 10.0),
            upper("level SD [deg]", phi[:, :2].std(axis=0).max(), 6e-6),
            upper("heading SD [deg]", phi[:, 2].std(), 3.0e-4),
            upper("heading max [deg]", np.abs(phi[:, 2]).max(), 1e-3),
            Check("NEES/3", float(np.mean([o.nees for o in outcomes])) / 3.0, 0.55, 1.55),
        ]
        yield make_case(f"inertial, {scenario}, {rate:g} Hz, heading {heading:g}", outcomes, checks)


def inertial_grades(seeds: int) -> Cases:
    """Accuracy by grade on a rigid centre, with the bounds of the README."""
    for grade, heading, level, lever in (
        ("rlg", 0.025, 0.001, 0.3),
        ("fog_noisy", 0.18, 0.004, 1.2),
    ):
        options = SwingOptions(scenario="pitch", grade=grade, rate_hz=100.0)
        outcomes = monte_carlo(options, RIGID, range(seeds))
        phi = np.sqrt((misalignment_deg(outcomes) ** 2).mean(axis=0))
        lever_rms = np.sqrt((lever_mm(outcomes) ** 2).mean(axis=0))
        checks = [
            upper("heading RMS [deg]", phi[2], heading),
            upper("level RMS [deg]", phi[:2].max(), level),
            upper("lever RMS [mm]", lever_rms.max(), lever),
        ]
        yield make_case(f"inertial, pitch, {grade}, rigid centre", outcomes, checks)


def inertial_nees(seeds: int) -> Cases:
    """Honesty of sigma at the default position noise."""
    for grade in ("tactical", "fog", "rlg"):
        for scenario in ("pitch", "erect", "still"):
            for duration in (60.0, 120.0, 420.0):
                options = SwingOptions(
                    scenario=scenario, grade=grade, rate_hz=100.0, duration_s=duration
                )
                outcomes = monte_carlo(options, {}, range(seeds))
                checks = nees_checks(outcomes, 0.6, 1.5)
                yield make_case(f"inertial, {scenario}, {grade}, {duration:g} s", outcomes, checks)


def _covered(outcomes: list[Outcome]) -> float:
    """Largest heading error over its sigma."""
    return max(abs(float(o.misalignment[2] / o.sigma[2])) for o in outcomes)


def inertial_cases(seeds: int) -> Cases:
    """A turn of the base, heave, lost samples, a single axis, levers, latitudes."""
    turn = SwingOptions(grade="tactical", rate_hz=100.0, turn_deg=90.0)
    outcomes = monte_carlo(turn, {}, range(seeds))
    yield make_case(
        "inertial, tactical, turn of 90 deg",
        outcomes,
        [Check("heading NEES", heading_nees(outcomes), 0.6, 1.5)],
    )
    # Long runs with a large bias are where a false heading information would show.
    for scenario in ("still", "pitch"):
        long = SwingOptions(scenario=scenario, grade="tactical", rate_hz=100.0, duration_s=1200.0)
        outcomes = monte_carlo(long, {}, range(seeds))
        yield make_case(
            f"inertial, tactical, {scenario}, 1200 s",
            outcomes,
            [Check("heading NEES", heading_nees(outcomes), 0.6, 1.7)],
        )
    # Too weak a swing to tell the lever arm, strong enough for it to disturb.
    weak = replace(SCENARIOS["level"], amplitude_deg=(0.35, 0.35, 0.35))
    for duration in (60.0, 420.0):
        options = SwingOptions(scenario=weak, grade="rlg", rate_hz=100.0, duration_s=duration)
        outcomes = monte_carlo(options, {}, range(seeds))
        yield make_case(
            f"inertial, swing of 0.35 deg, rlg, {duration:g} s",
            outcomes,
            [upper("largest heading error / sigma", _covered(outcomes), 4.0)],
        )
    plain = SwingOptions(rate_hz=100.0)
    cases: list[tuple[str, dict[str, Any], dict[str, Any], float]] = [
        ("heave 3 cm, default parameters", {"heave_m": 0.03}, {}, 2e-3),
        ("1 % of samples lost", {"lost_fraction": 0.01}, RIGID, 8e-4),
        ("single axis", {"scenario": "single_axis"}, RIGID, 5e-4),
        ("lever 0 m", {"lever_arm_m": (0.0, 0.0, 0.0)}, RIGID, 1e-3),
        ("lever 30 m", {"lever_arm_m": (20.0, -20.0, 10.0)}, RIGID, 1e-3),
        ("latitude -35 deg", {"latitude_deg": -35.0}, RIGID, 1e-3),
        ("latitude 75 deg", {"latitude_deg": 75.0}, RIGID, 3e-3),
    ]
    for name, changes, parameters, bound in cases:
        options = SwingOptions(**{**vars(plain), **changes})
        outcomes = monte_carlo(options, parameters, range(seeds))
        phi = misalignment_deg(outcomes)
        rms = float(np.sqrt((phi[:, 2] ** 2).mean()))
        checks = [
            upper("heading RMS [deg]", rms, bound),
            upper("largest heading error / sigma", _covered(outcomes), 4.0),
        ]
        if name == "single axis":
            flagged = sum(o.lever_observable == (False, True, True) for o in outcomes)
            checks.append(Check("runs that flag the lost direction", flagged, seeds, seeds))
        yield make_case(f"inertial, {name}", outcomes, checks)


SECTIONS = (
    paper_tables,
    paper_figure_3,
    inertial_rigid,
    inertial_grades,
    inertial_nees,
    inertial_cases,
)
