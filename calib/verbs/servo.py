"""``apex calibrate servo``: position <-> angle of a servo from protractor readings."""

import argparse
import sys
import time
from pathlib import Path
from typing import List, Optional, Sequence

from calib import files, servo_live
from calib.made import file_data, made
from calib.moving import confirm
from calib.servo import ServoFit, overall, read_samples, samples_text, solve
from calib.servo_file import calibration_lines, servo_document
from calib.servo_picture import draw
from calib.settings import Bench
from calib.verbs.options import add_out
from calib.verbs.outcome import Ending, check_usable, deliver, refusal_told
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.ready import ReadyArm

HELP = "fit servo positions to joint angles, in both directions"
EXAMPLE = "apex calibrate servo --samples yaw.csv --out servo.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the readings and the file to write."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--samples",
        type=Path,
        metavar="FILE.csv",
        help="header, then servo_id,ticks,angle_deg,direction (up or down) a row",
    )
    source.add_argument(
        "--config", type=Path, metavar="FILE", help="settings of a live arm: it will move"
    )
    parser.add_argument("--arm", default="armpi-mini", help="arm data, for the joints' names")
    add_out(parser)
    live = parser.add_argument_group("with --config")
    live.add_argument("--joint", default="yaw", help="the joint to turn (yaw)")
    live.add_argument("--yes", action="store_true", help="let the arm move without asking")


def run(args: argparse.Namespace) -> int:
    """Fit the readings; write nothing unless every servo can be used.

    Raises
    ------
    CalibrationError : the readings cannot be used, or the verdict is a refusal.
    ArmError : live only; the arm was stopped.
    """
    with refusal_told(args.json) as figures:
        bench = Bench.read(args.config)
        arm = ArmModel.load(args.arm) if args.config is None else bench.model()
        source = args.samples if args.config is None else _collect(args, bench, arm)
        samples = read_samples(source, arm.tick_range)
        fits = solve(samples, arm.tick_range)
        verdict = overall(fits)
        figures.update(verdict.plain(), servos=[fit.plain() for fit in fits])
        check_usable(verdict)
        document = servo_document(fits, arm, made(file_data([source]), figures))
        tie = "\n".join(calibration_lines(document, args.out)) + "\n"
        figures["toml"] = document["toml"] + tie
        told = [*_lines(fits), "lines for the arm's data file:", figures["toml"].rstrip()]
        return deliver(args, Ending(document, draw(samples, fits), figures, told))


def _collect(args: argparse.Namespace, bench: Bench, arm: ArmModel) -> Path:
    """Turn one joint and ask for its angle; returns the readings' file, beside the result."""
    poses = servo_live.poses_for(arm, args.joint)
    confirm(
        f"The arm on {bench.arm.port} goes home, then {args.joint} turns slowly through "
        f"{len(poses)} angles up and down; put a protractor on it. An empty answer skips one.",
        args.yes,
    )
    with ReadyArm(arm, bench.arm.port, time.monotonic, time.sleep) as ready:
        samples = servo_live.collect(ready, args.joint, poses, _ask)
    path: Path = args.out.with_name(f"{args.out.stem}-samples.csv")
    files.write_whole({path: samples_text(samples).encode("utf-8")})
    return path


def _ask(prompt: str) -> Optional[float]:
    """Ask until the answer is a number; None when it is empty."""
    while True:
        sys.stderr.write(prompt)
        sys.stderr.flush()
        answer = sys.stdin.readline().strip()
        if not answer:
            return None
        try:
            angle = float(answer)
        except ValueError:
            sys.stderr.write(f"{answer!r} is no number of degrees\n")
            continue
        if abs(angle) <= 360.0:
            return angle
        sys.stderr.write(f"{answer} is outside -360..360 degrees\n")


def _lines(fits: Sequence[ServoFit]) -> List[str]:
    lines: List[str] = []
    for fit in fits:
        lines.append(
            f"servo {fit.servo_id}: {fit.verdict}; "
            f"zero {fit.zero_ticks:.1f} +- {fit.sd_zero_ticks:.1f} ticks, "
            f"{fit.ticks_per_rad:.1f} +- {fit.sd_ticks_per_rad:.1f} ticks per rad"
        )
        lines.append(
            f"  residual up {fit.residual_up_deg:.2f}, down {fit.residual_down_deg:.2f}, left out "
            f"{fit.left_out_deg:.2f} deg; backlash {fit.backlash_deg:.2f} +- "
            f"{fit.sd_backlash_deg:.2f} deg"
        )
        lines += [f"  {reason}" for reason in fit.reasons]
        lines += [f"  row {row} rejected: {why}" for row, why in fit.rejected]
    return lines
