"""``apex calibrate board``: print a calibration board at true scale."""

import argparse
import json

from apex_edge.errors import CalibrationError
from calib import files
from calib.board_sheet import PAPERS_MM, lay_out, to_pdf, to_png
from calib.verbs.options import add_board, add_out, board_of
from calib.verbs.outcome import refusal_told

HELP = "print a calibration board at true scale"
EXAMPLE = "apex calibrate board --board charuco:7x5 --square-mm 25 --paper a4 --out board.pdf"
WRITERS = {".pdf": to_pdf, ".png": to_png}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the board, the paper and the file to write."""
    add_board(parser)
    parser.add_argument("--paper", choices=sorted(PAPERS_MM), default="a4", help="default a4")
    add_out(parser, "board.pdf or board.png")


def run(args: argparse.Namespace) -> int:
    """Write the sheet.

    Raises
    ------
    CalibrationError : no such board, it does not fit the paper, or neither PDF nor PNG is asked.
    """
    with refusal_told(args.json) as figures:
        writer = WRITERS.get(args.out.suffix.lower())
        if writer is None:
            raise CalibrationError(f"{args.out}: expected a name that ends in .pdf or .png")
        board = board_of(args)
        figures.update(board=board.name, size_mm=[1e3 * side for side in board.size_m])
        files.write_whole({args.out: writer(lay_out(board, args.paper))})
    if args.json:
        print(json.dumps({**figures, "out": str(args.out)}))
        return 0
    print(f"wrote {args.out}: board {board.name}; print at 100 % and check the 100 mm line")
    if board.is_ambiguous:
        print("this chessboard looks the same upside down: good for the lens, not for the table")
    return 0
