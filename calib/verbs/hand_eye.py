"""``apex calibrate hand-eye``: where the camera sits on the gripper."""

import argparse
import sys
import time
from pathlib import Path
from typing import List, Optional, Tuple

import cv2
import numpy as np

from apex_edge.cameras.calibration import load_intrinsics
from apex_edge.errors import ConfigError
from apex_edge.geometry import camera_matrix
from apex_edge.types import Array, Intrinsics
from calib import files, hand_eye_live
from calib.hand_eye import HandEyeResult, solve
from calib.hand_eye_file import hand_eye_document
from calib.hand_eye_picture import draw
from calib.made import files_digest, made
from calib.pose_pairs import pairs_text, read_pairs
from calib.rigid import pose
from calib.settings import Bench
from calib.verbs.moving import confirm
from calib.verbs.outcome import Told, check_usable, deliver, faults_told
from firmware_bridge.ready import ReadyArm

HELP = "find where the camera sits on the gripper"
EXAMPLE = "apex calibrate hand-eye --pairs pairs.csv --out handeye.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the pose pairs, or the arm that gets them, and the file to write."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--pairs",
        type=Path,
        metavar="FILE.csv",
        help="pose pairs: header, then base->gripper x,y,z,qx,qy,qz,qw and camera->target likewise",
    )
    source.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="settings of a live camera and arm: it will move",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="file to write")
    parser.add_argument(
        "--refine",
        action="store_true",
        help="let the non-linear refinement win as well; for arms more exact than the camera",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    live = parser.add_argument_group("with --config")
    live.add_argument(
        "--arm-poses", default="auto", metavar="auto|FILE", help="joints in degrees, a row a pose"
    )
    live.add_argument("--aim", type=_place, default=(0.2, 0.0), metavar="x,y", help="board, m")
    live.add_argument("--board", type=_board, default=(9, 6), metavar="9x6", help="inner corners")
    live.add_argument("--square-mm", type=float, help="measured side of a square; no default")
    live.add_argument("--yes", action="store_true", help="let the arm move without asking")


def run(args: argparse.Namespace) -> int:
    """Solve pose pairs; write nothing but the pairs unless the result can be used.

    Raises
    ------
    CalibrationError : the file cannot be used, or the verdict is a refusal.
    ArmError, CameraError : live only; the arm was stopped.
    """
    source = args.pairs if args.pairs is not None else _collect(args)
    with faults_told(args.json):
        pairs = read_pairs(source)
    result = solve(pairs, args.refine)
    figures = result.figures()
    check_usable(result.verdict, figures, str(source), args.json)
    found = result.solution
    assert found is not None  # only a refusal has none
    per_pose = [
        {"row": int(row), "error_mm": float(mm), "error_deg": float(deg)}
        for row, mm, deg in zip(found.row, found.error_mm, found.error_deg)
    ]
    about = made(
        files_digest([source]),
        result.verdict,
        pairs=source.name,
        per_pose=per_pose,
        **{key: value for key, value in figures.items() if key not in ("verdict", "reasons")},
    )
    document = hand_eye_document(found.gripper_from_cam, about)
    deliver(args.out, document, draw(result), Told(figures, _lines(result), args.json))
    return 0


def _collect(args: argparse.Namespace) -> Path:
    """Drive the arm through its poses; returns the file of pairs, kept beside the result."""
    if args.square_mm is None or not 1.0 <= args.square_mm <= 200.0:
        raise ConfigError(f"--square-mm must be given, 1 to 200 mm; found {args.square_mm}")
    bench = Bench.read(args.config)
    arm = bench.model()
    if not bench.camera.calibration:
        raise ConfigError(f"{args.config} [camera]: calibration must name the lens's file")
    lens = load_intrinsics(bench.camera.calibration)
    if args.arm_poses == "auto":
        aim_m = np.array([*args.aim, 0.0])
        joints = hand_eye_live.auto_poses(arm, aim_m, np.random.RandomState(0))
    else:
        joints = hand_eye_live.read_poses(Path(args.arm_poses), arm)
    seconds = hand_eye_live.check_poses(arm, joints)
    confirm(
        f"The arm on {bench.arm.port} goes home, slowly through {len(joints)} poses and home "
        f"again: about {seconds:.0f} s.",
        args.yes,
    )
    detect = chessboard(lens, args.board, 1e-3 * args.square_mm)
    # nothing moves before the camera has shown a picture
    with bench.open_camera() as camera:
        camera.read(bench.camera.timeout_s)
        with ReadyArm(arm, bench.arm.port, time.monotonic, time.sleep) as ready:
            pairs = hand_eye_live.collect(ready, camera, detect, joints, _tell)
    path: Path = args.out.with_name(f"{args.out.stem}-pairs.csv")
    files.write_whole({path: pairs_text(pairs).encode("utf-8")})
    return path


def chessboard(lens: Intrinsics, board: Tuple[int, int], square_m: float) -> hand_eye_live.Detector:
    """Return a detector of a chessboard with so many inner corners.

    Its origin is the corner at whose inner side a square is black, x along the first number.
    """
    columns, rows = board
    grid = np.zeros((rows * columns, 3), dtype=np.float32)
    grid[:, :2] = square_m * np.mgrid[0:columns, 0:rows].T.reshape(-1, 2)

    def detect(picture: Array) -> Optional[Array]:
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        is_found, corners = cv2.findChessboardCornersSB(grey, board, flags=cv2.CALIB_CB_ACCURACY)
        if not is_found:
            return None
        # the finder starts at either end; a board of odd times even has black inside one of them
        quads = corners.reshape(rows, columns, 2)
        first, last = (q.mean(axis=(0, 1)) for q in (quads[:2, :2], quads[-2:, -2:]))
        if _grey_at(grey, first) > _grey_at(grey, last):
            corners = corners[::-1].copy()
        is_solved, turn, place = cv2.solvePnP(grid, corners, camera_matrix(lens), lens.dist)
        return pose(cv2.Rodrigues(turn)[0], place.ravel()) if is_solved else None

    return detect


def _grey_at(grey: Array, place_px: Array) -> float:
    patch = cv2.getRectSubPix(grey, (5, 5), (float(place_px[0]), float(place_px[1])))
    return float(patch.mean())


def _tell(line: str) -> None:
    sys.stderr.write(line + "\n")


def _board(text: str) -> Tuple[int, int]:
    try:
        columns, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form 9x6") from None
    if min(columns, rows) < 3 or (columns + rows) % 2 == 0:
        # with both odd or both even a board looks the same upside down
        raise argparse.ArgumentTypeError(f"{text!r}: one side must be odd and one even, 3 or more")
    return columns, rows


def _place(text: str) -> Tuple[float, float]:
    try:
        x_m, y_m = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form x,y") from None
    return x_m, y_m


def _lines(result: HandEyeResult) -> List[str]:
    found = result.solution
    assert found is not None
    x, y, z = 1e3 * found.gripper_from_cam[:3, 3]
    sd = found.sd_mm
    lines = [
        f"{result.verdict.grade}: the fixed target scatters by {found.scatter_mm:.2f} mm and "
        f"{found.scatter_deg:.2f} deg over {len(found.row)} of {result.n_pairs} poses",
        f"camera on the gripper ({found.method}): {x:.1f} {y:.1f} {z:.1f} mm "
        f"+- {sd[0]:.1f} {sd[1]:.1f} {sd[2]:.1f} (sd)",
        *(f"  {reason}" for reason in result.verdict.reasons),
        *(f"  row {row} rejected: {why}" for row, why in result.rejected),
        *(f"  note: {note}" for note in result.notes),
        f"  {'method':<18} {'left out':>19}  {'in sample':>19}",
    ]
    for score in result.methods:
        lines.append(
            f"  {score.name:<18} {score.scatter_rms_mm:8.2f} mm {score.scatter_rms_deg:5.2f} deg"
            f"  {score.in_sample_mm:8.2f} mm {score.in_sample_deg:5.2f} deg"
        )
    return lines
