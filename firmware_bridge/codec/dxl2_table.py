"""Registers of Dynamixel X servos (protocol 2.0), little endian, two's complement.

Addresses below 64 are EEPROM and can be written while the torque is off.
Source: vendor control table of the X series; defaults of an XL430.
"""

from typing import Dict

from firmware_bridge.codec.registers import TWOS, Register

EEPROM_END = 64
N_REGISTERS = 147
MODEL_XL430 = 1060

REGISTERS: Dict[str, Register] = {
    "model": Register(0, 2, default=MODEL_XL430, is_writable=False),
    "firmware": Register(6, 1, default=45, is_writable=False),
    "id": Register(7, 1, default=1),
    "baud": Register(8, 1, default=1),
    "return_delay": Register(9, 1, default=250),  # 2 us each
    "drive_mode": Register(10, 1),
    "operating_mode": Register(11, 1, default=3),
    "homing_offset": Register(20, 4, TWOS),
    "max_temperature": Register(31, 1, default=72),  # deg C
    "max_voltage": Register(32, 2, default=140),  # 0.1 V
    "min_voltage": Register(34, 2, default=60),
    "velocity_limit": Register(44, 4, default=265),
    "max_position": Register(48, 4, default=4095),
    "min_position": Register(52, 4),
    "shutdown": Register(63, 1, default=52),  # states that switch the torque off
    "torque_enable": Register(64, 1),
    "led": Register(65, 1),
    "status_level": Register(68, 1, default=2),  # 0: ping, 1: and reads, 2: all is answered
    "hardware_error": Register(70, 1, is_writable=False),
    "profile_acceleration": Register(108, 4),
    "profile_velocity": Register(112, 4),  # 0.229 rev/min each, 0: as fast as it can
    "goal_position": Register(116, 4, TWOS),
    "moving": Register(122, 1, is_writable=False),
    "present_load": Register(126, 2, TWOS, is_writable=False),  # per mille; a current on XM and XH
    "present_velocity": Register(128, 4, TWOS, is_writable=False),
    "present_position": Register(132, 4, TWOS, is_writable=False),
    "present_voltage": Register(144, 2, is_writable=False),  # 0.1 V
    "present_temperature": Register(146, 1, is_writable=False),
}

BAUDS = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)
"""Baud rate by the value of the ``baud`` register."""

TICKS_S_PER_VELOCITY = 0.229 * 4096.0 / 60.0
"""Steps per second of one unit of velocity."""
