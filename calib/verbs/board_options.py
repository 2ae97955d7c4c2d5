"""Options that the calibrations with a printed board share."""

import argparse
import glob
import json
from pathlib import Path
from typing import Any, Dict, List, Sequence

from apex_edge.errors import ApexError, RecordingError
from calib.boards import FORMS, Board, parse_board
from calib.verdict import REFUSE


def add_board(parser: argparse.ArgumentParser, is_required: bool = True) -> None:
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
    parser.add_argument("--config", metavar="FILE", help="settings file with a [camera] section")
    parser.add_argument(
        "--camera", metavar="NAME", help="camera plug-in: live, or board for a simulated one"
    )
    parser.add_argument("--path", help="device or URL; for board e.g. charuco:7x5@25")


def board_of(args: argparse.Namespace) -> Board:
    """Return the board that the options name.

    Raises
    ------
    CalibrationError : there is no such board.
    """
    return parse_board(args.board, 1e-3 * args.square_mm, 1e-3 * args.marker_mm)


def picture_beside(out: Path) -> Path:
    """Return the name of the picture that shows a result, never that of the result itself."""
    shown = out.with_suffix(".png")
    return out.with_name(out.stem + "-shown.png") if shown == out else shown


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


def print_refusal(error: ApexError, figures: Dict[str, Any]) -> None:
    """Print the JSON of a calibration that ended in an error: verdict, reasons, what is known."""
    print(json.dumps({"verdict": REFUSE, "reasons": [str(error)], **figures}))
