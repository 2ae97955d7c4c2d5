"""Package metadata; kept in setup.py so that pip on Python 3.7 and 32-bit ARM can build it."""

from pathlib import Path

from setuptools import find_packages, setup

# On 32-bit ARM there are no wheels on PyPI: apt's python3-numpy and python3-opencv serve there.
NOT_ARM32 = " and ".join(f'platform_machine != "{arm}"' for arm in ("armv6l", "armv7l", "armv8l"))
# results one by one, as they come
JOBLIB = 'joblib>=1.4; python_version >= "3.8"'
HERE = Path(__file__).resolve().parent

setup(
    name="apex-edge",
    version="0.1.0",
    description="Anticipatory safety agent for cheap robot arms",
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    classifiers=[
        "Programming Language :: Python :: 3",
        "Operating System :: POSIX :: Linux",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.7",
    packages=find_packages(include=["apex_edge*", "firmware_bridge*", "calib*", "offline_train*"]),
    package_data={
        "apex_edge": ["py.typed", "data/*", "web/static/*"],
        "firmware_bridge": ["py.typed", "arms/*.toml"],
        "calib": ["py.typed"],
        "offline_train": ["py.typed", "data/*.npz"],
    },
    install_requires=[
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
        # linear triggers and reports
        "train": ["scikit-learn>=1.0", JOBLIB, "matplotlib>=3.5"],
        # simulated truth
        "offline": ["scikit-learn>=1.0", JOBLIB, "matplotlib>=3.5", "mujoco>=2.3"],
        # graph models; one exact torch, since a later one may pull gigabytes
        "graph": [
            'torch==2.13.0; python_version >= "3.10"',
            'torch-geometric==2.8.1; python_version >= "3.10"',
        ],
        # shards on several machines; sweeps over settings
        "distributed": ["dask[distributed]>=2022.2"],
        "sweep": ["optuna>=4.9"],
        # drivers of depth cameras: docs/depth-cameras.md says which machine has a package
        "realsense": ["pyrealsense2>=2.50"],
        "oak": ["depthai>=2.24,<3"],
        "orbbec": ['pyorbbecsdk2>=2.0; python_version >= "3.8"'],
        # better from apt, beside the libcamera that it must fit: python3-picamera2
        "picamera": ['picamera2>=0.3.20; python_version >= "3.9"'],
        "hiwonder": ["pyyaml>=5.3"],
        # the I2C board of the Raspberry Pi 4 ArmPi mini
        "i2c": ["smbus2>=0.4"],
        "test": ["pytest>=7", "hypothesis>=6.79", "pytest-timeout>=2.1", "pyyaml>=5.3"],
        "lint": [
            # 1.4.1 is the last mypy that checks for 3.7; it runs in the 3.7 environment
            'mypy==1.4.1; python_version < "3.8"',
            'types-requests; python_version < "3.8"',
            'ruff>=0.17,<0.18; python_version >= "3.8"',
            'import-linter>=2.1; python_version >= "3.9"',
            'vermin>=1.6; python_version >= "3.8"',
        ],
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
            "arm = firmware_bridge.verb",
            "sim-arm = firmware_bridge.simulator.verb",
        ],
        "apex_edge.cameras": [
            "twin = apex_edge.cameras.twin:TwinCamera",
            "mcap = apex_edge.cameras.mcap:McapCamera",
            "video = apex_edge.cameras.video:VideoCamera",
            "folder = apex_edge.cameras.folder:FolderCamera",
            "live = apex_edge.cameras.live:LiveCamera",
            "realsense = apex_edge.cameras.realsense:RealSenseCamera",
            "oak = apex_edge.cameras.oak:OakCamera",
            "orbbec = apex_edge.cameras.orbbec:OrbbecCamera",
            "picamera2 = apex_edge.cameras.picamera2:Picamera2Camera",
            "board = calib.simulated:BoardCamera",
        ],
        "apex_edge.triggers": [
            "analytic = apex_edge.triggers.analytic:AnalyticTrigger",
            "linear = apex_edge.triggers.linear:LinearTrigger",
            "graph = apex_edge.triggers.graph_trigger:GraphTrigger",
        ],
        "apex_edge.simulators": [
            "kernel = apex_edge.simulate.kernel:KernelSim",
            "euler = apex_edge.simulate.euler:EulerSim",
        ],
        "apex_edge.planners": [
            "none = apex_edge.planners.none:NoPlanner",
            "llm = apex_edge.planners.llm:LlmPlanner",
        ],
        "apex_edge.calibrations": [
            "board = calib.verbs.board",
            "colour = calib.verbs.colour",
            "intrinsics = calib.verbs.intrinsics",
            "table = calib.verbs.table",
            "hand-eye = calib.verbs.hand_eye",
            "servo = calib.verbs.servo",
            "travel = calib.verbs.travel",
            "latency = calib.verbs.latency",
        ],
        "apex_edge.benches": [
            "latency = offline_train.benchmarks.latency",
            "perception = offline_train.benchmarks.perception",
            "rollout = offline_train.benchmarks.rollout",
            "hand-eye = offline_train.benchmarks.hand_eye",
            "firmware = offline_train.benchmarks.firmware.verb",
            "trigger = offline_train.benchmarks.trigger.verb",
        ],
        "apex_edge.graph_models": [
            "diffgraphormer = offline_train.graph_models.models:diffgraphormer",
            "diffgat = offline_train.graph_models.models:diffgat",
            "diffgcn = offline_train.graph_models.models:diffgcn",
        ],
        "apex_edge.scenarios": [
            "tabletop-pairs = offline_train.scenes.tabletop_pairs",
            "mujoco = offline_train.scenes.mujoco_table",
            "tabletop-cv = offline_train.scenes.tabletop_cv",
            "committed = offline_train.scenes.committed",
        ],
        "apex_edge.trainings": [
            "generate = offline_train.verbs.generate",
            "fit = offline_train.verbs.fit",
            "distill = offline_train.verbs.distill",
            "trigger = offline_train.verbs.trigger",
            "calibrate = offline_train.verbs.calibrate",
            "recalibrate = offline_train.verbs.recalibrate",
            "evaluate = offline_train.verbs.evaluate",
            "export = offline_train.verbs.export",
            "verify = offline_train.verbs.verify",
            "sweep = offline_train.verbs.sweep",
        ],
        "apex_edge.arm_actions": [
            "ports = firmware_bridge.verbs.ports",
            "ping = firmware_bridge.verbs.ping",
            "read = firmware_bridge.verbs.read",
            "move = firmware_bridge.verbs.move",
            "jog = firmware_bridge.verbs.jog",
            "home = firmware_bridge.verbs.home",
            "torque = firmware_bridge.verbs.torque",
            "estop = firmware_bridge.verbs.estop",
            "watch = firmware_bridge.verbs.watch",
            "calibrate-servo = calib.verbs.servo",
        ],
    },
)
