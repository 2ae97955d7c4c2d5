"""Firmware that speaks the real bytes, with simulated servos behind it."""

from firmware_bridge.simulator.firmware import RrcFirmware
from firmware_bridge.simulator.pty_board import PtyBoard

__all__ = ["PtyBoard", "RrcFirmware"]
