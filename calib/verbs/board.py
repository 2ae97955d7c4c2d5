"""``apex calibrate board``: print a calibration board at true scale."""

import argparse
import json
from pathlib import Path

from apex_edge.errors import CalibrationError
from calib import files
from calib.board_sheet import PAPERS_MM, lay_out, to_pdf, to_png
from calib.verbs.board_options import add_board, board_of

HELP = "print a calibration board at true scale"
EXAMPLE = "apex calibrate board --board charuco:7x5 --square-mm 25 --paper a4 --out board.pdf"
WRITERS = {".pdf": to_pdf, ".png": to_png}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the board, the paper and the file to write."""
    add_board(parser)
    parser.add_argument("--paper", choices=sorted(PAPERS_MM), default="a4", help="default a4")
    parser.add_argument("--out", required=True, metavar="FILE", help="board.pdf or board.png")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Write the sheet.

    Raises
    ------
    CalibrationError : no such board, it does not fit the paper, or neither PDF nor PNG is asked.
    """
    out = Path(args.out)
    writer = WRITERS.get(out.suffix.lower())
    if writer is None:
        raise CalibrationError(f"{out}: expected a name that ends in {' or '.join(WRITERS)}")
    board = board_of(args)
    sheet = lay_out(board, args.paper)
    files.write_whole({out: writer(sheet)})
    if args.json:
        size_mm = [1e3 * side for side in board.size_m]
        print(json.dumps({"board": board.name, "size_mm": size_mm, "out": str(out)}))
        return 0
    print(f"wrote {out}: board {board.name}; print at 100 % and check the 100 mm line")
    if board.is_ambiguous:
        print("this chessboard looks the same upside down: good for the lens, not for the table")
    return 0
