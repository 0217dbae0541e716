"""Speed: CPU time a sample, each figure beside a peer measured in the same run.

The machine is part of every figure: the first lines say how long this one takes for what
everybody can repeat. Run on an idle machine; medians are printed, and the least.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from benchmarks.live_node import measure_live  # noqa: E402
from sins_align.config import odo_config, swing_config  # noqa: E402
from sins_align.ros.bags import open_bag  # noqa: E402
from sins_align.ros.bags_write import ImuBagWriter  # noqa: E402
from sins_align.session import Session  # noqa: E402
from sins_align.simulate import (  # noqa: E402
    SwingOptions,
    VehicleOptions,
    VehicleRun,
    simulate_swing,
    simulate_vehicle,
)
from sins_align.types import ImuSamples, Position  # noqa: E402

DURATION_S = 420.0
DRIVE_S = 900.0
LATITUDE = np.radians(40.0)


def cpu_times(action: Callable[[], object], runs: int = 7) -> tuple[float, float]:
    """Median and least CPU time of `action` after one run to warm up [s]."""
    action()
    times = []
    for _ in range(runs):
        begin = time.process_time()
        action()
        times.append(time.process_time() - begin)
    return statistics.median(times), min(times)


def report(what: str, per: int, times: tuple[float, float]) -> None:
    """Print total and per-item figures."""
    median, least = times
    print(f"{what:58s} {median * 1e6 / per:8.3f} us (least {least * 1e6 / per:.3f})")


def mechanise_one_by_one(samples: ImuSamples) -> np.ndarray:
    """The peer: attitude and velocity, one numpy update a sample, as textbooks print it."""
    C, v, h = np.eye(3), np.zeros(3), 1e-3
    for w, f in zip(samples.w_ib_b.T, samples.f_ib_b.T, strict=True):
        x, y, z = w * h
        C = C @ (np.eye(3) + np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
        v = v + C @ f * h
    return v


def repeat_20000(action: Callable[[], object]) -> None:
    """Call it so often."""
    for _ in range(20000):
        action()


def bench_machine() -> None:
    """What the figures below are to be seen against."""
    a, b = np.random.default_rng(0).normal(size=(2, 12, 12))
    report("machine: numpy product of two 12x12 matrices", 20000,
           cpu_times(lambda: repeat_20000(lambda: a @ b)))  # fmt: skip
    x = np.zeros(3)
    report("machine: numpy sum of two 3-vectors", 20000,
           cpu_times(lambda: repeat_20000(lambda: x + x)))  # fmt: skip


def bench_estimation() -> None:
    """The session on samples in memory."""
    for method, runs in (("inertial", 7), ("paper", 2)):
        for rate in (1000.0, 100.0):
            imu = simulate_swing(SwingOptions(rate_hz=rate, duration_s=DURATION_S)).imu
            config = swing_config(
                {"method": method, "latitude_deg": 40.0, "imu_grade": "paper_swing"}
            )

            def estimate(imu: ImuSamples = imu, config: object = config) -> object:
                session = Session(config)
                session.add_imu(imu)
                return session.conclusion

            times = cpu_times(estimate, runs)
            report(f"estimation, {method}, {rate:g} Hz, per sample", len(imu), times)
            print(f"{'':58s} {times[0]:8.3f} s for {DURATION_S:g} s of data")
    part = imu.select(slice(0, 5000))
    times = cpu_times(lambda: mechanise_one_by_one(part), 3)
    report("peer: mechanisation alone, numpy, sample by sample", len(part), times)


# The methods of odo_align, with the parameters that differ from the defaults.
ODO_METHODS = {
    "sghf, with its witness": {"method": "sghf"},
    "sghf, coarse: inertial": {"method": "sghf", "coarse": "inertial"},
    "wander_kf": {"method": "wander_kf"},
    "wander_ekf": {"method": "wander_ekf"},
    "ghf, with its witness": {"method": "ghf"},
    "ckf, with its witness": {"method": "ckf"},
    "ekf, with its witness": {"method": "ekf"},
    "ukf, with its witness": {"method": "ukf"},
}
AT_100_HZ = 3  # the first of them


def bench_odometer() -> None:
    """The session on a drive in memory: IMU at a rate, odometer at 20 Hz, one core."""
    for rate, count in ((200.0, len(ODO_METHODS)), (100.0, AT_100_HZ)):
        drive = simulate_vehicle(VehicleOptions(scenario="ring", rate_hz=rate, duration_s=DRIVE_S))
        for name, parameters in list(ODO_METHODS.items())[:count]:
            config = odo_config({**parameters, "latitude_deg": 40.0, "imu_grade": "fog"})

            def estimate(drive: VehicleRun = drive, config: object = config) -> object:
                session = Session(config)
                session.add_odometer(drive.odometer)
                session.add_imu(drive.imu)
                return session.conclusion

            times = cpu_times(estimate, 5)
            report(f"estimation, {name}, {rate:g} Hz, per IMU sample", len(drive.imu), times)
            print(f"{'':58s} {times[0]:8.3f} s for {DRIVE_S:g} s of data")
    part = drive.imu.select(slice(0, 5000))
    times = cpu_times(lambda: mechanise_one_by_one(part), 3)
    report("peer: mechanisation alone, numpy, sample by sample", len(part), times)


def read_fast(path: Path) -> int:
    """All samples of the bag by the reader of the commands."""
    with open_bag([path]) as bag:
        return sum(len(part) for part in bag.read_imu("/imu"))


def read_any(path: Path) -> int:
    """The same by rosbags' AnyReader, deserialised."""
    from rosbags.highlevel import AnyReader  # its many objects would slow down the figures above

    with AnyReader([path]) as reader:
        connections = [c for c in reader.connections if c.topic == "/imu"]
        return sum(
            reader.deserialize(raw, c.msgtype).linear_acceleration.z is not None
            for c, _, raw in reader.messages(connections=connections)
        )


def bench_bags(folder: Path) -> Path:
    """Reading beside AnyReader; returns the bag of 420 s at 1 kHz."""
    imu = simulate_swing(SwingOptions(rate_hz=1000.0, duration_s=DURATION_S)).imu
    for compression in ("zstd", "none"):
        path = folder / f"swing_{compression}"
        with ImuBagWriter(path, compression=compression) as writer:
            writer.write_fix(Position(LATITUDE, 2.0, 50.0), int(imu.stamp_ns[0]))
            writer.write_samples(imu)
        report(f"bag reading, MCAP, compression {compression}, per message", len(imu),
               cpu_times(lambda path=path: read_fast(path), 3))  # fmt: skip
    report("peer: rosbags AnyReader with deserialisation", len(imu),
           cpu_times(lambda: read_any(path), 1))  # fmt: skip
    return path


def bench_replay(bag: Path, folder: Path) -> None:
    """The command from the prompt to the written result, and its peak memory."""
    walls, peaks = [], []
    script = (
        "import resource,subprocess,sys;subprocess.run(sys.argv[1:],stdout=subprocess.DEVNULL);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    for k in range(4):
        command = [
            sys.executable, "-m", "sins_align.ros.replay_command", "swing", str(bag),
            "-p", "imu_grade:=paper_swing", "--quiet", "--out", str(folder / f"out{k}"),
        ]  # fmt: skip
        begin = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-c", script, *command], capture_output=True, text=True, cwd=ROOT
        )
        walls.append(time.perf_counter() - begin)
        peaks.append(int(done.stdout) / 1024)
        result = json.loads((folder / f"out{k}" / "result.json").read_text())
        assert result["input"]["imu_samples"] == int(DURATION_S * 1000) + 1
    print(f"{'align_replay, 420 s at 1 kHz, wall':58s} {statistics.median(walls[1:]):8.2f} s")
    print(f"{'align_replay, peak memory':58s} {max(peaks):8.0f} MB")


def bench_live() -> None:
    """The node on a live 1 kHz stream, beside an empty callback on the same stream."""
    for executor in ("single", "events"):
        figures = measure_live(30.0, executor)
        print(
            f"{'live node, executor ' + executor + ', CPU a message':58s}"
            f" {figures['node_us']:8.1f} us"
        )
        print(f"{'peer: empty callback, same stream':58s} {figures['empty_callback_us']:8.1f} us")
        print(f"{'ratio, samples lost':58s} {figures['ratio']:8.2f}, {figures['lost']:g}")


def main() -> None:
    """Print all figures."""
    bench_machine()
    bench_estimation()
    bench_odometer()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bench_replay(bench_bags(folder), folder)
    bench_live()


if __name__ == "__main__":
    main()
