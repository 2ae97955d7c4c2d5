"""Verified reads per second on a real pseudo-terminal, beside three independent libraries.

The simulated device runs in a process of its own and answers at once (the line is not paced), so
that what is measured is the host's code. Ours checks id, command, length, range and plausibility of
every answer. The libraries take turns and the best round of each counts, since whatever else the
machine does only makes a round slower. Source: ours.
"""

import contextlib
import multiprocessing
import os
import time
import tty
from typing import Callable, Dict, Iterator, List, Optional

import serial

from apex_edge.verbs.progress import Progress
from firmware_bridge.bus import Bus
from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity
from firmware_bridge.links.serial_link import SerialLink
from offline_train.benchmarks.firmware.devices import IDS, device
from offline_train.benchmarks.firmware.peers import load
from offline_train.benchmarks.lines import Line, at_least, note

SUITE = "throughput"
N_READS = 6000
N_ROUNDS = 7
GOAL_HZ = 3000.0
_CHUNK = 4096
_STEP_S, _N_STEPS = 0.0005, 10  # a servo's own delay passes in simulated time, not in real time
_STS_POSITION = 56

ReadOne = Callable[[int], Optional[int]]
"""Servo id -> position, None when it could not be read."""


@contextlib.contextmanager
def served(name: str) -> Iterator[str]:
    """Run a simulated device in its own process; gives the port."""
    master, slave = os.openpty()
    tty.setraw(slave)
    process = multiprocessing.get_context("fork").Process(target=_serve, args=(master, name))
    process.daemon = True
    process.start()
    try:
        yield os.ttyname(slave)
    finally:
        process.terminate()
        process.join()
        os.close(master)
        os.close(slave)


def _serve(master: int, name: str) -> None:
    firmware = device(name, 0)
    while True:
        firmware.feed(os.read(master, _CHUNK))
        for _ in range(_N_STEPS):
            answer = firmware.replies()
            if answer:
                os.write(master, answer)
                break
            firmware.step(_STEP_S)


def rate_hz(read: ReadOne, n_reads: int) -> float:
    """Return reads per second; one that failed does not count, a wrong one makes it NaN."""
    began_s = time.perf_counter()
    values = [read(IDS[at % len(IDS)]) for at in range(n_reads)]
    lasted_s = time.perf_counter() - began_s
    right = [value for value in values if value is not None]
    return len(right) / lasted_s if len(set(right)) <= 1 else float("nan")


def measure(scale: float, seed: int) -> List[Line]:
    """Return rates on an LX-16A and an STS line, ours and those of the libraries."""
    n_reads = max(int(N_READS * scale / N_ROUNDS), 1)
    lines: List[Line] = []
    for name, readers in (("lx16a", LX_READERS), ("sts", STS_READERS)):
        rates = _rates(name, readers, n_reads)
        ours = rates.pop("ours") or 0.0
        what = f"{name}: verified reads/s on a pty"
        lines.append(at_least(SUITE, what, ours, GOAL_HZ, "{:.0f}"))
        for peer, rate in rates.items():
            if rate is None:
                lines.append(Line(SUITE, f"{what}, {peer}", "not installed"))
                continue
            lines.append(note(SUITE, f"{what}, {peer}", rate, "{:.0f}"))
            ratio = ours / rate if rate else float("nan")
            lines.append(note(SUITE, f"{name}: ours / {peer}", ratio, "{:.2f}"))
    return lines


def _rates(
    name: str, readers: Dict[str, Callable[[str], Iterator[Optional[ReadOne]]]], n_reads: int
) -> Dict[str, Optional[float]]:
    """Return the best rate of each reader, None for a library that is not there."""
    found: Dict[str, List[float]] = {who: [] for who in readers}
    with served(name) as port, Progress("rounds", N_ROUNDS) as progress:
        for _ in range(N_ROUNDS):
            for who, reader in readers.items():
                with contextlib.contextmanager(reader)(port) as read:
                    if read is not None:
                        found[who].append(rate_hz(read, n_reads))
            progress.advance()
    return {who: max(rates) if rates else None for who, rates in found.items()}


def _ours(name: str) -> Callable[[str], Iterator[Optional[ReadOne]]]:
    def reader(port: str) -> Iterator[Optional[ReadOne]]:
        dialect = protocol(name)
        bus = Bus(dialect, SerialLink(port, dialect.baud))
        bus.open()

        def read(servo_id: int) -> Optional[int]:
            found = bus.read(Quantity.POSITION, (servo_id,))
            return found[servo_id].values[0] if found else None

        yield read
        bus.close()

    return reader


def _lewansoul(port: str) -> Iterator[Optional[ReadOne]]:
    module = load("lewansoul-lx16a", "lewansoul_lx16a")
    if module is None:
        yield None
        return
    with serial.Serial(port, 115200) as line:
        yield module.ServoController(line, timeout=0.5).get_position


def _pylx16a(port: str) -> Iterator[Optional[ReadOne]]:
    module = load("pylx16a", "pylx16a.lx16a")
    if module is None:
        yield None
        return
    module.LX16A.initialize(port, 0.5)
    servos = {servo_id: module.LX16A(servo_id) for servo_id in IDS}
    yield lambda servo_id: round(servos[servo_id].get_physical_angle() * 25 / 6)
    module.LX16A._controller.close()
    module.LX16A._controller = None


def _feetech(port: str) -> Iterator[Optional[ReadOne]]:
    module = load("feetech-servo-sdk", "scservo_sdk")
    if module is None:
        yield None
        return
    line = module.PortHandler(port)
    line.openPort()
    line.setBaudRate(1_000_000)
    packets = module.PacketHandler(0)

    def read(servo_id: int) -> Optional[int]:
        value, result, _ = packets.read2ByteTxRx(line, servo_id, _STS_POSITION)
        return int(value) if result == module.COMM_SUCCESS else None

    yield read
    line.closePort()


LX_READERS = {"ours": _ours("lx16a"), "lewansoul-lx16a": _lewansoul, "pylx16a": _pylx16a}
STS_READERS = {"ours": _ours("sts"), "feetech-servo-sdk": _feetech}
