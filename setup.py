"""The package for pip, colcon and bloom alike."""

from glob import glob

from setuptools import find_packages, setup

NAME = "sins_align"
PACKAGES = (NAME, "swing_align_ros", "odo_align_ros")

setup(
    name=NAME,
    version="0.1.0",
    description="Initial alignment of strapdown inertial navigation systems",
    author="The sins_align maintainers",
    author_email="maintainers@sins-align.example",
    maintainer="The sins_align maintainers",
    maintainer_email="maintainers@sins-align.example",
    license="Apache-2.0",
    python_requires=">=3.10",
    package_dir={"": "."},  # said in so many words, an editable install is one plain .pth line
    packages=find_packages(
        include=[f"{name}{part}" for name in PACKAGES for part in ("", ".*")],
    ),
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*.yaml"))),
    ],
    zip_safe=False,
    install_requires=["numpy>=1.26", "scipy>=1.11", "PyYAML>=6.0", "tqdm>=4.60"],
    extras_require={
        # Bags are read without ROS. rosdep knows none of these, hence an extra.
        "bag": ["rosbags>=0.10", "zstandard>=0.20", "lz4>=4.0"],
        # rclpy and the messages, where no ROS is installed on the machine.
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "test": [
            "hypothesis",
            "joblib",
            "mcap>=1.1",
            "mypy",
            "pytest",
            "pytest-cov",
            "ruff",
            "types-PyYAML",
            "types-tqdm",
        ],
        "colcon": ["colcon-common-extensions", "setuptools<80"],
    },
    entry_points={
        "console_scripts": [
            "swing_align = swing_align_ros.__main__:main",
            "odo_align = odo_align_ros.__main__:main",
            "align_replay = sins_align.ros.replay_command:main",
            "align_simulate = sins_align.ros.simulate_command:main",
            "align_synth = sins_align.ros.synth_command:main",
        ],
    },
)
