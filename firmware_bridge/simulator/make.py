"""Make a simulated firmware by the name of its protocol, for the command, tests and benches."""

import importlib
import random
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from firmware_bridge.errors import ProtocolError, SimulatorFileError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.faults import parse_script
from firmware_bridge.simulator.faulty import FaultyFirmware
from firmware_bridge.simulator.log import Executed, read_log, replay
from firmware_bridge.simulator.physics import PHYSICS, PLAIN, Supply
from firmware_bridge.simulator.servo import SimServo
from firmware_bridge.simulator.wire import WireOptions


class Family(NamedTuple):
    """A protocol's firmware and servos; the figures are from data sheets, unverified.

    ``place`` is where the firmware's class stands; ``rate_ticks_s`` holds without load.
    """

    place: str
    physics: str
    ticks: Tuple[int, int]
    rate_ticks_s: float
    supply_mv: float
    is_half_duplex: bool


FAMILIES: Dict[str, Family] = {
    "lx16a": Family("lx_bus:LxBus", "lx16a", (0, 1000), 1560.0, 7400.0, True),
    "lsc": Family("lsc_board:LscBoard", "lx16a", (0, 1000), 1560.0, 7400.0, False),
    "lsc-pwm": Family("lsc_board:LscPwmBoard", "pwm", (500, 2500), 3300.0, 7400.0, False),
    "rrc": Family("rrc_board:RrcBoard", "pwm", (500, 2500), 3300.0, 7400.0, False),
    "rrc-bus": Family("rrc_board:RrcBusBoard", "lx16a", (0, 1000), 1560.0, 7400.0, False),
    "sts": Family("sts_bus:StsBus", "sts", (0, 4095), 3070.0, 7400.0, True),
    "dxl2": Family("dxl_bus:DxlBus", "dxl2", (0, 4095), 3890.0, 12000.0, True),
}
DEFAULT_IDS = (1, 2, 3, 4, 5, 6)
_SAG_MV = 150.0  # drop of the supply per servo at full torque, unverified
_PACKAGE = "firmware_bridge.simulator."


class Setup(NamedTuple):
    """All that decides what a simulated board does; a log's first line holds the same.

    Parameters
    ----------
    protocol : a key of ``FAMILIES``.
    arm : name or file of an arm, whose servos stand at its home; or
    ids : servos in the middle of their range (both left out: 1..6).
    seed : of all chance.
    faults : a fault script as JSON gives it, see ``faults``.
    is_plain : servos with a rate and a lag and nothing else.
    """

    protocol: str
    arm: str = ""
    ids: Tuple[int, ...] = ()
    seed: int = 0
    faults: Optional[Mapping[str, Any]] = None
    is_plain: bool = False

    def header(self) -> Dict[str, Any]:
        """Return it as a log's first line has it."""
        return dict(self._asdict())

    def firmware(self) -> Firmware:
        """Make the firmware, with its faults.

        Raises
        ------
        ProtocolError : no such protocol.
        SimulatorFileError : a fault script that is not one, or names a servo that is not there.
        """
        servos = make_servos(self)
        inner = _class_of(self.protocol)(servos)
        if self.faults is None:
            return inner
        return FaultyFirmware(inner, self.protocol, parse_script(self.faults), self.seed)

    def wire(self, is_echo: bool = False, is_paced: bool = True) -> WireOptions:
        """Return the options of a wire as this protocol has it."""
        is_half_duplex = _family(self.protocol).is_half_duplex
        return WireOptions(is_half_duplex, is_echo, is_paced, seed=self.seed)


def firmware(protocol: str, arm: str = "", ids: Sequence[int] = (), seed: int = 0) -> Firmware:
    """Make a firmware without faults, see ``Setup``.

    Raises
    ------
    ProtocolError : no such protocol.
    """
    return Setup(protocol, arm, tuple(ids), seed).firmware()


def make_servos(setup: Setup) -> List[SimServo]:
    """Make the servos of a set-up, on one supply."""
    family = _family(setup.protocol)
    physics = PLAIN if setup.is_plain else PHYSICS[family.physics]
    supply = Supply(family.supply_mv, 0.0 if setup.is_plain else _SAG_MV)
    places = _places(setup, family)
    return [
        SimServo(
            servo_id,
            at_ticks,
            family.ticks,
            family.rate_ticks_s,
            physics=physics,
            supply=supply,
            rng=random.Random(f"{setup.seed} {servo_id}"),
        )
        for servo_id, at_ticks in places.items()
    ]


def replay_log(path: Union[str, Path]) -> Tuple[Tuple[Executed, ...], Tuple[Executed, ...]]:
    """Replay a board's log; return what was executed then and what is now: they should be equal.

    Raises
    ------
    SimulatorFileError : not a log, or its first line cannot be simulated.
    """
    recording = read_log(path)
    known = {key: recording.header[key] for key in Setup._fields if key in recording.header}
    known["ids"] = tuple(known.get("ids", ()))
    try:
        made = Setup(**known).firmware()
    except (ProtocolError, TypeError) as error:
        raise SimulatorFileError(f"{path}: its first line makes no board: {error}") from error
    return recording.executed, replay(recording, made)


def _places(setup: Setup, family: Family) -> Dict[int, float]:
    """Return id -> where that servo stands at power-on."""
    if not setup.arm:
        middle = (sum(family.ticks) + 1) // 2
        return {servo_id: float(middle) for servo_id in setup.ids or DEFAULT_IDS}
    from firmware_bridge.kinematics import ArmModel  # needs numpy, which bare ids do without

    arm = ArmModel.load(setup.arm)
    places = dict(zip(arm.servo_ids, (float(one) for one in arm.ticks(arm.home_rad))))
    if arm.gripper is not None:
        places[arm.gripper.servo_id] = float(arm.gripper.closed_ticks)
    return places


def _family(protocol: str) -> Family:
    if protocol not in FAMILIES:
        raise ProtocolError(f"no simulator speaks {protocol!r}; known: {', '.join(FAMILIES)}")
    return FAMILIES[protocol]


def _class_of(protocol: str) -> Callable[[List[SimServo]], Firmware]:
    module, name = _family(protocol).place.split(":")
    found: Callable[[List[SimServo]], Firmware] = getattr(
        importlib.import_module(_PACKAGE + module), name
    )
    return found
