"""Wire protocols: bytes <-> values, pure functions with no clock and no I/O.

``protocol(name)`` finds one by the name that an arm's data file gives in ``[bus]``.
"""

import importlib
from typing import Dict, Type

from firmware_bridge.codec.protocol import ServoProtocol
from firmware_bridge.errors import ProtocolError

PROTOCOLS: Dict[str, str] = {
    "lx16a": "firmware_bridge.codec.lx:Lx16a",
    "lsc": "firmware_bridge.codec.lsc:Lsc",
    "lsc-pwm": "firmware_bridge.codec.lsc:LscPwm",
    "rrc": "firmware_bridge.codec.rrc_protocol:RrcPwm",
    "rrc-bus": "firmware_bridge.codec.rrc_protocol:RrcBus",
    "sts": "firmware_bridge.codec.sts:Sts",
    "dxl2": "firmware_bridge.codec.dxl2:Dxl2",
    "i2c": "firmware_bridge.codec.i2c:I2cPwm",
}
"""Name in ``[bus]`` of an arm's data file -> where the class stands."""


def protocol(name: str) -> ServoProtocol:
    """Return the protocol of that name.

    Raises
    ------
    ProtocolError : no such protocol; the message lists those there are.
    """
    if name not in PROTOCOLS:
        raise ProtocolError(f"no protocol is named {name!r}; known: {', '.join(PROTOCOLS)}")
    module, attribute = PROTOCOLS[name].split(":")
    kind: Type[ServoProtocol] = getattr(importlib.import_module(module), attribute)
    return kind()
