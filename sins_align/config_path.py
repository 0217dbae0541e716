"""Where the shipped YAML files are, in a checkout and once installed."""

from __future__ import annotations

from pathlib import Path


def shipped_config(name: str) -> Path:
    """Path of a file of the repository's ``config/`` folder, such as ``imu_grades.yaml``.

    pip and colcon both install the folder as PREFIX/share/sins_align/config. The prefix is
    looked for upwards from this module, not taken from ``sys.prefix``: a colcon overlay, a
    ``pip --user`` and a ``pip --target`` install have prefixes of their own.

    Raises
    ------
    FileNotFoundError
        The file is not shipped.
    """
    package = Path(__file__).resolve().parent
    checkout = package.parent
    if (checkout / "package.xml").is_file():  # also an editable or a symlinked install
        folders = [checkout / "config"]
    else:
        folders = [prefix / "share" / "sins_align" / "config" for prefix in package.parents]
    for folder in folders:
        path = folder / name
        if path.is_file():
            return path
    raise FileNotFoundError(f"{name} is not among the configuration files of sins_align")
