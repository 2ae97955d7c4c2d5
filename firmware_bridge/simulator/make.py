"""Make a simulated firmware by the name of its protocol, for the command, tests and benches."""

import importlib
import random
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from firmware_bridge.errors import ProtocolError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.faults import FaultScript, parse_script
from firmware_bridge.simulator.faulty import FaultyFirmware
from firmware_bridge.simulator.physics import PHYSICS, PLAIN, Supply
from firmware_bridge.simulator.servo import SimServo
from firmware_bridge.simulator.wire import WireOptions


class Family(NamedTuple):
    """The servos of a protocol; rates from data sheets, unverified.

    ``firmware`` is where its class stands; ``rate_ticks_s`` is without load.
    """

    firmware: str
    physics: str
    ticks: Tuple[int, int]
    at_ticks: int
    rate_ticks_s: float
    supply_mv: float
    is_half_duplex: bool


FAMILIES: Dict[str, Family] = {
    "lx16a": Family("lx_bus:LxBus", "lx16a", (0, 1000), 500, 1560.0, 7400.0, True),
    "lsc": Family("lsc_board:LscBoard", "lx16a", (0, 1000), 500, 1560.0, 7400.0, False),
    "rrc": Family("rrc_board:RrcBoard", "pwm", (500, 2500), 1500, 3300.0, 7400.0, False),
    "rrc-bus": Family("rrc_board:RrcBoard", "lx16a", (0, 1000), 500, 1560.0, 7400.0, False),
    "sts": Family("sts_bus:StsBus", "sts", (0, 4095), 2048, 3070.0, 7400.0, True),
    "dxl2": Family("dxl_bus:DxlBus", "dxl2", (0, 4095), 2048, 3890.0, 12000.0, True),
}
DEFAULT_IDS = (1, 2, 3, 4, 5, 6)
