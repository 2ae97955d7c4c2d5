"""Registers of Feetech STS servos (STS3215: SO-ARM100, SO-101), little endian.

Addresses below 40 are EEPROM: kept over a reset when ``lock`` is 0 at the time of the write.
Source: vendor memory table of the STS series; defaults of a new STS3215 where they matter here.
"""

from typing import Dict

from firmware_bridge.codec.registers import Register

EEPROM_END = 40
N_REGISTERS = 71
MODEL_STS3215 = 777

REGISTERS: Dict[str, Register] = {
    "firmware_major": Register(0, 1, default=3, is_writable=False),
    "firmware_minor": Register(1, 1, default=9, is_writable=False),
    "model": Register(3, 2, default=MODEL_STS3215, is_writable=False),
    "id": Register(5, 1, default=1),
    "baud": Register(6, 1),
    "return_delay": Register(7, 1),  # 2 us each
    "status_level": Register(8, 1, default=1),  # 0: only ping and reads are answered
    "min_position": Register(9, 2),
    "max_position": Register(11, 2, default=4095),
    "max_temperature": Register(13, 1, default=70),  # deg C
    "max_voltage": Register(14, 1, default=140),  # 0.1 V
    "min_voltage": Register(15, 1, default=40),
    "max_torque": Register(16, 2, default=1000),  # per mille
    "phase": Register(18, 1, default=12),
    "p_gain": Register(21, 1, default=32),
    "d_gain": Register(22, 1, default=32),
    "i_gain": Register(23, 1),
    "protection_current": Register(28, 2, default=500),  # 6.5 mA each
    "homing_offset": Register(31, 2, sign_bit=11),
    "mode": Register(33, 1),
    "overload_torque": Register(36, 1, default=80),  # per cent
    "torque_enable": Register(40, 1),
    "acceleration": Register(41, 1),  # 100 steps/s^2 each, 0: none set
    "goal_position": Register(42, 2, sign_bit=15),
    "goal_time": Register(44, 2),
    "goal_speed": Register(46, 2, sign_bit=15),  # steps/s, 0: as fast as it can
    "torque_limit": Register(48, 2, default=1000),
    "lock": Register(55, 1, default=1),
    "present_position": Register(56, 2, sign_bit=15, is_writable=False),
    "present_speed": Register(58, 2, sign_bit=15, is_writable=False),
    "present_load": Register(60, 2, sign_bit=10, is_writable=False),  # per mille
    "present_voltage": Register(62, 1, is_writable=False),  # 0.1 V
    "present_temperature": Register(63, 1, is_writable=False),
    "status": Register(65, 1, is_writable=False),
    "moving": Register(66, 1, is_writable=False),
    "present_current": Register(69, 2, sign_bit=15, is_writable=False),  # 6.5 mA each
}

BAUDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
"""Baud rate by the value of the ``baud`` register."""
