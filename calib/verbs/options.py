"""Options that calibrations share: the board, the pictures, a live camera, the file to write."""

import argparse
import glob
from pathlib import Path
from typing import List, Optional, Sequence

from apex_edge.cameras.calibration import load_intrinsics
from apex_edge.errors import ConfigError, RecordingError
from apex_edge.types import Intrinsics
from calib.boards import FORMS, Board, parse_board
from calib.settings import Bench


def add_board(parser: argparse._ActionsContainer, is_required: bool = True) -> None:
    """Declare the board: its kind and counts, its squares, its markers."""
    parser.add_argument("--board", required=is_required, metavar="BOARD", help=FORMS)
    parser.add_argument(
        "--square-mm",
        required=is_required,
        type=float,
        metavar="MM",
        help="side of a square, measured on the paper",
    )
    parser.add_argument(
        "--marker-mm",
        type=float,
        default=0.0,
        metavar="MM",
        help="side of a ChArUco marker; default 0.7 squares",
    )


def add_images(parser: argparse.ArgumentParser) -> None:
    """Declare the pictures; the option may be repeated, and a pattern be quoted or not."""
    parser.add_argument(
        "--images",
        action="append",
        nargs="+",
        metavar="GLOB",
        help="pictures of the board, e.g. 'shots/*.jpg'",
    )


def add_camera(parser: argparse.ArgumentParser) -> None:
    """Declare a live camera, as ``apex record`` does."""
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="settings of the live camera (and arm)"
    )
    parser.add_argument("--camera", metavar="NAME", help="camera plug-in, e.g. live or board")
    parser.add_argument("--path", help="its device or URL; for board e.g. charuco:7x5@25")


def add_lens(parser: argparse.ArgumentParser) -> None:
    """Declare the file of the lens."""
    parser.add_argument(
        "--camera-file",
        type=Path,
        metavar="FILE",
        help="from apex calibrate intrinsics; default: calibration of [camera] in --config",
    )


def add_out(parser: argparse.ArgumentParser, what: str = "file to write") -> None:
    """Declare the file to write, and JSON on standard output."""
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=what)
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def board_of(args: argparse.Namespace) -> Board:
    """Return the board that the options name.

    Raises
    ------
    ConfigError : none is named. CalibrationError : there is no such board.
    """
    if args.board is None or args.square_mm is None:
        raise ConfigError("give the board and its measured squares: --board and --square-mm")
    return parse_board(args.board, 1e-3 * args.square_mm, 1e-3 * args.marker_mm)


def is_live(args: argparse.Namespace, *files: str) -> bool:
    """Say whether a camera is named, and not the options of that name, of which all are needed.

    Raises
    ------
    ConfigError : both, neither, or some.
    """
    given = [getattr(args, name) is not None for name in files]
    is_camera = args.config is not None or args.camera is not None
    if any(given) != all(given) or is_camera == all(given):
        wanted = " and ".join(f"--{name}" for name in files)
        raise ConfigError(f"give either {wanted} or a camera (--camera or --config)")
    return is_camera


def bench_of(args: argparse.Namespace) -> Bench:
    """Return the camera and arm that the options name.

    Raises
    ------
    ConfigError : the settings file cannot be used.
    """
    return Bench.read(args.config, args.camera, args.path)


def lens_of(args: argparse.Namespace) -> Intrinsics:
    """Return the lens that the options name.

    Raises
    ------
    ConfigError : none is named. CalibrationError : the file cannot be used.
    """
    return load_intrinsics(lens_file(args))


def lens_file(args: argparse.Namespace) -> Path:
    """Return the file of the lens.

    Raises
    ------
    ConfigError : none is named.
    """
    named: Optional[Path] = args.camera_file
    if named is None and args.config is not None:
        in_settings = bench_of(args).camera.calibration
        named = Path(in_settings) if in_settings else None
    if named is None:
        raise ConfigError(
            "the lens is not known: give --camera-file, or calibration under [camera] of --config"
        )
    return named


def expand(given: Sequence[Sequence[str]]) -> List[Path]:
    """Return the files of all patterns, sorted per pattern, each file once.

    Raises
    ------
    RecordingError : a pattern that matches no file.
    """
    found: List[Path] = []
    for pattern in (pattern for patterns in given for pattern in patterns):
        names = sorted(glob.glob(pattern))  # noqa: PTH207  Path.glob takes no absolute pattern
        files = [path for path in map(Path, names) if path.is_file()]
        if not files:
            raise RecordingError(f"{pattern}: no such file")
        found += [path for path in files if path not in found]
    return found
