"""Package metadata; kept in setup.py so that pip on Python 3.7 and 32-bit ARM can build it."""

from setuptools import find_packages, setup

NOT_ARM32 = 'platform_machine != "armv7l" and platform_machine != "armv6l"'

setup(
    name="apex-edge",
    version="0.1.0",
    description="Anticipatory safety agent for cheap robot arms",
    long_description=open("README.md", encoding="utf-8").read(),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    python_requires=">=3.7",
    packages=find_packages(include=["apex_edge*", "firmware_bridge*", "calib*", "offline_train*"]),
    package_data={
        "apex_edge": ["py.typed", "data/*", "web/static/*"],
        "firmware_bridge": ["py.typed", "arms/*.toml"],
        "calib": ["py.typed"],
        "offline_train": ["py.typed"],
    },
    install_requires=[
        # On 32-bit ARM there are no wheels: apt's python3-numpy and python3-opencv serve there.
        "numpy>=1.19,<3",
        "opencv-python-headless>=4.7,<5; " + NOT_ARM32,
        "pyserial>=3.4",
        "requests>=2.21",
        "tomli>=1.2",
        "cattrs>=1.10",
        "importlib_metadata>=4.6",
        'mcap>=1.0,<1.5; python_version < "3.8"',
        'mcap>=1.0; python_version >= "3.8"',
        "mcap-protobuf-support>=0.4",
        "foxglove-schemas-protobuf>=0.2",
        "protobuf>=4.21,<8",
    ],
    extras_require={
        "offline": ["scikit-learn>=1.0", "mujoco>=2.3", "joblib>=1.2", "matplotlib>=3.5"],
        "test": ["pytest>=7", "hypothesis>=6.79", "pytest-timeout>=2.1"],
    },
    entry_points={
        "console_scripts": ["apex = apex_edge.cli:main"],
        "apex_edge.verbs": [
            "demo = apex_edge.verbs.demo",
            "run = apex_edge.verbs.run",
            "replay = apex_edge.verbs.replay",
            "record = apex_edge.verbs.record",
            "doctor = apex_edge.verbs.doctor",
            "calibrate = calib.verb",
            "train = offline_train.verb",
            "bench = offline_train.benchmarks.verb",
        ],
        "apex_edge.cameras": [
            "twin = apex_edge.cameras.twin:TwinCamera",
            "mcap = apex_edge.cameras.mcap:McapCamera",
            "video = apex_edge.cameras.video:VideoCamera",
            "folder = apex_edge.cameras.folder:FolderCamera",
            "live = apex_edge.cameras.live:LiveCamera",
        ],
        "apex_edge.triggers": [
            "analytic = apex_edge.triggers.analytic:AnalyticTrigger",
            "linear = apex_edge.triggers.linear:LinearTrigger",
        ],
        "apex_edge.simulators": [
            "kernel = apex_edge.simulate.kernel:KernelSim",
            "euler = apex_edge.simulate.euler:EulerSim",
        ],
        "apex_edge.planners": [
            "none = apex_edge.planners.none:NoPlanner",
            "llm = apex_edge.planners.llm:LlmPlanner",
        ],
        "apex_edge.benches": ["rollout = offline_train.benchmarks.rollout"],
    },
)
