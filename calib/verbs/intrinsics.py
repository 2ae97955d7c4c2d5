"""``apex calibrate intrinsics``: the lens, from pictures of a board or live."""

import argparse
from typing import List

from apex_edge.cameras.calibration import camera_document
from calib import intrinsics, lens_picture, sources
from calib.boards import Board
from calib.made import made
from calib.verbs import options
from calib.verbs.outcome import Ending, check_usable, deliver, refusal_told

HELP = "measure the lens from pictures of a board, or live"
EXAMPLE = (
    "apex calibrate intrinsics --images 'shots/*.jpg' --board 9x6 --square-mm 25 --out camera.json"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the pictures or the camera, the board and the file to write."""
    options.add_images(parser)
    options.add_camera(parser)
    options.add_board(parser)
    options.add_out(parser, "camera file to write")


def run(args: argparse.Namespace) -> int:
    """Calibrate the lens; write nothing unless it can be used.

    Raises
    ------
    CalibrationError : the views do not determine a lens; the message says why.
    RecordingError : a picture cannot be read. CameraError : the camera gives no frames.
    """
    with refusal_told(args.json) as figures:
        board = options.board_of(args)
        source = _source(args, board)
        figures.update(board=board.name, square_mm=1e3 * board.square_m)
        figures.update(n_found=len(source.views), not_found=list(source.not_found))
        result = intrinsics.solve(source.views, source.size_px, board)
        figures.update(result.figures())
        check_usable(result.verdict)
        document = camera_document(result.lens, made(source.data, figures))
        ending = Ending(document, lens_picture.draw(result), figures, _lines(result))
        return deliver(args, ending, source.paths)


def _source(args: argparse.Namespace, board: Board) -> sources.Source:
    if not options.is_live(args, "images"):
        return sources.from_files(options.expand(args.images), board)
    bench = options.bench_of(args)
    preview = args.out.with_name(args.out.stem + "-preview.png")
    sources.to_stderr(f"show the board {board.name}; {preview} shows what is covered")
    return sources.from_camera(bench, board, preview, sources.to_stderr)


def _lines(result: intrinsics.IntrinsicsResult) -> List[str]:
    lens, sd = result.lens, result.sd_px
    lines = [
        f"{result.verdict.grade}: RMS {result.rms_px:.3f} px over {len(result.views)} views of "
        f"{lens.width_px}x{lens.height_px}",
        f"fx {lens.fx_px:.2f} +- {sd[0]:.2f}  fy {lens.fy_px:.2f} +- {sd[1]:.2f}  "
        f"cx {lens.cx_px:.2f} +- {sd[2]:.2f}  cy {lens.cy_px:.2f} +- {sd[3]:.2f} px; "
        f"jackknife of fx +- {result.jackknife_px:.2f}",
    ]
    lines += [f"  {reason}" for reason in result.verdict.reasons]
    return lines + [f"  left out {bad.name}: {bad.reason}" for bad in result.rejected]
