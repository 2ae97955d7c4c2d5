"""An emergency stop while threads keep the bus full: what goes out before it, and how soon.

The line is simulated (the real Bus, real threads, one clock), so that the figure that counts is
made of bytes: what was left of the frame on the wire at the call, all bytes written before the
stop's last one, each at ten bits. A machine that is busy with something else changes none of that;
wall-clock times are notes. Source: ours.
"""

import random
import threading
import time
from typing import List, NamedTuple, Set

from apex_edge.verbs.progress import Progress
from firmware_bridge.bus import Bus, Priority
from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.errors import LinkLost, MotionRefused
from firmware_bridge.links.base import Link
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.wire import Wire, WireOptions
from offline_train.benchmarks.firmware.devices import IDS, device, servos
from offline_train.benchmarks.lines import Line, at_least, at_most, note

SUITE = "estop"
N_STOPS = 200
LIMIT_MS = 2.0
_N_MOVERS = _N_READERS = 4
_N_QUEUED = 2  # moves in each list
_LET_RUN_S = (0.01, 0.2)
_POLL_S = 0.0002
_MOVE_MS = 2000


class WireLink(Link):
    """A link to a simulated device over a simulated wire that takes its real time per byte."""

    def __init__(self, firmware: Firmware, baud: int) -> None:
        super().__init__("wire", baud)
        self.log: List[bytes] = []
        self.wire = Wire(firmware, WireOptions(is_half_duplex=True))
        self._guard = threading.Lock()
        self._is_open = False
        self._free_s = 0.0
        self._waiting = bytearray()

    @property
    def is_open(self) -> bool:
        """Say whether it is open."""
        return self._is_open

    def open(self) -> None:
        """Open it."""
        self._is_open = True

    def close(self) -> None:
        """Close it."""
        self._is_open = False

    def write(self, data: bytes, n_reply: int = 0) -> None:
        """Put a frame on the wire, behind what is on it.

        Raises
        ------
        LinkLost : the link is closed.
        """
        self._check()
        with self._guard:
            now_s = time.monotonic()
            self.log.append(data)
            self._free_s = max(self._free_s, now_s) + 10.0 * len(data) / self.baud
            self._waiting += self.wire.advance(now_s)
            self.wire.host_sent(data, now_s)

    def idle_in_s(self) -> float:
        """Return how long the bytes written so far still need."""
        return max(self._free_s - time.monotonic(), 0.0)

    def read_available(self) -> bytes:
        """Return what has arrived.

        Raises
        ------
        LinkLost : the link is closed.
        """
        self._check()
        with self._guard:
            self._waiting += self.wire.advance(time.monotonic())
            data = bytes(self._waiting)
            self._waiting.clear()
            return data

    def wait_readable(self, timeout_s: float) -> None:
        """Wait a little.

        Raises
        ------
        LinkLost : the link is closed.
        """
        self._check()
        time.sleep(min(timeout_s, _POLL_S))

    def _check(self) -> None:
        if not self._is_open:
            raise LinkLost("wire: the link is not open")


class Stop(NamedTuple):
    """One emergency stop.

    ``wire_s`` is from the call to its last byte, by the bytes alone, ``wall_s`` by the clock;
    ``n_ahead`` frames were written between the call and the stop, ``n_moves_after`` moves behind
    it; ``is_twice`` when it may have met an answer; ``is_holding`` says whether all servos stand
    still afterwards.
    """

    wire_s: float
    wall_s: float
    n_ahead: int
    n_moves_after: int
    is_twice: bool
    is_holding: bool


class Crowd:
    """Threads that keep a bus full: lists of moves, verified moves and reads.

    ``moves`` holds every frame that moves something.
    """

    def __init__(self, bus: Bus, seed: int) -> None:
        self.moves: Set[bytes] = set()
        self._bus = bus
        self._is_over = threading.Event()
        jobs = [(self._move, seed + at) for at in range(_N_MOVERS)]
        jobs += [(self._read, at) for at in range(_N_READERS)]
        self._threads = [threading.Thread(target=j, args=(n,), daemon=True) for j, n in jobs]
        for thread in self._threads:
            thread.start()

    def end(self) -> None:
        """End all threads."""
        self._is_over.set()
        for thread in self._threads:
            thread.join()

    def _move(self, seed: int) -> None:
        rng, dialect = random.Random(seed), self._bus.protocol
        low, high = dialect.ticks
        while not self._is_over.is_set():
            targets = [ServoTarget(i, rng.randint(low, high), 100) for i in IDS]
            frames = dialect.move(targets, _MOVE_MS)
            self.moves.update(frames)
            try:
                self._bus.send(frames * _N_QUEUED, Priority.MOVE)
                self._bus.move(targets, _MOVE_MS)
            except MotionRefused:
                time.sleep(_POLL_S)

    def _read(self, at: int) -> None:
        while not self._is_over.is_set():
            self._bus.read(Quantity.POSITION, (IDS[at % len(IDS)],))


def run(name: str, seed: int) -> Stop:
    """Fill a bus with moves and reads from several threads, and stop it at a random moment."""
    firmware, dialect = device(name, seed), protocol(name)
    link = WireLink(firmware, firmware.baud)
    bus = Bus(dialect, link)
    bus.open()
    crowd = Crowd(bus, seed)
    time.sleep(random.Random(seed).uniform(*_LET_RUN_S))
    frames = dialect.stop([ServoTarget(i, servos(firmware)[i].measured) for i in IDS])
    n_before, busy_s, called_s = len(link.log), link.idle_in_s(), time.monotonic()
    wall_s = bus.urgent(frames) - called_s
    time.sleep(_LET_RUN_S[0])
    crowd.end()
    link.read_available()
    is_holding = all(one.set_point == one.target for one in servos(firmware).values())
    bus.close()
    written = link.log[n_before:]
    first = written.index(frames[0])
    n_bytes = sum(len(frame) for frame in written[: first + len(frames)])
    n_after = sum(frame in crowd.moves for frame in written[first:])
    is_twice = written.count(frames[0]) > 1
    wire_s = busy_s + 10.0 * n_bytes / firmware.baud
    return Stop(wire_s, wall_s, first, n_after, is_twice, is_holding)


def measure(scale: float, seed: int) -> List[Line]:
    """Return the lines of a number of stops on an LX-16A line at 115200 baud."""
    n_stops = max(int(N_STOPS * scale), 1)
    stops: List[Stop] = []
    with Progress("stops", n_stops) as progress:
        for at in range(n_stops):
            stops.append(run("lx16a", seed + at))
            progress.advance()
    what = f"lx16a: {n_stops} stops, full queue"
    slowest_ms = 1e3 * max(stop.wire_s for stop in stops)
    walls_ms = sorted(1e3 * stop.wall_s for stop in stops)
    n_ahead = max(stop.n_ahead for stop in stops)
    n_after = sum(stop.n_moves_after for stop in stops)
    n_holding = sum(stop.is_holding for stop in stops)
    n_twice = sum(stop.is_twice for stop in stops)
    return [
        at_most(SUITE, f"{what}: call to last byte, slowest, ms of wire", slowest_ms, LIMIT_MS),
        at_most(SUITE, f"{what}: frames written before it, most", n_ahead, 1, "{:.0f}"),
        at_most(SUITE, f"{what}: moves behind it", n_after, 0, "{:.0f}"),
        at_least(SUITE, f"{what}: arm holds still afterwards", n_holding, n_stops, "{:.0f}"),
        note(SUITE, f"{what}: call to last byte, median, ms by the clock", walls_ms[n_stops // 2]),
        note(SUITE, f"{what}: call to last byte, slowest, ms by the clock", walls_ms[-1]),
        note(SUITE, f"{what}: sent again, since an answer was due", n_twice, "{:.0f}"),
    ]
