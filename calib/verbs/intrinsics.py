"""``apex calibrate intrinsics``: the lens, from pictures of a board or live."""

import argparse
import json
from pathlib import Path
from typing import Any, Dict, List

from apex_edge import documents
from apex_edge.cameras.calibration import camera_document
from apex_edge.errors import ApexError, CalibrationError, ConfigError
from calib import files, intrinsics, lens_picture, sources
from calib.boards import Board
from calib.made import made
from calib.verbs.board_options import (
    add_board,
    add_camera,
    add_images,
    board_of,
    expand,
    picture_beside,
    print_refusal,
)

HELP = "measure the lens from pictures of a board, or live"
EXAMPLE = (
    "apex calibrate intrinsics --images 'shots/*.jpg' --board 9x6 --square-mm 25 --out camera.json"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the pictures or the camera, the board and the file to write."""
    add_images(parser)
    add_camera(parser)
    add_board(parser)
    parser.add_argument("--out", required=True, metavar="FILE", help="camera file to write")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Calibrate the lens; write nothing unless it can be used.

    Raises
    ------
    CalibrationError : the views do not determine a lens; the message says why.
    RecordingError : a picture cannot be read. CameraError : the camera gives no frames.
    """
    out = Path(args.out)
    figures: Dict[str, Any] = {}
    try:
        board = board_of(args)
        source = _source(args, board, out)
        figures = {"n_found": len(source.views), "not_found": list(source.not_found)}
        result = intrinsics.solve(source.views, source.size_px, board)
        figures.update(result.figures())
        if result.verdict.is_refused:
            raise CalibrationError(f"nothing written: {'; '.join(result.verdict.reasons)}")
    except ApexError as error:
        if args.json:
            print_refusal(error, figures)
        raise
    shown = picture_beside(out)
    about = {"board": board.name, "square_mm": 1e3 * board.square_m, **figures}
    document = camera_document(result.lens, made(source.data_sha256, result.verdict, **about))
    picture = files.encode_png(lens_picture.draw(result))
    files.write_whole({shown: picture, out: documents.to_text(document).encode("utf-8")})
    if args.json:
        where = {"out": str(out), "picture": str(shown)}
        print(json.dumps({**result.verdict.plain(), **about, **where}))
    else:
        print("\n".join([*_lines(result), f"wrote {out} and {shown}"]))
    return 0


def _source(args: argparse.Namespace, board: Board, out: Path) -> sources.Source:
    is_live = args.config is not None or args.camera is not None
    if is_live == bool(args.images):
        raise ConfigError("give either --images or a camera (--camera or --config)")
    if not is_live:
        return sources.from_files(expand(args.images), board)
    settings = sources.camera_settings(args.config, args.camera, args.path)
    preview = out.with_name(out.stem + "-preview.png")
    sources.to_stderr(f"show the board {board.name}; {preview} shows what is covered")
    return sources.from_camera(settings, board, preview, sources.to_stderr)


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
