"""Servos that are a table of registers, on one bus: what Feetech and Dynamixel have in common.

Registers are bytes with a saved copy of the EEPROM part; a reset restores that and loses the RAM.
Pure: no clock, no I/O. A frame left unfinished for 5 ms is given up, as on any line whose servos
have a time-out (that of the real ones is not published).
"""

from abc import ABC, abstractmethod
from collections import deque
from typing import Callable, Deque, Dict, List, Mapping, Optional, Sequence, Tuple

from firmware_bridge.codec.parser import Parser
from firmware_bridge.codec.registers import Register
from firmware_bridge.errors import ProtocolError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.physics import PLAIN
from firmware_bridge.simulator.servo import SimServo

_SILENCE_S = 0.005
_DELAY_UNIT_S = 2e-6
_MOVING_TICKS_S = 5.0


class RegisterServo(ABC):
    """One servo and its registers.

    ``commanded`` is the goal it last set out for, as its limits left it; None before the first.
    ``pending`` is a write that waits for the action.

    Parameters
    ----------
    servo : the mechanics behind it.
    table : name -> register.
    n_registers, eeprom_end : size of the table, and where its EEPROM ends.
    """

    def __init__(
        self, servo: SimServo, table: Mapping[str, Register], n_registers: int, eeprom_end: int
    ) -> None:
        self.servo = servo
        self.eeprom_end = eeprom_end
        self.commanded: Optional[int] = None
        self.pending: Optional[Tuple[int, bytes]] = None
        self._table = table
        self._bytes = bytearray(n_registers)
        for name, register in table.items():
            self.set(name, register.default)
        self.set("id", servo.servo_id)
        if servo.physics is not PLAIN:
            low_mv, high_mv = servo.limits_mv
            self.set("min_voltage", int(low_mv / 100.0))
            self.set("max_voltage", int(high_mv / 100.0))
            self.set("max_temperature", int(servo.max_temperature_c))
        self._saved = bytes(self._bytes[:eeprom_end])
        self._blank = bytes(self._bytes[eeprom_end:])
        self._live = [(table[name], look) for name, look in self.live().items()]
        self._tell_mechanics()
        self.refresh()
        self.set("goal_position", self.get("present_position"))
        servo.on_reset = self._restore

    def get(self, name: str) -> int:
        """Return the value of a register, as it stands."""
        register = self._table[name]
        return register.unpack(self._bytes[register.address : register.end])

    def set(self, name: str, value: int) -> None:
        """Put a value into a register, whether a host may write it or not."""
        register = self._table[name]
        self._bytes[register.address : register.end] = register.pack(value)

    def save(self) -> None:
        """Keep the EEPROM part as it is now."""
        self._saved = bytes(self._bytes[: self.eeprom_end])
        self._tell_mechanics()

    def read(self, address: int, n_bytes: int) -> bytes:
        """Return registers as the host reads them now."""
        self.refresh(address, address + n_bytes)
        return bytes(self._bytes[address : address + n_bytes])

    def store(self, address: int, data: bytes, is_kept: bool) -> List[str]:
        """Put bytes where a host may write; return the names of the registers touched.

        ``is_kept`` says whether what lies in the EEPROM shall outlive a reset.
        """
        end = address + len(data)
        names = [
            name
            for name, register in self._table.items()
            if register.is_writable and address < register.end and register.address < end
        ]
        kept = bytearray(self._saved)
        for name in names:
            register = self._table[name]
            for at in range(max(address, register.address), min(end, register.end)):
                self._bytes[at] = data[at - address]
                if at < self.eeprom_end:
                    kept[at] = data[at - address]
        if is_kept:
            self._saved = bytes(kept)
        if "id" in names:
            self.servo.servo_id = self.get("id")
        self._tell_mechanics()
        return names

    def refresh(self, address: int = 0, end: int = 1 << 16) -> None:
        """Bring the registers between two addresses that tell its state up to date."""
        servo = self.servo
        if self.get("id") != servo.servo_id:  # somebody set its id with another tool
            self.set("id", servo.servo_id)
            self._saved = bytes(self._bytes[: self.eeprom_end])
        for register, look in self._live:
            if address < register.end and register.address < end:
                low, high = register.range
                value = min(max(int(round(look())), low), high)
                self._bytes[register.address : register.end] = register.pack(value)

    def look_after_itself(self) -> None:
        """Do what it does without being told, after each step; nothing here."""
        return

    def live(self) -> Dict[str, Callable[[], float]]:
        """Return which registers tell its state, and what they tell now; dialects add theirs."""
        servo = self.servo
        return {
            "torque_enable": lambda: servo.is_torque_on,
            "present_voltage": lambda: servo.supply_mv / 100.0,
            "present_temperature": lambda: servo.temperature_c,
            "present_load": lambda: servo.load_permille,
            "present_position": self.measured,
            "moving": lambda: abs(servo.speed_ticks_s) > _MOVING_TICKS_S,
        }

    @abstractmethod
    def obey(self, address: int, data: bytes) -> int:
        """Carry out a write; return its error number."""

    @property
    @abstractmethod
    def state(self) -> int:
        """What a status frame says of the servo itself."""

    @abstractmethod
    def answers(self, is_read: bool) -> bool:
        """Say whether it answers a frame to it alone (reads and pings, or others)."""

    @property
    @abstractmethod
    def baud(self) -> int:
        """Baud rate it is set to."""

    @abstractmethod
    def ramp_s(self, distance_ticks: float) -> float:
        """Return how long its profile takes for a distance; 0: as fast as it can."""

    @property
    def delay_s(self) -> float:
        """How long it waits before it answers."""
        return self.get("return_delay") * _DELAY_UNIT_S

    def go(self) -> None:
        """Set out for the goal, as far as its limits let it."""
        if not self.servo.is_torque_on:
            return
        goal = self._within_limits(self.get("goal_position"))
        place = goal + self._offset_ticks()
        self.servo.command(place, self.ramp_s(abs(place - self.servo.set_point)))
        self.commanded = goal

    def act(self) -> None:
        """Carry out the write that waits."""
        if self.pending is not None:
            address, data = self.pending
            self.pending = None
            self.obey(address, data)

    def switch_torque(self, is_on: bool) -> None:
        """Switch the torque; when it comes on, the servo goes to the goal it holds, however old."""
        was_on = self.servo.is_torque_on
        self.servo.is_torque_on = is_on
        if is_on and not was_on and self.servo.is_torque_on:
            self.servo.stop()
            self.go()

    def measured(self) -> int:
        """What its sensor says, with the offset that it keeps."""
        return self.servo.measured - self._offset_ticks()

    def _offset_ticks(self) -> int:
        return self.get("homing_offset")

    def _within_limits(self, goal: int) -> int:
        low, high = self.get("min_position"), self.get("max_position")
        return min(max(goal, low), high)

    def _tell_mechanics(self) -> None:
        self.servo.max_temperature_c = float(self.get("max_temperature"))
        self.servo.limits_mv = (100.0 * self.get("min_voltage"), 100.0 * self.get("max_voltage"))

    def _restore(self) -> None:
        """Start again: EEPROM as saved, RAM as new, the goal where the shaft is."""
        self.refresh()
        self._bytes[: self.eeprom_end] = self._saved
        self._bytes[self.eeprom_end :] = self._blank
        self.servo.servo_id = self.get("id")
        self.pending = None
        self._tell_mechanics()
        self.refresh()
        low, high = self._table["goal_position"].range
        self.set("goal_position", min(max(self.get("present_position"), low), high))


class RegisterBus(Firmware):
    """Several servos on one line. Counts: ``n_frames``, ``n_bad``, ``n_rejected``.

    Parameters
    ----------
    members : the servos.
    parser : of what the host sends.
    baud : of the line.
    """

    def __init__(self, members: Sequence[RegisterServo], parser: Parser, baud: int) -> None:
        self.members = list(members)
        self.servos = [member.servo for member in self.members]
        self.baud = baud
        self.line_baud = baud
        self.t_s = 0.0
        self.n_rejected = 0
        self._parser = parser
        self._silent_s = 0.0
        self._out: Deque[Tuple[float, bytes]] = deque()

    @property
    def n_frames(self) -> int:
        """Well-formed frames taken so far."""
        return self._parser.n_frames

    @property
    def n_bad(self) -> int:
        """Frames dropped for their checksum."""
        return self._parser.n_bad

    @property
    def commanded(self) -> Dict[int, int]:
        """Id -> goal that servo last set out for; those that never did are left out."""
        told = ((one.servo.servo_id, one.commanded) for one in self.members)
        return {servo_id: goal for servo_id, goal in told if goal is not None}

    def member(self, servo_id: int) -> RegisterServo:
        """Return the first servo of that id.

        Raises
        ------
        ProtocolError : there is none.
        """
        for member in self.members:
            if member.servo.servo_id == servo_id:
                return member
        raise ProtocolError(f"no servo on the simulated bus has id {servo_id}")

    def listen(self, baud: int) -> bool:
        """Take the line to be at ``baud``; say whether any servo is."""
        self.line_baud = baud
        return any(member.baud == baud for member in self.members)

    def feed(self, data: bytes) -> None:
        """Take bytes from the wire, in any chunks."""
        self._silent_s = 0.0
        self._take(self._parser.feed(data))

    def replies(self) -> bytes:
        """Return and forget the bytes that have been sent by now."""
        out = bytearray()
        while self._out and self._out[0][0] <= self.t_s + 1e-9:
            out += self._out.popleft()[1]
        return bytes(out)

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass."""
        self.t_s += dt_s
        for member in self.members:
            member.servo.step(dt_s)
            member.look_after_itself()
        before = self._silent_s
        self._silent_s += dt_s
        if before < _SILENCE_S <= self._silent_s:
            self._take(self._parser.flush())

    @abstractmethod
    def obey(self, frame: bytes) -> None:
        """Carry out a checked frame.

        Raises
        ------
        ProtocolError : it makes no sense.
        """

    def hearing(self, servo_id: int, broadcast: int) -> List[RegisterServo]:
        """Return the servos that a frame to ``servo_id`` reaches."""
        return [
            member
            for member in self.members
            if servo_id in (member.servo.servo_id, broadcast) and self._hears(member)
        ]

    def answer(self, member: RegisterServo, frame: bytes) -> None:
        """Queue the answer of one servo, after its return delay."""
        self._out.append((self.t_s + member.delay_s, frame))

    def answer_in_turn(self, frames: Sequence[Tuple[RegisterServo, bytes]]) -> None:
        """Queue answers one behind the other; the time of their bytes is up to the wire."""
        due_s = self.t_s
        for member, frame in frames:
            due_s += member.delay_s
            self._out.append((due_s, frame))

    def _hears(self, member: RegisterServo) -> bool:
        return member.servo.is_answering and member.baud == self.line_baud

    def _take(self, frames: Sequence[bytes]) -> None:
        for frame in frames:
            try:
                self.obey(frame)
            except ProtocolError:
                self.n_rejected += 1
