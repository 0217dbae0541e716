"""What pip, colcon and a release read about the package."""

from __future__ import annotations

import ast
import configparser
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

import sins_align
from sins_align.config_path import shipped_config

ROOT = Path(__file__).resolve().parent.parent
MANIFEST = ET.parse(ROOT / "package.xml").getroot()
ROSDEP_PYTHON = {"python3-numpy": "numpy", "python3-scipy": "scipy", "python3-yaml": "PyYAML",
                 "python3-tqdm": "tqdm"}  # fmt: skip
PIP_ONLY = {"rosbags", "mcap", "zstandard", "plotly"}


def setup_arguments() -> dict[str, ast.expr]:
    tree = ast.parse((ROOT / "setup.py").read_text(encoding="utf-8"))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    (call,) = (c for c in calls if isinstance(c.func, ast.Name) and c.func.id == "setup")
    return {keyword.arg: keyword.value for keyword in call.keywords if keyword.arg}


SETUP = setup_arguments()
SCRIPTS = {
    name.strip(): target.strip()
    for name, _, target in (
        line.partition("=") for line in ast.literal_eval(SETUP["entry_points"])["console_scripts"]
    )
}


def manifest_text(tag: str) -> str:
    return (MANIFEST.findtext(tag) or "").strip()


def test_versions_agree() -> None:
    assert re.fullmatch(r"\d+\.\d+\.\d+", sins_align.__version__)
    assert manifest_text("version") == sins_align.__version__
    assert ast.literal_eval(SETUP["version"]) == sins_align.__version__


def test_manifest_is_valid() -> None:
    """catkin_pkg judges as colcon does, which drops the ament hook of an invalid package."""
    catkin_package = pytest.importorskip("catkin_pkg.package")
    warnings: list[str] = []
    package = catkin_package.parse_package(str(ROOT / "package.xml"), warnings=warnings)
    package.validate(warnings=warnings)
    assert warnings == []
    assert package.package_format == 3
    assert package.name == "sins_align"
    assert package.get_build_type() == "ament_python"
    assert package.licenses == ["Apache-2.0"]


def test_manifest_and_setup_name_the_same_python_packages() -> None:
    keys = {e.text for e in MANIFEST.iter("exec_depend") if (e.text or "").startswith("python3-")}
    assert keys == set(ROSDEP_PYTHON)
    required = {re.split(r"[<>=!\[]", r)[0] for r in ast.literal_eval(SETUP["install_requires"])}
    assert required == set(ROSDEP_PYTHON.values())


def test_no_pip_only_package_is_required() -> None:
    depends = {e.text for e in MANIFEST.iter() if e.tag.endswith("depend")}
    assert not {d for d in depends if d and d.removeprefix("python3-") in PIP_ONLY}


def test_manifest_names_every_ros_package_that_is_imported() -> None:
    depends = {e.text for e in MANIFEST.iter("exec_depend")}
    ros = re.compile(
        r"^\s*(?:from|import) (rclpy|std_srvs|\w+_msgs|\w+_interfaces|ament_index_python)\b", re.M
    )
    imported = {
        name
        for folder in ("sins_align", "swing_align_ros", "odo_align_ros")
        for path in (ROOT / folder).rglob("*.py")
        for name in ros.findall(path.read_text(encoding="utf-8"))
    }
    assert imported <= depends


def test_licence_is_there_whole() -> None:
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text
    assert "END OF TERMS AND CONDITIONS" in text


def test_executables_land_where_ros2_run_looks() -> None:
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(ROOT / "setup.cfg")
    assert parser["develop"]["script_dir"] == "$base/lib/sins_align"
    assert parser["install"]["install_scripts"] == "$base/lib/sins_align"


def test_the_marker_of_the_ament_index_is_named_as_the_package() -> None:
    assert (ROOT / "resource" / manifest_text("name")).is_file()


@pytest.mark.parametrize("script", sorted(SCRIPTS))
def test_executable_has_its_function(script: str) -> None:
    module, _, function = SCRIPTS[script].partition(":")
    path = ROOT / Path(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("script", sorted(SCRIPTS))
def test_executable_imports(script: str) -> None:
    pytest.importorskip("rclpy")
    module, _, function = SCRIPTS[script].partition(":")
    probe = f"from {module} import {function}; assert callable({function})"
    subprocess.run([sys.executable, "-c", probe], check=True, timeout=60)


def test_every_folder_of_code_is_packaged() -> None:
    """A folder without __init__.py would be missing from an installed package."""
    for package in ("sins_align", "swing_align_ros", "odo_align_ros"):
        for path in (ROOT / package).rglob("*.py"):
            assert (path.parent / "__init__.py").is_file(), path.parent


def test_shipped_config_in_the_checkout() -> None:
    path = shipped_config("imu_grades.yaml")
    assert path == ROOT / "config" / "imu_grades.yaml"
    assert yaml.safe_load(path.read_text(encoding="utf-8"))


def test_shipped_config_names_what_is_missing() -> None:
    with pytest.raises(FileNotFoundError, match=r"no_such\.yaml"):
        shipped_config("no_such.yaml")


def test_shipped_config_of_an_installed_package(tmp_path: Path) -> None:
    """The layout that pip --target and colcon make, without the checkout in reach."""
    package = tmp_path / "lib" / "python3" / "site-packages" / "sins_align"
    config = tmp_path / "share" / "sins_align" / "config"
    package.mkdir(parents=True)
    config.mkdir(parents=True)
    (package / "__init__.py").touch()
    source = ROOT / "sins_align" / "config_path.py"
    (package / "config_path.py").write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
    (config / "imu_grades.yaml").touch()
    probe = "from sins_align import config_path as c; print(c.shipped_config('imu_grades.yaml'))"
    run = subprocess.run(
        [sys.executable, "-c", probe],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(package.parent)},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert Path(run.stdout.strip()) == config / "imu_grades.yaml"
