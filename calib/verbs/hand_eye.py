"""``apex calibrate hand-eye``: where the camera sits on the gripper."""

import argparse
import time
from pathlib import Path
from typing import List, Tuple

import numpy as np

from calib import files, hand_eye_live
from calib.hand_eye import HandEyeResult, solve
from calib.hand_eye_file import hand_eye_document
from calib.hand_eye_picture import draw
from calib.made import file_data, made
from calib.moving import confirm
from calib.pose_pairs import pairs_text, read_pairs
from calib.sources import to_stderr
from calib.verbs import options
from calib.verbs.outcome import Ending, check_usable, deliver, refusal_told
from firmware_bridge.ready import ReadyArm

HELP = "find where the camera sits on the gripper"
EXAMPLE = "apex calibrate hand-eye --pairs pairs.csv --out handeye.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the pose pairs, or the arm that gets them, and the file to write."""
    parser.add_argument(
        "--pairs",
        type=Path,
        metavar="FILE.csv",
        help="pose pairs: header, then base->gripper x,y,z,qx,qy,qz,qw and camera->target likewise",
    )
    options.add_camera(parser)
    options.add_lens(parser)
    options.add_out(parser)
    parser.add_argument(
        "--refine",
        action="store_true",
        help="let the non-linear refinement win as well; for arms more exact than the camera",
    )
    live = parser.add_argument_group("with a camera; the arm will move")
    options.add_board(live, is_required=False)
    live.add_argument(
        "--arm-poses", default="auto", metavar="auto|FILE", help="joints in degrees, a row a pose"
    )
    live.add_argument("--aim", type=_place, default=(0.2, 0.0), metavar="x,y", help="board, m")
    live.add_argument("--yes", action="store_true", help="let the arm move without asking")


def run(args: argparse.Namespace) -> int:
    """Solve pose pairs; write nothing but the pairs unless the result can be used.

    Raises
    ------
    CalibrationError : the file cannot be used, or the verdict is a refusal.
    ArmError, CameraError : live only; the arm was stopped.
    """
    with refusal_told(args.json) as figures:
        source = _collect(args) if options.is_live(args, "pairs") else args.pairs
        result = solve(read_pairs(source), args.refine)
        figures.update(result.figures())
        check_usable(result.verdict)
        assert result.solution is not None  # only a refusal has none
        about = made(file_data([source]), figures)
        document = hand_eye_document(result.solution.gripper_from_cam, about)
        return deliver(args, Ending(document, draw(result), figures, _lines(result)))


def _collect(args: argparse.Namespace) -> Path:
    """Drive the arm through its poses; returns the file of pairs, kept beside the result."""
    bench = options.bench_of(args)
    arm = bench.model()
    look = hand_eye_live.detector(options.lens_of(args), options.board_of(args))
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
    # nothing moves before the camera has shown a picture
    with bench.open_camera() as camera:
        camera.read(bench.camera.timeout_s)
        with ReadyArm(arm, bench.arm.port, time.monotonic, time.sleep) as ready:
            pairs = hand_eye_live.collect(ready, camera, look, joints, to_stderr)
    path: Path = args.out.with_name(f"{args.out.stem}-pairs.csv")
    files.write_whole({path: pairs_text(pairs).encode("utf-8")})
    return path


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
