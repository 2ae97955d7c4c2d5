"""``apex calibrate hand-eye``: where the camera sits on the gripper."""

import argparse
from pathlib import Path
from typing import List

from calib.hand_eye import HandEyeResult, solve
from calib.hand_eye_file import hand_eye_document
from calib.hand_eye_picture import draw
from calib.made import files_digest, made
from calib.pose_pairs import read_pairs
from calib.verbs.outcome import Told, check_usable, deliver, faults_told

HELP = "find where the camera sits on the gripper"
EXAMPLE = "apex calibrate hand-eye --pairs pairs.csv --out handeye.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the pose pairs and the file to write."""
    parser.add_argument(
        "--pairs",
        type=Path,
        required=True,
        metavar="FILE.csv",
        help="pose pairs: header, then base->gripper x,y,z,qx,qy,qz,qw and camera->target likewise",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="file to write")
    parser.add_argument(
        "--refine",
        action="store_true",
        help="let the non-linear refinement win as well; for arms more exact than the camera",
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def run(args: argparse.Namespace) -> int:
    """Solve pose pairs; write nothing unless the result can be used.

    Raises
    ------
    CalibrationError : the file cannot be used, or the verdict is a refusal.
    """
    with faults_told(args.json):
        pairs = read_pairs(args.pairs)
    result = solve(pairs, args.refine)
    figures = result.figures()
    check_usable(result.verdict, figures, str(args.pairs), args.json)
    found = result.solution
    assert found is not None  # only a refusal has none
    per_pose = [
        {"row": int(row), "error_mm": float(mm), "error_deg": float(deg)}
        for row, mm, deg in zip(found.row, found.error_mm, found.error_deg)
    ]
    source = made(
        files_digest([args.pairs]),
        result.verdict,
        pairs=args.pairs.name,
        per_pose=per_pose,
        **{key: value for key, value in figures.items() if key not in ("verdict", "reasons")},
    )
    document = hand_eye_document(found.gripper_from_cam, source)
    deliver(args.out, document, draw(result), Told(figures, _lines(result), args.json))
    return 0


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
