"""A log of every byte and every executed command of a simulated board, and its replay. JSONL.

The first line says what was simulated (``version``, ``protocol``, ``arm``, ``ids``, ``seed``,
``faults``: the whole script). Then one record a line, each with ``t_s`` of simulated time: ``in``
and ``out`` (bytes as hex, as they reached or left the firmware), ``do`` (what servo ``servo`` did,
with its numbers), ``baud`` (the host changed it), ``note`` (plugged in or out) and ``end``.
"""

import json
from pathlib import Path
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, TextIO, Tuple, Union

from firmware_bridge.errors import SimulatorFileError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.faulty import servos_of
from firmware_bridge.simulator.servo import SimServo
from firmware_bridge.simulator.wire import TICK_S, Tap

VERSION = 1
_DIGITS = 6


class Executed(NamedTuple):
    """One command that a servo carried out; ``numbers`` sorted by name."""

    t_s: float
    servo_id: int
    what: str
    numbers: Tuple[Tuple[str, float], ...]


class Listener:
    """Collect what the servos of a firmware do, in ``executed``."""

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self.executed: List[Executed] = []
        for servo in servos_of(firmware):
            servo.on_event = self._take

    def _take(self, servo: SimServo, what: str, numbers: Dict[str, float]) -> None:
        t_s = round(self._firmware.t_s, _DIGITS)
        self.took(Executed(t_s, servo.servo_id, what, tuple(sorted(numbers.items()))))

    def took(self, one: Executed) -> None:
        """Keep one; a log writes it down instead."""
        self.executed.append(one)


class BoardLog(Tap, Listener):
    """Write the log of one board to a text stream, which stays the caller's to close.

    Parameters
    ----------
    stream : where to.
    firmware : whose servos to listen to.
    header : what was simulated, see ``make.header``.
    """

    def __init__(self, stream: TextIO, firmware: Firmware, header: Mapping[str, Any]) -> None:
        Listener.__init__(self, firmware)
        self._stream = stream
        self._fed = bytearray()
        self._fed_step = 0
        self._write({"version": VERSION, **header})

    def fed(self, n_steps: int, data: bytes) -> None:
        """Write bytes that reached the firmware, those of one step together."""
        if n_steps != self._fed_step:
            self.flush()
        self._fed_step = n_steps
        self._fed += data

    def sent(self, n_steps: int, data: bytes) -> None:
        """Write bytes the firmware sent."""
        self.flush()
        self._write({"t_s": _at(n_steps), "out": data.hex()})

    def heard(self, n_steps: int, baud: int) -> None:
        """Write that the host's side of the line changed its baud rate."""
        self.flush()
        self._write({"t_s": _at(n_steps), "baud": baud})

    def took(self, one: Executed) -> None:
        """Write what a servo did."""
        self.flush()
        numbers = dict(one.numbers)
        self._write({"t_s": one.t_s, "servo": one.servo_id, "do": one.what, **numbers})

    def note(self, n_steps: int, text: str) -> None:
        """Write a remark."""
        self.flush()
        self._write({"t_s": _at(n_steps), "note": text})

    def end(self, n_steps: int) -> None:
        """Write how long it all was."""
        self.flush()
        self._write({"t_s": _at(n_steps), "end": True})
        self._stream.flush()

    def flush(self) -> None:
        """Write the bytes gathered so far."""
        if self._fed:
            self._write({"t_s": _at(self._fed_step), "in": bytes(self._fed).hex()})
            self._fed.clear()

    def _write(self, record: Mapping[str, Any]) -> None:
        self._stream.write(json.dumps(record) + "\n")


class Recording(NamedTuple):
    """A log as read: ``fed`` are (steps so far, bytes or new baud rate), ``n_steps`` all steps."""

    header: Dict[str, Any]
    fed: Tuple[Tuple[int, Union[bytes, int]], ...]
    executed: Tuple[Executed, ...]
    n_steps: int


def read_log(path: Union[str, Path]) -> Recording:
    """Read a log; a last line cut short (the simulator was killed) is left out.

    Raises
    ------
    SimulatorFileError : no such file, or a line that no log has.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, ValueError) as error:
        raise SimulatorFileError(f"{path}: cannot be read: {error}") from error
    records = [_record(path, n, line) for n, line in enumerate(lines, 1) if line.endswith("\n")]
    if not records or records[0].get("version") != VERSION or "protocol" not in records[0]:
        raise SimulatorFileError(f"{path}: not a simulator's log of version {VERSION}")
    fed: List[Tuple[int, Union[bytes, int]]] = []
    executed: List[Executed] = []
    n_steps = 0
    for number, record in enumerate(records[1:], 2):
        try:
            step = round(float(record["t_s"]) / TICK_S)
            if "do" in record:
                executed.append(_executed(record))
                continue
            n_steps = max(n_steps, step)
            if "in" in record:
                fed.append((step, bytes.fromhex(record["in"])))
            elif "baud" in record:
                fed.append((step, int(record["baud"])))
        except (KeyError, TypeError, ValueError) as error:
            raise SimulatorFileError(f"{path} line {number}: not a record: {error}") from error
    return Recording(records[0], tuple(fed), tuple(executed), n_steps)


def replay(recording: Recording, firmware: Firmware) -> Tuple[Executed, ...]:
    """Feed a recording's bytes, at their times, to a firmware made anew; return what it did.

    Parameters
    ----------
    firmware : made as for the recording; ``make.from_header`` does that.
    """
    listener = Listener(firmware)
    n_done = 0
    for step, data in (*recording.fed, (recording.n_steps, b"")):
        n_done = _run(firmware, n_done, step)
        if isinstance(data, int):
            firmware.listen(data)
        elif data:
            firmware.feed(data)
            firmware.replies()
    return tuple(listener.executed)


def _run(firmware: Firmware, n_done: int, n_wanted: int) -> int:
    for _ in range(n_done, n_wanted):
        firmware.step(TICK_S)
        firmware.replies()
    return max(n_done, n_wanted)


def _record(path: Union[str, Path], number: int, line: str) -> Dict[str, Any]:
    found: Optional[object] = None
    try:
        found = json.loads(line)
    except ValueError as error:
        raise SimulatorFileError(f"{path} line {number}: not JSON: {error}") from error
    if not isinstance(found, dict):
        raise SimulatorFileError(f"{path} line {number}: expected an object, found {found!r}")
    return found


def _executed(record: Mapping[str, Any]) -> Executed:
    known = ("t_s", "servo", "do")
    numbers = tuple(
        sorted((key, float(value)) for key, value in record.items() if key not in known)
    )
    return Executed(float(record["t_s"]), int(record["servo"]), str(record["do"]), numbers)


def _at(n_steps: int) -> float:
    return round(n_steps * TICK_S, _DIGITS)
