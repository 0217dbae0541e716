"""Who may import whom.

Read from the source by ast, so that an import inside a function counts as well. The rules:

- only the ROS side (sins_align/ros, swing_align_ros, odo_align_ros) knows ROS and bags;
- the core needs the standard library, NumPy, SciPy and YAML;
- imports point one way: nodes -> sins_align.ros -> session -> aligners -> the ground floor;
- the simulator shares nothing with the estimation but the types, the settings and the Earth.
"""

from __future__ import annotations

import ast
import graphlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("sins_align", "swing_align_ros", "odo_align_ros")

ROS_SIDE = ("sins_align.ros", "swing_align_ros", "odo_align_ros")
ROS_AND_BAGS = ("rclpy", "rosbags", "mcap", "std_srvs", "ament_index_python", "launch", "tf2_ros")
ROS_AND_BAGS_ENDINGS = ("_msgs", "_interfaces")
CORE_THIRD_PARTY = {"numpy", "scipy", "yaml"}

# From the ground up; a module may import from its own layer and from those below.
# A module of the core that is not listed belongs to the ground floor.
GROUND, ALIGNER, SESSION, ROS, NODE = range(5)
LAYERS = {
    "sins_align.swing": ALIGNER,
    "sins_align.odo": ALIGNER,
    "sins_align.aligners": SESSION,
    "sins_align.session": SESSION,
    "sins_align.simulate": SESSION,
    "sins_align.ros": ROS,
    "swing_align_ros": NODE,
    "odo_align_ros": NODE,
}
SIMULATOR_MAY_IMPORT = {
    f"sins_align.{name}"
    for name in ("config", "config_path", "earth", "grades", "parameters", "types", "units")
}


def inside(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def on_ros_side(module: str) -> bool:
    return any(inside(module, package) for package in ROS_SIDE)


def is_ros_or_bag(module: str) -> bool:
    top = module.partition(".")[0]
    return top in ROS_AND_BAGS or top.startswith("rosidl") or top.endswith(ROS_AND_BAGS_ENDINGS)


def layer(module: str) -> int:
    return next((rank for name, rank in LAYERS.items() if inside(module, name)), GROUND)


def read_modules() -> dict[str, ast.Module]:
    modules = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            modules[name] = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
    return modules


def imports_of(tree: ast.Module, modules: set[str]) -> set[str]:
    """Full names of what a module imports; `from a import b` is a.b where that is a module."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            assert node.module is not None
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                found.add(submodule if submodule in modules else node.module)
    return found


TREES = read_modules()
IMPORTS = {name: imports_of(tree, set(TREES)) for name, tree in TREES.items()}
CORE = [name for name in TREES if not on_ros_side(name)]
PAIRS = [(importer, imported) for importer, names in IMPORTS.items() for imported in sorted(names)]
OWN_PAIRS = [pair for pair in PAIRS if any(inside(pair[1], package) for package in PACKAGES)]


def breaches(pairs: list[tuple[str, str]]) -> str:
    return "\n".join(f"{importer} imports {imported}" for importer, imported in pairs)


def test_the_tree_was_read() -> None:
    assert {"sins_align", "sins_align.types"} <= set(CORE)
    assert ("sins_align.types", "numpy") in PAIRS


def test_only_the_ros_side_imports_ros_or_bags() -> None:
    wrong = [p for p in PAIRS if is_ros_or_bag(p[1]) and not on_ros_side(p[0])]
    assert not wrong, breaches(wrong)


def test_core_needs_only_numpy_scipy_and_yaml() -> None:
    allowed = CORE_THIRD_PARTY | set(sys.stdlib_module_names) | {"sins_align"}
    wrong = [p for p in PAIRS if p[0] in CORE and p[1].partition(".")[0] not in allowed]
    assert not wrong, breaches(wrong)


def test_layers_point_one_way() -> None:
    wrong = [p for p in OWN_PAIRS if layer(p[1]) > layer(p[0])]
    assert not wrong, breaches(wrong)


@pytest.mark.parametrize(
    ("one", "other"),
    [("sins_align.swing", "sins_align.odo"), ("swing_align_ros", "odo_align_ros")],
)
def test_siblings_do_not_know_each_other(one: str, other: str) -> None:
    wrong = [
        p
        for p in OWN_PAIRS
        if (inside(p[0], one) and inside(p[1], other))
        or (inside(p[0], other) and inside(p[1], one))
    ]
    assert not wrong, breaches(wrong)


def test_estimation_does_not_know_the_simulator() -> None:
    wrong = [
        p
        for p in OWN_PAIRS
        if inside(p[1], "sins_align.simulate")
        and not inside(p[0], "sins_align.simulate")
        and not on_ros_side(p[0])
    ]
    assert not wrong, breaches(wrong)


def test_simulator_does_not_know_the_estimation() -> None:
    wrong = [
        p
        for p in OWN_PAIRS
        if inside(p[0], "sins_align.simulate")
        and not inside(p[1], "sins_align.simulate")
        and p[1] not in SIMULATOR_MAY_IMPORT
        and p[1] != "sins_align"
    ]
    assert not wrong, breaches(wrong)


def test_no_cycles() -> None:
    graph = {name: imports & set(TREES) for name, imports in IMPORTS.items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


PROBE = """
import importlib, importlib.abc, json, sys

blocked, modules = json.loads(sys.argv[1])
blocked = set(blocked)

class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top in blocked or top.startswith("rosidl") or top.endswith(("_msgs", "_interfaces")):
            raise ModuleNotFoundError(f"{name} is blocked", name=name)
        return None

sys.meta_path.insert(0, Blocker())
for name in modules:
    importlib.import_module(name)
try:
    import rclpy
except ModuleNotFoundError:
    print("imported", len(modules))
"""


def test_core_imports_where_ros_and_bags_are_missing() -> None:
    arguments = json.dumps([ROS_AND_BAGS, CORE])
    run = subprocess.run(
        [sys.executable, "-c", PROBE, arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["imported", str(len(CORE))]
