"""``apex doctor``: what is there, what is missing, and where to get it."""

import argparse
import importlib
import json
import os
import platform
import re
import shutil
import socket
import struct
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Callable, List, Mapping, NamedTuple, Optional, Tuple
from urllib.parse import urlsplit

import importlib_metadata

from apex_edge.errors import ApexError

HELP = (
    "say what is missing for the demo, a camera, an arm and a language model, and where to get it"
)
EXAMPLE = "apex doctor --config apex.toml --json doctor.json"

OK, NOTE, WARN, FAIL = "ok", "note", "warn", "fail"
MARKS = {OK: "ok  ", NOTE: "note", WARN: "WARN", FAIL: "FAIL"}
COARSEST_CLOCK_S = 1e-3
CONNECT_TIMEOUT_S = 2.0
# Firmware bits of get_throttled: now, and 16 higher: since boot.
THROTTLE_BITS = {
    0: "under-voltage",
    1: "frequency capped",
    2: "throttled",
    3: "soft temperature limit",
}


@dataclass(frozen=True)
class Check:
    """One finding. ``is_needed`` is whether ``apex demo`` cannot run when it fails."""

    name: str
    status: str
    found: str
    cure: str = ""
    is_needed: bool = False


class Package(NamedTuple):
    """A package to look for: import name, name for pip, apt's name, lowest and first too new."""

    module: str
    pip: str
    apt: str = ""
    lowest: str = ""
    too_new: str = ""
    why: str = ""


NEEDED = (
    Package("numpy", "numpy", "python3-numpy", "1.19", "3"),
    Package("cv2", "opencv-python-headless", "python3-opencv", "4.5", "5"),
    Package("serial", "pyserial", "python3-serial", "3.4"),
    Package("requests", "requests", "python3-requests", "2.21"),
    Package("tomli", "tomli", "", "1.2"),
    Package("cattrs", "cattrs", "", "1.10"),
    Package("mcap", "mcap", "", "1.0", "1.5" if sys.version_info < (3, 8) else ""),
    Package("mcap_protobuf", "mcap-protobuf-support", "", "0.4"),
    Package("foxglove_schemas_protobuf", "foxglove-schemas-protobuf", "", "0.2"),
    Package("google.protobuf", "protobuf", "python3-protobuf", "4.21"),
)
OPTIONAL = (
    Package("sklearn", "scikit-learn", "python3-sklearn", why="apex train"),
    Package("mujoco", "mujoco", why="training scenes on a workstation"),
    Package("matplotlib", "matplotlib", "python3-matplotlib", why="benchmark plots"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--config", metavar="FILE", help="settings file to check as well")
    parser.add_argument(
        "--json", metavar="FILE", nargs="?", const="-", help="write JSON to FILE, or to the screen"
    )


def run(args: argparse.Namespace) -> int:
    """Check everything; 0 when ``apex demo`` can run and the settings, if given, are good."""
    checks = examine(os.environ, args.config)
    can_run = not any(check.is_needed and check.status == FAIL for check in checks)
    if args.json:
        report = {"can_run_demo": can_run, "checks": [asdict(check) for check in checks]}
        text = json.dumps(report, indent=2) + "\n"
        if args.json != "-":
            Path(args.json).write_text(text, encoding="utf-8")
    if args.json == "-":
        sys.stdout.write(text)
    else:
        for check in checks:
            print(f"{MARKS[check.status]}  {check.name:<25}  {check.found}")
            if check.cure:
                print(f"{'':<33}-> {check.cure}")
        print(
            "apex demo can run here" if can_run else "apex demo cannot run here yet: see FAIL above"
        )
    return 1 if any(check.status == FAIL for check in checks) else 0


def examine(env: Mapping[str, str], config_path: Optional[str] = None) -> List[Check]:
    """Run every check; none of them moves, opens or changes anything."""
    checks = [check_python(), check_clock(), check_pty()]
    checks += [check_package(package, is_needed=True) for package in NEEDED]
    checks += [check_package(package, is_needed=False) for package in OPTIONAL]
    checks += check_cameras(Path("/dev"), Path("/sys/class/video4linux"))
    checks += check_serial_ports()
    config, found = read_settings(config_path)
    checks += found
    if config is not None:
        checks += check_driver(config.camera.type) + check_files(config)
        checks += [check_trigger(config.trigger)] + check_arm(config.arm)
    checks += check_llm(env, answers, config.planner if config is not None else None)
    checks += check_throttling(read_throttled())
    return checks


def check_python() -> Check:
    """Report interpreter and machine."""
    bits = struct.calcsize("P") * 8
    found = f"{platform.python_implementation()} {platform.python_version()}, {platform.machine()}"
    cure = ""
    if bits == 32:
        cure = "32-bit: compiled packages come from apt, not pip: see README, 32-bit ARM"
    status = OK if sys.version_info >= (3, 7) else FAIL
    return Check("python", status, f"{found}, {bits} bit", cure, is_needed=True)


def check_clock() -> Check:
    """Check that the monotonic clock is fine enough to stamp frames."""
    info = time.get_clock_info("monotonic")
    found = f"monotonic, resolution {info.resolution:.0e} s (time of day and NTP are not used)"
    is_good = info.monotonic and info.resolution <= COARSEST_CLOCK_S
    return Check("clock", OK if is_good else FAIL, found, is_needed=True)


def check_pty() -> Check:
    """Check that the demo's simulated board can have its port."""
    try:
        for end in os.openpty():
            os.close(end)
    except OSError as error:
        return Check("simulated port", FAIL, str(error), "mount devpts at /dev/pts", True)
    return Check("simulated port", OK, "pty", is_needed=True)


def check_package(package: Package, is_needed: bool) -> Check:
    """Import one package and compare its version with what is supported."""
    name = package.pip
    install = _how_to_install(package)
    try:
        module = importlib.import_module(package.module)
    except ImportError as error:
        if not is_needed:
            return Check(name, NOTE, f"not installed; only for {package.why}", install)
        cure = install
        if "libGL" in str(error):
            cure = "sudo apt-get install -y libgl1, or use opencv-python-headless"
        return Check(name, FAIL, f"cannot be imported: {error}", cure, True)
    version = str(getattr(module, "__version__", "") or _distribution_version(name))
    if package.too_new and _parts(version) >= _parts(package.too_new):
        # OpenCV 5 runs, but its first release lacks cv2.calibrateHandEye; mcap 1.5 cannot write
        # on Python 3.7
        status = WARN if package.module == "cv2" else FAIL
        return Check(name, status, f"{version} is newer than supported", install, is_needed)
    if package.lowest and _parts(version) < _parts(package.lowest):
        return Check(name, WARN, f"{version} is older than {package.lowest}", install, is_needed)
    return Check(name, OK, version, is_needed=is_needed)


def _how_to_install(package: Package) -> str:
    is_arm32 = struct.calcsize("P") == 4 and platform.machine().startswith(("arm", "aarch64"))
    if is_arm32 and package.apt:
        return f"sudo apt-get install -y {package.apt}"
    limits = [f">={package.lowest}"] if package.lowest else []
    limits += [f"<{package.too_new}"] if package.too_new else []
    return f"{sys.executable} -m pip install '{package.pip}{','.join(limits)}'"


def _distribution_version(name: str) -> str:
    try:
        return str(importlib_metadata.version(name))
    except importlib_metadata.PackageNotFoundError:
        return "unknown version"


def _parts(version: str) -> Tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])


def check_cameras(devices: Path, names: Path) -> List[Check]:
    """List V4L2 devices and whether this user may open them."""
    found = sorted(devices.glob("video*"))
    if not found:
        cure = "plug in a USB camera, or use a recording: apex replay FILE"
        return [Check("camera", NOTE, f"no {devices}/video*; the demo needs none", cure)]
    checks = []
    for device in found:
        label = names / device.name / "name"
        title = label.read_text(errors="replace").strip() if label.is_file() else "unnamed"
        if os.access(str(device), os.R_OK | os.W_OK):
            checks.append(Check("camera", OK, f"{device} {title}"))
        else:
            cure = "sudo usermod -aG video $USER, then log in again"
            checks.append(Check("camera", WARN, f"{device} {title}: no permission", cure))
    return checks


def check_driver(camera_type: str) -> List[Check]:
    """Check that the maker's package is there, where a camera of this type needs one."""
    from apex_edge import plugins
    from apex_edge.cameras.sdk import load

    try:
        sdk = getattr(plugins.load("cameras", camera_type), "sdk", None)
        if sdk is None:
            return []
        load(sdk, camera_type)
    except ApexError as error:
        return [Check("camera driver", FAIL, str(error))]
    return [Check("camera driver", OK, f"{sdk.module} for {camera_type}")]


def check_serial_ports() -> List[Check]:
    """List serial ports and I2C buses an arm could hang on."""
    try:
        from serial.tools import list_ports
    except ImportError:
        return [Check("serial port", WARN, "cannot look: pyserial is missing")]
    checks = []
    for port in sorted(list_ports.comports()):
        if os.access(port.device, os.R_OK | os.W_OK):
            checks.append(Check("serial port", OK, f"{port.device} {port.description}"))
        else:
            cure = "sudo usermod -aG dialout $USER, then log in again"
            checks.append(Check("serial port", WARN, f"{port.device}: no permission", cure))
    if not checks:
        cure = "plug in the arm's board; on a Pi's own pins: raspi-config, Interface, Serial Port"
        checks.append(Check("serial port", NOTE, "none; the demo simulates its board", cure))
    return checks


def check_llm(
    env: Mapping[str, str], can_reach: Callable[[str, int], bool], config: Any = None
) -> List[Check]:
    """Report the language model endpoint; never shows a secret.

    Parameters
    ----------
    env : the environment, which overrides the settings.
    can_reach : says whether host and port accept a connection.
    config : section [planner] of the settings, a PlannerConfig; None means all defaults.
    """
    name = "language model"
    # here, not at the top: these modules need the packages that may be missing
    try:
        from apex_edge.planners.base import PlannerConfig
        from apex_edge.planners.endpoint import endpoint_from, with_environment
    except ImportError as error:
        return [Check(name, WARN, f"cannot look: {error}")]
    settings = with_environment(config or PlannerConfig(), env)
    if not settings.base_url:
        cure = "set APEX_LLM_BASE_URL and APEX_LLM_MODEL (any OpenAI-compatible server)"
        return [Check(name, NOTE, "none set: the reflex decides alone", cure)]
    try:
        endpoint = endpoint_from(settings, env)
    except ApexError as error:
        return [Check(name, FAIL, str(error), f"docs/errors.md#{error.slug}", is_needed=True)]
    parts = urlsplit(endpoint.url)
    port = parts.port or (443 if parts.scheme == "https" else 80)
    key = "with a key" if endpoint.key else "no key (a local server needs none)"
    found = f"{parts.scheme}://{parts.hostname}:{port}, model {endpoint.model or 'unnamed'}, {key}"
    if can_reach(str(parts.hostname), port):
        return [Check(name, OK, f"{found}; accepts connections")]
    cure = "start the server or mend the URL; until then the reflex decides alone"
    return [Check(name, WARN, f"{found}; does not answer", cure)]


def answers(host: str, port: int) -> bool:
    """Say whether something listens there, waiting two seconds at most."""
    try:
        with socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S):
            return True
    except OSError:
        return False


def read_settings(path: Optional[str]) -> Tuple[Any, List[Check]]:
    """Return the settings (None when there are none) and what is to be said about the file."""
    if path is None:
        return None, [Check("settings", NOTE, "none checked", "apex doctor --config FILE")]
    # here, not at the top: it pulls in every stage, which may be what is broken
    try:
        from apex_edge.assemble import load_config

        return load_config(path), [Check("settings", OK, path)]
    except (ApexError, ImportError) as error:
        return None, [Check("settings", FAIL, str(error))]


def check_files(config: Any) -> List[Check]:
    """Check the files that the settings (an ApexConfig) name: colours and camera calibration."""
    from apex_edge.assemble import load_colours
    from apex_edge.cameras.calibration import load_camera

    checks = []
    try:
        checks.append(Check("colours", OK, ", ".join(load_colours(config.colours).names)))
    except ApexError as error:
        checks.append(Check("colours", FAIL, str(error), "apex calibrate colour makes the file"))
    path = config.camera.calibration
    if not path:
        checks.append(Check("calibration", NOTE, "none named: only what the camera source carries"))
        return checks
    try:
        camera = load_camera(path)
        size = f"{camera.width_px}x{camera.height_px}"
        checks.append(Check("calibration", OK, f"{path}, pictures of {size}"))
    except ApexError as error:
        checks.append(Check("calibration", FAIL, str(error)))
    return checks


def check_trigger(config: Any) -> Check:
    """Check that the trigger of the settings can be made, weights and all."""
    from apex_edge import plugins

    try:
        plugins.load("triggers", config.type)(config)
    except ApexError as error:
        return Check("trigger", FAIL, str(error), "apex train trigger makes the file")
    return Check("trigger", OK, f"{config.type}, {config.weights or 'shipped weights'}")


def check_arm(config: Any) -> List[Check]:
    """Check that the arm's data can be read and that its port is there."""
    from firmware_bridge.kinematics import ArmModel
    from firmware_bridge.links.ports import ports

    try:
        arm = ArmModel.load(config.type)
    except ApexError as error:
        return [Check("arm", FAIL, str(error))]
    told = arm.name if arm.is_verified else f"{arm.name} is not verified: {arm.note}"
    checks = [Check("arm", OK if arm.is_verified else WARN, told)]
    is_path = config.port not in ("", "sim") and "://" not in config.port
    if is_path and not Path(config.port).exists():
        found = ", ".join(str(port) for port in ports()) or "none"
        checks.append(Check("arm port", FAIL, f"{config.port}: not there; ports found: {found}"))
    return checks


def read_throttled() -> Optional[int]:
    """Return a Raspberry Pi's throttling bits, or None on anything else."""
    for path in sorted(Path("/sys/devices/platform/soc").glob("*firmware/get_throttled")):
        return _hex(path.read_text(errors="replace"))
    tool = shutil.which("vcgencmd")
    if tool is None:
        return None
    try:
        done = subprocess.run(
            [tool, "get_throttled"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=5
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return _hex(done.stdout.decode(errors="replace").rpartition("=")[2])


def _hex(text: str) -> Optional[int]:
    try:
        return int(text.strip(), 16)
    except ValueError:
        return None


def check_throttling(bits: Optional[int]) -> List[Check]:
    """Explain a Pi's throttling bits (None: not a Pi)."""
    if bits is None:
        return []
    now = [text for bit, text in THROTTLE_BITS.items() if bits >> bit & 1]
    past = [text for bit, text in THROTTLE_BITS.items() if bits >> (bit + 16) & 1]
    cure = "use a 5.1 V 3 A supply with a short cable, and a heat sink; 600 MHz is 2.5x slower"
    if now:
        return [Check("power and heat", WARN, f"now: {', '.join(now)}", cure)]
    if past:
        return [Check("power and heat", WARN, f"since boot: {', '.join(past)}", cure)]
    return [Check("power and heat", OK, "never throttled since boot")]
