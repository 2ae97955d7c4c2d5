"""Firmware that speaks the real bytes, with simulated servos behind it.

``RrcFirmware`` is fetched when it is asked for: whole arms need numpy, boards and buses do not.
"""

from typing import TYPE_CHECKING, Any

from firmware_bridge.simulator.pty_board import PtyBoard

if TYPE_CHECKING:
    from firmware_bridge.simulator.rrc_arm import RrcFirmware

__all__ = ["PtyBoard", "RrcFirmware"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - what a module's attribute may be
    if name != "RrcFirmware":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from firmware_bridge.simulator.rrc_arm import RrcFirmware

    return RrcFirmware
