"""What the actions of ``apex arm`` share: which arm, which port, and how far one may go."""

import argparse
import time
from contextlib import contextmanager
from typing import Callable, Iterator, List

import numpy as np

from apex_edge.errors import ConfigError
from apex_edge.types import Array
from firmware_bridge.bus import Bus, BusSettings
from firmware_bridge.codec import protocol
from firmware_bridge.errors import NoSuchPort
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.dry import DryLink
from firmware_bridge.links.opening import open_link
from firmware_bridge.links.ports import ports
from firmware_bridge.ready import ReadyArm
from firmware_bridge.servos import Servos
from firmware_bridge.simulator.make import firmware

SLOW = 0.25
"""Share of the arm's rates that a person's hand can follow."""
_PATIENT = BusSettings(budget_s=0.2)  # nothing moves meanwhile, and a person waits


def add_arm_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare which arm and where."""
    parser.add_argument(
        "--arm", default="armpi-mini", metavar="NAME", help="arm data file, by name or path"
    )
    parser.add_argument(
        "--port", default="", help="device, pyserial URL or i2c://1 (the only one there is)"
    )


def add_motion_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare how fast, and whether at all."""
    add_arm_arguments(parser)
    parser.add_argument(
        "--speed", type=float, default=SLOW, help=f"share of the arm's rates, to 1 ({SLOW})"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="print the bytes that would go out; send nothing"
    )


def port_of(args: argparse.Namespace) -> str:
    """Return the port that was named, or the only one this machine has.

    Raises
    ------
    NoSuchPort : none was named and there is not exactly one.
    """
    if args.port:
        return str(args.port)
    found = [port.stable or port.device for port in ports()]
    if len(found) != 1:
        raise NoSuchPort(f"name a --port; ports found: {', '.join(found) or 'none'}")
    return found[0]


@contextmanager
def listening(args: argparse.Namespace) -> Iterator[Servos]:
    """Open the bus of an arm for questions; nothing is armed, nothing moves.

    Raises
    ------
    ConfigError, PortError : no such arm, or no way to it.
    """
    arm = ArmModel.load(args.arm)
    spoken = protocol(arm.bus.protocol)
    bus = Bus(spoken, open_link(port_of(args), spoken), _PATIENT)
    bus.open()
    try:
        yield Servos(arm, bus)
    finally:
        bus.close()


@contextmanager
def moving(args: argparse.Namespace) -> Iterator[ReadyArm]:
    """Open an arm, armed and ready; with ``--dry-run`` its bytes are printed and a simulated arm
    answers.

    Raises
    ------
    ConfigError : a speed out of range. ArmError : it cannot be opened or does not get ready.
    """
    if not 0.0 < args.speed <= 1.0:  # written so that NaN is refused
        raise ConfigError(f"--speed {args.speed}: expected more than 0 and at most 1")
    arm = ArmModel.load(args.arm)
    if not args.dry_run:
        with ReadyArm(arm, port_of(args), time.monotonic, is_homing=False) as ready:
            yield ready
        return
    clock = _Clock()
    link = DryLink(clock.now, clock.wait, firmware(arm.bus.protocol, args.arm), _tell)
    with ReadyArm(arm, "dry run", clock.now, clock.wait, is_homing=False, link=link) as ready:
        yield ready


class _Clock:
    """Time that passes only when somebody waits."""

    def __init__(self) -> None:
        self._t_s = 0.0

    def now(self) -> float:
        return self._t_s

    def wait(self, seconds: float) -> None:
        self._t_s += seconds


def _tell(t_s: float, frame: bytes) -> None:
    print(f"{t_s:8.3f} s  {' '.join(f'{byte:02x}' for byte in frame)}")


def goal_from(text: str, arm: ArmModel, start: Array) -> Array:
    """Return joints (k,) of ``yaw=10,elbow=-20`` in degrees; joints that are not named stay.

    Raises
    ------
    ConfigError : not of that form, or no such joint.
    """
    goal = np.array(start, dtype=np.float64)
    for part in text.split(","):
        name, _, value = part.partition("=")
        at = joint_index(name.strip(), arm)
        try:
            goal[at] = np.radians(float(value))
        except ValueError:
            raise ConfigError(f"{part!r}: expected JOINT=DEGREES, e.g. yaw=10") from None
    return goal


def joint_index(name: str, arm: ArmModel) -> int:
    """Return the place of a joint.

    Raises
    ------
    ConfigError : the arm has no such joint.
    """
    if name not in arm.joint_names:
        raise ConfigError(f"no joint is named {name!r}; known: {', '.join(arm.joint_names)}")
    return arm.joint_names.index(name)


def pose_text(arm: ArmModel, q_rad: Array) -> str:
    """Return joints (k,) in degrees and the tip in metres, for people."""
    degrees = ", ".join(f"{n} {d:.1f}" for n, d in zip(arm.joint_names, np.degrees(q_rad)))
    if not np.isfinite(q_rad).all():
        return f"{degrees} deg"
    x_m, y_m, z_m = arm.tip(q_rad)[0]
    return f"{degrees} deg; tip {x_m:.3f}, {y_m:.3f}, {z_m:.3f} m"


def go(ready: ReadyArm, goals: List[Array], speed: float, tell: Callable[[str], None]) -> None:
    """Go through goals one after the other and tell where the arm stands then.

    Raises
    ------
    MotionRefused : the guard refuses the way; what came before it was done.
    """
    for goal in goals:
        ready.go(goal, speed)
    state = ready.session.read()
    tell(f"{state.source}: {pose_text(ready.session.model, state.joints_rad)}")
