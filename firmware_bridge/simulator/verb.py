"""``apex sim-arm``: a simulated arm on a serial port, for this program and for any other."""

import argparse
import contextlib
import logging
import os
import threading
from pathlib import Path
from typing import Iterator, Optional

from firmware_bridge.errors import PortError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.faults import read_json
from firmware_bridge.simulator.log import BoardLog
from firmware_bridge.simulator.make import FAMILIES, Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving

HELP = "simulate an arm's servos on a serial port, with real bytes, and with faults if you like"
EXAMPLE = "apex sim-arm --protocol lx16a --link /tmp/arm --seconds 60"

_log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    parser.add_argument("--protocol", required=True, choices=tuple(FAMILIES))
    parser.add_argument("--link", required=True, type=Path, help="name of the port to make")
    parser.add_argument("--arm", default="", help="name or file of an arm (default: ids 1 to 6)")
    parser.add_argument("--faults", type=Path, help="fault script, see docs/hardware/simulator.md")
    parser.add_argument("--seed", type=int, default=0, help="of all chance (default: 0)")
    parser.add_argument("--log", type=Path, help="write every byte and command here (JSONL)")
    parser.add_argument("--echo", action="store_true", help="loop the host's bytes back")
    parser.add_argument("--seconds", type=float, help="stop after this long (default: Ctrl-C)")
    parser.add_argument("--no-pacing", action="store_true", help="bytes take no time")


def run(args: argparse.Namespace) -> int:
    """Serve until the time is over, Ctrl-C or SIGTERM; the link is gone afterwards.

    Raises
    ------
    PortError : the link or the log cannot be made.
    SimulatorFileError : a fault script that is not one.
    """
    faults = None if args.faults is None else read_json(args.faults)
    setup = Setup(args.protocol, args.arm, (), args.seed, faults)
    firmware = setup.firmware()
    options = setup.wire(args.echo, not args.no_pacing)
    with _log_of(args.log, firmware, setup) as log:
        board = PtyBoard(firmware, args.link, options, log)
        with serving(board):
            baud = firmware.baud
            print(f"{args.link}: {args.protocol} at {baud} baud, device {os.readlink(args.link)}")
            print("  open it like any serial port at that rate; Ctrl-C ends it", flush=True)
            _wait(args.seconds)
    return 0


def _wait(seconds: Optional[float]) -> None:
    # in pieces: a lock held for good is not interrupted by signals everywhere
    never = threading.Event()
    if seconds is not None:
        never.wait(seconds)
        return
    while True:
        never.wait(3600.0)


@contextlib.contextmanager
def _log_of(path: Optional[Path], firmware: Firmware, setup: Setup) -> Iterator[Optional[BoardLog]]:
    if path is None:
        yield None
        return
    try:
        stream = path.open("w", encoding="utf-8", buffering=1)
    except OSError as error:
        raise PortError(f"{path}: the log cannot be written: {error}") from error
    with stream:
        yield BoardLog(stream, firmware, setup.header())
