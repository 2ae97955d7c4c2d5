"""A firmware on which a fault script strikes, seeded: the same script and seed give the same run.

It stands between the wire and the firmware, so it serves a ``DirectLink`` and a ``PtyBoard`` alike.
Line faults hit single frames, as ``cutter`` finds them; bytes outside frames count as one piece.
"""

import random
from collections import deque
from typing import Callable, Deque, Dict, List, Optional, Sequence, Tuple

from firmware_bridge.errors import SimulatorFileError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.cutter import SHAPES, Cutter
from firmware_bridge.simulator.damage import DAMAGE, damage
from firmware_bridge.simulator.faults import ALL, DeviceFault, FaultScript, LineFault
from firmware_bridge.simulator.servo import SimServo

# protocols where the host talks to a board, not to servos
_BOARDS = ("rrc", "rrc-bus", "lsc", "lsc-pwm")
_SILENCE_S = 0.01
_REORDER_S = 0.02
_EPSILON_S = 1e-9
_COLD_C = 30.0
_N_REMEMBERED = 16


def servos_of(firmware: Firmware) -> List[SimServo]:
    """Return the servos of a firmware; none where it keeps them in another way."""
    found = getattr(firmware, "servos", ())
    return list(found.values() if isinstance(found, dict) else found)


class _Way:
    """One direction of the line: frames in, what is left of them out when its time has come."""

    def __init__(self, name: str, protocol: str, script: FaultScript, seed: int) -> None:
        # each way has its own chance, so that it does not matter how the ways interleave
        self._rng = random.Random(f"{name} {seed}")
        self._faults = [one for one in script.line if name in one.ways]
        self._is_done = [False] * len(self._faults)  # those that strike once
        self._shape = SHAPES[protocol]
        self._cutter = Cutter(self._shape)
        self._before: Deque[bytes] = deque(maxlen=_N_REMEMBERED)
        self._queue: Deque[Tuple[float, bytes]] = deque()
        self._held: Optional[Tuple[float, bytes]] = None
        self._last_s = 0.0
        self.n_struck = 0

    def cut(self, data: bytes, t_s: float) -> List[bytes]:
        """Cut a stream into pieces; a frame left unfinished by then is a piece of its own."""
        pieces = self.overdue(t_s)
        if data:
            self._last_s = t_s
        return pieces + self._cutter.feed(data)

    def overdue(self, t_s: float) -> List[bytes]:
        """Return the unfinished frame when the line has been silent since."""
        if t_s - self._last_s < _SILENCE_S:
            return []
        rest = self._cutter.flush()
        return [rest] if rest else []

    def strike(self, piece: bytes, t_s: float) -> None:
        """Let the line have its way with a frame."""
        fault = self._chosen(t_s)
        kind = "" if fault is None else self._rng.choice(fault.kinds)
        self.n_struck += fault is not None
        original = piece
        if kind == "reorder" and self._held is None:
            self._held = (t_s + _REORDER_S, piece)
        elif kind != "lose":
            delay_s = fault.delay_s if fault is not None and kind == "delay" else 0.0
            self._send(self._damaged(piece, kind), t_s + delay_s)
            if self._held is not None:
                self._send(self._held[1], t_s)
                self._held = None
        self._before.append(original)

    def due(self, t_s: float) -> bytes:
        """Return the bytes whose time has come."""
        if self._held is not None and self._held[0] <= t_s + _EPSILON_S:
            self._send(self._held[1], t_s)
            self._held = None
        out = bytearray()
        while self._queue and self._queue[0][0] <= t_s + _EPSILON_S:
            out += self._queue.popleft()[1]
        return bytes(out)

    def next_s(self) -> float:
        """Return when ``due`` has more."""
        held_s = float("inf") if self._held is None else self._held[0]
        return min(held_s, self._queue[0][0]) if self._queue else held_s

    def _send(self, piece: bytes, at_s: float) -> None:
        if self._queue:  # what is behind a delayed frame waits as well
            at_s = max(at_s, self._queue[-1][0])
        self._queue.append((at_s, piece))

    def _chosen(self, t_s: float) -> Optional[LineFault]:
        for number, fault in enumerate(self._faults):
            if fault.at_s >= 0.0:
                if t_s >= fault.at_s and not self._is_done[number]:
                    self._is_done[number] = True
                    return fault
            elif fault.from_s <= t_s < fault.until_s and self._rng.random() < fault.rate:
                return fault
        return None

    def _damaged(self, piece: bytes, kind: str) -> bytes:
        if kind in DAMAGE and len(piece) > 1:
            return damage(piece, kind, self._rng)
        if kind == "stale":
            at = self._shape.id_at
            others = [one for one in self._before if one[at : at + 1] != piece[at : at + 1]]
            return others[-1] if others else piece
        return piece


class FaultyFirmware(Firmware):
    """Strike ``inner`` with a fault script. ``n_struck`` counts damaged frames, (in, out).

    Parameters
    ----------
    inner : the firmware itself.
    protocol : name of its protocol, which says where frames end.
    script, seed : what goes wrong, and the seed of all chance in it.

    Raises
    ------
    SimulatorFileError : the script names a servo that is not there.
    """

    def __init__(self, inner: Firmware, protocol: str, script: FaultScript, seed: int) -> None:
        self.inner = inner
        self.baud, self.t_s = inner.baud, inner.t_s
        self._rng = random.Random(seed)
        self._is_board = protocol in _BOARDS
        self._in = _Way("to_servo", protocol, script, seed)
        self._out = _Way("to_host", protocol, script, seed)
        self._id_at = SHAPES[protocol].id_at
        self._bauds: Dict[SimServo, int] = {}
        self._clashes: List[int] = []
        self._line_baud = inner.baud
        self._agenda: List[Tuple[float, Callable[[], None]]] = []
        for fault in script.devices:
            self._plan(fault)
        self._agenda.sort(key=lambda entry: entry[0])
        self._act()

    @property
    def servos(self) -> List[SimServo]:
        """The servos behind it."""
        return servos_of(self.inner)

    @property
    def n_struck(self) -> Tuple[int, int]:
        """Frames that a line fault struck: on the way to the servos, and to the host."""
        return self._in.n_struck, self._out.n_struck

    def feed(self, data: bytes) -> None:
        """Take bytes from the wire, in any chunks."""
        if self.is_plugged:
            for piece in self._in.cut(data, self.t_s):
                self._in.strike(piece, self.t_s)
            self._deliver()

    def replies(self) -> bytes:
        """Return and forget the bytes that have been sent and have passed the line."""
        self._fetch()
        sent = self._out.due(self.t_s)
        return sent if self.is_plugged else b""

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass, and strike in between at the times of the script."""
        end_s = self.t_s + dt_s
        while True:
            agenda_s = self._agenda[0][0] if self._agenda else end_s
            until_s = min(max(min(agenda_s, self._in.next_s()), self.t_s), end_s)
            if until_s > self.t_s:
                self.inner.step(until_s - self.t_s)
                self.t_s = until_s
            self._act()
            for piece in self._in.overdue(self.t_s):
                self._in.strike(piece, self.t_s)
            self._deliver()
            self._fetch()
            if until_s >= end_s:
                return

    def listen(self, baud: int) -> bool:
        """Take the line to be at ``baud``: servos that went to another one are deaf."""
        self._line_baud = baud
        moved = [servo for servo, own in self._bauds.items() if own == baud != self.baud]
        is_theirs = bool(moved) and not self._is_board  # a board keeps its servos' wire as it is
        for servo in self.servos:
            is_moved = self._bauds.get(servo, self.baud) != self.baud
            servo.is_deaf = servo not in moved if is_theirs else is_moved
        return self.inner.listen(self.baud if is_theirs else baud)

    def _deliver(self) -> None:
        data = self._in.due(self.t_s)
        if data and self.is_plugged:
            self.inner.feed(data)

    def _fetch(self) -> None:
        pieces = self._out.cut(self.inner.replies(), self.t_s) if self.is_plugged else []
        if self._clashes:
            pieces = self._clashed(pieces)
        for piece in pieces:
            self._out.strike(piece, self.t_s)

    def _clashed(self, pieces: List[bytes]) -> List[bytes]:
        """Lay answers of servos with the same id over each other: they speak at the same time."""
        out: List[bytes] = []
        for piece in pieces:
            key = piece[self._id_at] if len(piece) > self._id_at else -1
            is_second = bool(out) and len(out[-1]) > self._id_at and out[-1][self._id_at] == key
            if key in self._clashes and is_second and not self._is_board:
                out[-1] = _overlaid(out[-1], piece, self._rng.randint(1, 7))
            else:
                out.append(piece)
        return out

    def _act(self) -> None:
        while self._agenda and self._agenda[0][0] <= self.t_s + _EPSILON_S:
            self._agenda.pop(0)[1]()

    def _plan(self, fault: DeviceFault) -> None:
        servos = [] if fault.kind == "unplug" else self._struck(fault)

        def on() -> None:
            self._switch(fault, servos, True)

        def off() -> None:
            self._switch(fault, servos, False)

        self._agenda.append((fault.at_s, on))
        if fault.for_s > 0.0:
            self._agenda.append((fault.at_s + fault.for_s, off))

    def _struck(self, fault: DeviceFault) -> List[SimServo]:
        servos = self.servos
        known = {servo.servo_id: servo for servo in servos}
        wanted = [one for one in (fault.servo_id, fault.with_id) if one != ALL]
        for servo_id in wanted:
            if servo_id not in known:
                there = ", ".join(str(one) for one in sorted(known)) or "none"
                raise SimulatorFileError(
                    f"fault {fault.kind!r}: no servo has id {servo_id}; there are: {there}"
                )
        return servos if fault.servo_id == ALL else [known[fault.servo_id]]

    def _switch(self, fault: DeviceFault, servos: Sequence[SimServo], is_on: bool) -> None:
        if fault.kind == "unplug":
            self.is_plugged = not is_on
        for servo in servos:
            if fault.kind == "stuck":
                servo.is_stuck = is_on
            elif fault.kind == "dead":
                servo.is_dead = is_on
            elif fault.kind == "overheat":
                servo.temperature_c = fault.temperature_c if is_on else _COLD_C
            elif fault.kind == "brown-out" and is_on:
                servo.reset(fault.for_s if fault.for_s > 0.0 else None)
            elif fault.kind == "id-clash":
                servo.servo_id = fault.with_id if is_on else fault.servo_id
                self._clashes = [fault.with_id] if is_on else []
            elif fault.kind == "wrong-baud":
                self._bauds[servo] = fault.baud if is_on else self.baud
                self.listen(self._line_baud)


def _overlaid(one: bytes, other: bytes, n_bits: int) -> bytes:
    """Return what two answers leave on an open-drain line; the second starts ``n_bits`` later."""
    n_bytes = max(len(one), len(other))
    idle = bytes((0xFF,)) * n_bytes
    first = int.from_bytes((one + idle)[:n_bytes], "little")
    second = int.from_bytes((other + idle)[:n_bytes], "little") << n_bits | (1 << n_bits) - 1
    return (first & second & ((1 << 8 * n_bytes) - 1)).to_bytes(n_bytes, "little")
