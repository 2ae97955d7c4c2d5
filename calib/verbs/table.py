"""``apex calibrate table``: where the camera stands over the table."""

import argparse
import itertools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from apex_edge import documents
from apex_edge.cameras import calibration
from apex_edge.errors import CalibrationError, ConfigError
from apex_edge.types import Array, Intrinsics
from calib import files, sources, table, table_picture
from calib.boards import Board, require_origin
from calib.detect import detect
from calib.made import Data, file_data, made, raw_data
from calib.table import Placement, Sighting
from calib.verbs import options
from calib.verbs.outcome import Ending, check_usable, deliver, refusal_told

HELP = "measure where the camera stands over the table"
EXAMPLE = (
    "apex calibrate table --camera-file camera.json --images table.png --board charuco:7x5 "
    "--square-mm 25 --origin-mm 120,-60 --thickness-mm 3 --out camera.json"
)
LIVE_FRAMES, LIVE_TRIES = 10, 100


@dataclass(frozen=True)
class _Data:
    """What was measured, a picture to draw on with the last sighting in it, and the raw data."""

    sightings: Tuple[Sighting, ...]
    picture: Optional[Array]
    data: Data
    paths: Tuple[Path, ...] = ()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the lens, the pictures, the board and its place, and the file to write."""
    options.add_lens(parser)
    options.add_images(parser)
    options.add_camera(parser)
    options.add_board(parser, is_required=False)
    parser.add_argument(
        "--origin-mm",
        action="append",
        type=parse_origin,
        metavar="X,Y[,DEG]",
        help="where the board's origin lies on the table (x forward, y left of the arm's base "
        "axis), and how far its x axis is turned to the left; once for all pictures, or once for "
        "each --images; for a negative x write --origin-mm=-50,20",
    )
    parser.add_argument(
        "--thickness-mm", type=float, default=0.0, metavar="MM", help="of board and plate"
    )
    parser.add_argument(
        "--point",
        action="append",
        type=parse_point,
        metavar="PX,PY=X,Y",
        help="instead of a board: a pixel and its place on the table in mm; at least four",
    )
    options.add_out(parser, "camera file to write")


def parse_origin(text: str) -> Placement:
    """Read ``X,Y`` or ``X,Y,DEG``, in mm and degrees.

    Raises
    ------
    argparse.ArgumentTypeError : not of that form.
    """
    values = _numbers(text, (2, 3), "X,Y or X,Y,DEG")
    return Placement(1e-3 * values[0], 1e-3 * values[1], math.radians([*values, 0.0][2]))


def parse_point(text: str) -> Tuple[float, ...]:
    """Read ``PX,PY=X,Y``: a pixel, and its place in mm; returns both in px and m.

    Raises
    ------
    argparse.ArgumentTypeError : not of that form.
    """
    pixel, _, place = text.partition("=")
    form = "PX,PY=X,Y"
    in_mm = _numbers(place, (2,), form)
    return (*_numbers(pixel, (2,), form), 1e-3 * in_mm[0], 1e-3 * in_mm[1])


def _numbers(text: str, counts: Sequence[int], form: str) -> List[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in counts or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form {form}")
    return values


def run(args: argparse.Namespace) -> int:
    """Find the camera's place; write nothing unless it can be used.

    Raises
    ------
    CalibrationError : no board, or a pose that cannot be trusted; the message says why.
    RecordingError : a picture cannot be read. CameraError : the camera gives no frames.
    """
    with refusal_told(args.json) as figures:
        lens_file = options.lens_file(args)
        lens = calibration.load_intrinsics(lens_file)
        found = _by_hand(args, lens) if args.point else _by_board(args, lens)
        figures.update(_about(args))
        result = table.solve(lens, found.sightings, 1e-3 * args.thickness_mm)
        figures.update(result.figures())
        check_usable(result.verdict)
        about = made(found.data, {**figures, "lens": _lens_made(lens_file)})
        document = calibration.camera_document(result.camera, about)
        picture = table_picture.draw(found.picture, result, found.sightings[-1])
        return deliver(args, Ending(document, picture, figures, _lines(result)), found.paths)


def _by_hand(args: argparse.Namespace, lens: Intrinsics) -> _Data:
    if args.origin_mm or args.board or args.camera or args.config:
        raise ConfigError("give either --point or a board with its --origin-mm, not both")
    picture = None
    paths = options.expand(args.images or [])
    for path in paths:
        picture = files.read_picture(path)
        calibration.check_size(lens, picture, str(path))
    values = np.array(args.point)
    is_outside = (values[:, :2] < 0) | (values[:, :2] > (lens.width_px, lens.height_px))
    if is_outside.any():
        raise CalibrationError(
            f"--point {values[is_outside.any(axis=1)][0, :2].tolist()} lies outside the "
            f"{lens.width_px}x{lens.height_px} picture"
        )
    seen = table.points(values[:, :2], values[:, 2:])
    return _Data((seen,), picture, raw_data([values.tobytes()]), tuple(paths))


def _by_board(args: argparse.Namespace, lens: Intrinsics) -> _Data:
    if not (args.board and args.square_mm and args.origin_mm):
        raise ConfigError("give --board, --square-mm and --origin-mm, or --point at least 4 times")
    is_live = options.is_live(args, "images")
    board = options.board_of(args)
    require_origin(board)
    if is_live:
        return _from_camera(args, lens, board)
    groups = [options.expand([given]) for given in args.images]
    if len(args.origin_mm) not in (1, len(groups)):
        raise ConfigError(
            f"{len(args.origin_mm)} --origin-mm for {len(groups)} --images; give one for all, or "
            "one for each"
        )
    seen: List[Sighting] = []
    for paths, where in zip(groups, itertools.cycle(args.origin_mm)):
        for path in paths:
            picture = files.read_picture(path)
            seen.append(_look(picture, lens, board, (where, str(path))))
    paths = [path for group in groups for path in group]
    return _Data(tuple(seen), picture, file_data(paths), tuple(paths))


def _look(picture: Array, lens: Intrinsics, board: Board, where: Tuple[Placement, str]) -> Sighting:
    """Return the board in one picture as points of the table."""
    calibration.check_size(lens, picture, where[1])
    view = detect(picture, board, where[1])
    if view is None:
        raise CalibrationError(f"{where[1]}: the board {board.name} was not found")
    return table.place(view, board, where[0])


def _from_camera(args: argparse.Namespace, lens: Intrinsics, board: Board) -> _Data:
    if len(args.origin_mm) != 1:
        raise ConfigError("a live camera sees one board in one place: give one --origin-mm")
    seen: List[Sighting] = []
    for _, picture in itertools.islice(sources.frames(options.bench_of(args)), LIVE_TRIES):
        calibration.check_size(lens, picture, "camera")
        view = detect(picture, board, f"frame {len(seen) + 1}")
        if view is not None:
            seen.append(table.place(view, board, args.origin_mm[0]))
            shown = picture
        if len(seen) == LIVE_FRAMES:
            pixels = (sighting.pixels.tobytes() for sighting in seen)
            return _Data(tuple(seen), shown, raw_data(pixels))
    raise CalibrationError(
        f"the camera showed the board {board.name} in {len(seen)} of {LIVE_TRIES} frames, "
        f"{LIVE_FRAMES} are needed"
    )


def _about(args: argparse.Namespace) -> Dict[str, Any]:
    if args.point:
        return {"points_px_m": [list(point) for point in args.point]}
    places = [[1e3 * p.x_m, 1e3 * p.y_m, math.degrees(p.angle_rad)] for p in args.origin_mm]
    return {
        "board": options.board_of(args).name,
        "square_mm": args.square_mm,
        "origin_mm_deg": places,
    }


def _lens_made(path: Path) -> Any:
    """Return how the lens was measured: --out may replace the only file that says so."""
    kind, version = calibration.FORMAT, calibration.VERSION
    about = documents.read(path, kind, version, CalibrationError).get("made", {})
    # a camera that is placed again keeps its lens' history, not that of all its places
    return about.get("lens", about) if isinstance(about, dict) else {}


def _lines(result: table.TableResult) -> List[str]:
    eye, sd = 1e3 * result.camera.table_from_cam[:3, 3], 1e3 * result.sd_translation_m
    return [
        f"{result.verdict.grade}: left-out points foretold to {result.left_out_mm:.2f} mm, "
        f"the workspace's map moves by {result.workspace_mm:.2f} mm",
        f"RMS {result.rms_px:.3f} px over {len(result.residuals_px)} points; camera at "
        f"x {eye[0]:.1f} +- {sd[0]:.1f}  y {eye[1]:.1f} +- {sd[1]:.1f}  "
        f"z {eye[2]:.1f} +- {sd[2]:.1f} mm",
        *(f"  {reason}" for reason in result.verdict.reasons),
    ]
