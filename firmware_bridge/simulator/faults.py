"""Fault scripts: what goes wrong on a simulated arm, and when. JSON, version 1.

::

    {"version": 1,
     "line": [{"kind": "flip", "way": "to_host", "rate": 0.1},
              {"kind": ["drop", "stale"], "rate": 0.05, "from_s": 2, "until_s": 9},
              {"kind": "delay", "way": "to_servo", "at_s": 1.5, "delay_s": 0.05}],
     "devices": [{"kind": "stuck", "id": 3, "at_s": 2.0, "for_s": 1.0},
                 {"kind": "unplug", "at_s": 5.0, "for_s": 0.5}]}

**line**: at most one fault strikes a frame, the first of the list that does; of several kinds in
one entry one is drawn. ``way`` is ``to_host``, ``to_servo`` or ``both`` (the default). Either
``rate`` (share of the frames, within ``from_s`` .. ``until_s``) or ``at_s`` (the first frame from
then on). Kinds are those of ``damage.DAMAGE`` and

- ``stale``: an older frame with another id comes in its place (none yet: nothing happens);
- ``delay``: it and all behind it wait ``delay_s``; ``lose``: nothing of it arrives;
- ``reorder``: it comes behind the next frame, or after 20 ms when there is none.

**devices**: ``at_s`` and, unless it is for good, ``for_s``; ``id`` of the servo, or all of them
when left out. Kinds are ``stuck``; ``overheat`` (to ``temperature_c``, 95); ``brown-out`` (a reset;
``for_s`` is how long it boots); ``dead``; ``id-clash`` (servo ``id`` takes the id ``with``);
``wrong-baud`` (servo ``id`` goes to ``baud``, 9600); ``unplug`` (no id; back ``for_s`` later).

Source: the faults that users of servo buses report.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple, Union

from firmware_bridge.errors import SimulatorFileError
from firmware_bridge.simulator.damage import DAMAGE

VERSION = 1
WAYS: Dict[str, Tuple[str, ...]] = {
    "to_host": ("to_host",),
    "to_servo": ("to_servo",),
    "both": ("to_servo", "to_host"),
}
LINE_KINDS = (*DAMAGE, "stale", "delay", "reorder", "lose")
DEVICE_KINDS = ("stuck", "overheat", "brown-out", "dead", "id-clash", "wrong-baud", "unplug")
NEVER_S = float("inf")
ALL = 0


@dataclass(frozen=True)
class LineFault:
    """What the line does to frames; ``at_s`` < 0 means by ``rate``."""

    kinds: Tuple[str, ...]
    ways: Tuple[str, ...]
    rate: float = 0.0
    at_s: float = -1.0
    from_s: float = 0.0
    until_s: float = NEVER_S
    delay_s: float = 0.02


@dataclass(frozen=True)
class DeviceFault:
    """What a servo or the plug does; ``for_s`` 0 means for good, ``servo_id`` 0 all servos."""

    kind: str
    at_s: float
    for_s: float = 0.0
    servo_id: int = ALL
    with_id: int = 0
    baud: int = 9600
    temperature_c: float = 95.0


@dataclass(frozen=True)
class FaultScript:
    """All faults of a run, in the order of the file."""

    line: Tuple[LineFault, ...] = ()
    devices: Tuple[DeviceFault, ...] = ()


def read_json(path: Union[str, Path]) -> Mapping[str, Any]:
    """Read a fault script and return it as JSON gives it, checked.

    Raises
    ------
    SimulatorFileError : no such file, not JSON, or anything in it that is not as described above.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:  # UnicodeDecodeError is a ValueError
        raise SimulatorFileError(f"{path}: cannot be read as JSON: {error}") from error
    parse_script(found, str(path))
    checked: Mapping[str, Any] = found
    return checked


def load_script(path: Union[str, Path]) -> FaultScript:
    """Read a fault script.

    Raises
    ------
    SimulatorFileError : see ``read_json``.
    """
    return parse_script(read_json(path), str(path))


def parse_script(found: object, name: str = "fault script") -> FaultScript:
    """Build a script from what JSON gave; ``name`` stands in front of what is wrong.

    Raises
    ------
    SimulatorFileError : see ``read_json``.
    """
    whole = _Entry(found, name)
    version = whole.take("version", None)
    if version != VERSION or isinstance(version, bool):
        raise SimulatorFileError(f"{name}: version is {version!r}, this program reads {VERSION}")
    line = [_line_fault(_Entry(one, f"{name} line[{n}]")) for n, one in whole.items("line")]
    devices = [
        _device_fault(_Entry(one, f"{name} devices[{n}]")) for n, one in whole.items("devices")
    ]
    whole.end()
    return FaultScript(tuple(line), tuple(devices))


class _Entry:
    """One JSON object of which every key must be taken."""

    def __init__(self, found: object, name: str) -> None:
        if not isinstance(found, dict):
            raise SimulatorFileError(f"{name}: expected an object, found {found!r}")
        self._left: Dict[str, Any] = dict(found)
        self.name = name

    def has(self, key: str) -> bool:
        """Say whether the key is there and not taken yet."""
        return key in self._left

    def take(self, key: str, default: Any) -> Any:
        """Take a value of any type."""
        return self._left.pop(key, default)

    def items(self, key: str) -> List[Tuple[int, Any]]:
        """Take a list, numbered; a missing one is empty."""
        found = self.take(key, [])
        if not isinstance(found, list):
            raise SimulatorFileError(f"{self.name}: {key} is {found!r}, expected a list")
        return list(enumerate(found))

    def number(self, key: str, default: float, low: float, high: float) -> float:
        """Take a number within a range."""
        if not self.has(key):
            return default
        found = self.take(key, default)
        is_number = isinstance(found, (int, float)) and not isinstance(found, bool)
        if not is_number or not math.isfinite(found) or not low <= found <= high:
            raise SimulatorFileError(
                f"{self.name}: {key} is {found!r}, expected a number within {low:g}..{high:g}"
            )
        return float(found)

    def whole(self, key: str, default: int, low: int, high: int) -> int:
        """Take a whole number within a range."""
        found = self.number(key, default, low, high)
        if found != int(found):
            raise SimulatorFileError(f"{self.name}: {key} is {found!r}, expected a whole number")
        return int(found)

    def one_of(self, key: str, known: Tuple[str, ...], default: Any = None) -> str:
        """Take one of the known words."""
        return self._known(key, self.take(key, default), known)

    def some_of(self, key: str, known: Tuple[str, ...]) -> Tuple[str, ...]:
        """Take one known word or a list of them."""
        found = self.take(key, None)
        words = found if isinstance(found, list) and found else [found]
        return tuple(self._known(key, word, known) for word in words)

    def end(self) -> None:
        """Refuse what nobody took: a misspelt fault would be no fault."""
        if self._left:
            raise SimulatorFileError(f"{self.name}: unknown key {sorted(self._left)[0]!r}")

    def _known(self, key: str, word: object, known: Tuple[str, ...]) -> str:
        if not isinstance(word, str) or word not in known:
            raise SimulatorFileError(
                f"{self.name}: {key} is {word!r}, expected one of {', '.join(known)}"
            )
        return word


_LATEST_S = 1e7


def _line_fault(entry: _Entry) -> LineFault:
    kinds = entry.some_of("kind", LINE_KINDS)
    ways = WAYS[entry.one_of("way", tuple(WAYS), "both")]
    if entry.has("rate") == entry.has("at_s"):
        raise SimulatorFileError(f"{entry.name}: needs either rate or at_s")
    fault = LineFault(
        kinds,
        ways,
        rate=entry.number("rate", 0.0, 0.0, 1.0),
        at_s=entry.number("at_s", -1.0, 0.0, _LATEST_S),
        from_s=entry.number("from_s", 0.0, 0.0, _LATEST_S),
        until_s=entry.number("until_s", NEVER_S, 0.0, _LATEST_S),
        delay_s=entry.number("delay_s", 0.02, 0.0, 60.0),
    )
    entry.end()
    return fault


def _device_fault(entry: _Entry) -> DeviceFault:
    kind = entry.one_of("kind", DEVICE_KINDS)
    if not entry.has("at_s"):
        raise SimulatorFileError(f"{entry.name}: needs at_s")
    _refuse_extra(entry, kind)
    fault = DeviceFault(
        kind,
        at_s=entry.number("at_s", 0.0, 0.0, _LATEST_S),
        for_s=entry.number("for_s", 0.0, 0.0, _LATEST_S),
        servo_id=entry.whole("id", ALL, 1, 253),
        with_id=entry.whole("with", 0, 1, 253),
        baud=entry.whole("baud", 9600, 300, 10_000_000),
        temperature_c=entry.number("temperature_c", 95.0, -40.0, 300.0),
    )
    entry.end()
    return fault


def _refuse_extra(entry: _Entry, kind: str) -> None:
    """Refuse numbers that this kind of fault would not look at, and miss those it needs."""
    needs: Mapping[str, Tuple[str, ...]] = {"id-clash": ("id", "with"), "wrong-baud": ("id",)}
    may: Mapping[str, Tuple[str, ...]] = {
        "id": tuple(one for one in DEVICE_KINDS if one != "unplug"),
        "with": ("id-clash",),
        "baud": ("wrong-baud",),
        "temperature_c": ("overheat",),
    }
    for key in needs.get(kind, ()):
        if not entry.has(key):
            raise SimulatorFileError(f"{entry.name}: {kind} needs {key}")
    for key, kinds in may.items():
        if entry.has(key) and kind not in kinds:
            raise SimulatorFileError(f"{entry.name}: {kind} has no {key}")
