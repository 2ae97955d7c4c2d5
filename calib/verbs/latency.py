"""``apex calibrate latency``: how long a picture takes from exposure to the stamp it gets."""

import argparse
import sys
import time
from pathlib import Path
from typing import List, Sequence, Tuple

import numpy as np

from apex_edge.errors import ConfigError
from apex_edge.types import Array
from calib import blink, files
from calib.latency import LatencyResult, read_series, solve
from calib.latency_file import latency_document, settings_lines
from calib.latency_picture import draw
from calib.made import file_data, made
from calib.verbs import options
from calib.verbs.outcome import Ending, check_usable, deliver, refusal_told

HELP = "measure the camera's delay with a blinking or a moving target"
EXAMPLE = "apex calibrate latency --events led.csv --frames seen.csv --out latency.json"
DISPLAY = "terminal and display"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the two series, or the live camera, and the file to write."""
    parser.add_argument(
        "--events",
        type=Path,
        metavar="FILE.csv",
        help="the signal: header, then t_s,value a row; two values: a blinker, more: a motion",
    )
    parser.add_argument(
        "--frames",
        type=Path,
        metavar="FILE.csv",
        help="header, then t_s,response a row: each frame's stamp, and its brightness or position",
    )
    options.add_camera(parser)
    parser.add_argument(
        "--seconds", type=float, default=20.0, metavar="S", help="how long to blink (20)"
    )
    parser.add_argument(
        "--max-latency-s",
        type=float,
        default=0.5,
        metavar="S",
        help="longest delay looked for (0.5)",
    )
    options.add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Find the delay; write nothing but the recorded series unless it can be used.

    Raises
    ------
    ConfigError : neither both series nor a live camera. CameraError : live only, no picture.
    CalibrationError : a file cannot be used, or the verdict is a refusal.
    """
    with refusal_told(args.json) as figures:
        is_live = options.is_live(args, "events", "frames")
        paths = _record(args) if is_live else (args.events, args.frames)
        signal, response = (read_series(path) for path in paths)
        result = solve(signal, response, args.max_latency_s)
        includes = [DISPLAY] if is_live else []
        figures.update(result.figures(), includes=includes)
        check_usable(result.verdict)
        document = latency_document(result, includes, made(file_data(paths), figures))
        picture = draw(result, signal, response)
        return deliver(args, Ending(document, picture, figures, _lines(result, includes)))


def _record(args: argparse.Namespace) -> Tuple[Path, Path]:
    """Blink and watch; returns the files of both series, kept beside the result."""
    if not sys.stderr.isatty():
        raise ConfigError("a live camera needs a terminal that can blink; this is none")
    if not 5.0 <= args.seconds <= 300.0:
        raise ConfigError(f"--seconds {args.seconds:g} is outside [5, 300]")
    bench = options.bench_of(args)
    terminal = blink.Terminal(sys.stderr)
    with bench.open_camera() as camera:
        try:
            both = blink.watch(
                camera,
                terminal.show,
                np.random.RandomState(0),
                time.monotonic,
                time.sleep,
                args.seconds,
            )
        finally:
            terminal.restore()
    events = args.out.with_name(f"{args.out.stem}-events.csv")
    frames = args.out.with_name(f"{args.out.stem}-frames.csv")
    texts = {path: _text(series).encode("ascii") for path, series in zip((events, frames), both)}
    files.write_whole(texts)
    return events, frames


def _text(series: Tuple[Array, Array]) -> str:
    return "t_s,value\n" + "".join(f"{t:.6f},{value:.6g}\n" for t, value in zip(*series))


def _lines(result: LatencyResult, includes: Sequence[str]) -> List[str]:
    what = f"; {' and '.join(includes)} included, so the camera's own is less" if includes else ""
    return [
        f"{result.verdict.grade}: {1e3 * result.latency_s:.1f} ms +- {1e3 * result.sd_s:.1f} (sd) "
        f"from mid-exposure to the stamp{what}",
        f"  explains {result.explained:.0%} of what {result.n_frames} frames show over "
        f"{result.n_changes} changes of the signal",
        *(f"  {reason}" for reason in result.verdict.reasons),
        "lines for the settings file:",
        *settings_lines(result),
    ]
