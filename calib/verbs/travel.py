"""``apex calibrate travel``: how fast each servo gets to its target, from recorded steps."""

import argparse
from pathlib import Path
from typing import List, Sequence

from calib.made import file_data, made
from calib.travel import TravelFit, overall, read_samples, solve
from calib.travel_file import toml_lines, travel_document
from calib.travel_picture import draw
from calib.verbs.options import add_out
from calib.verbs.outcome import Ending, check_usable, deliver, refusal_told
from firmware_bridge.kinematics import ArmModel

HELP = "fit rate, acceleration or lag and dead time of servos"
EXAMPLE = "apex calibrate travel --samples steps.csv --arm so-101 --out travel.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the recorded steps and the file to write."""
    parser.add_argument(
        "--samples",
        type=Path,
        required=True,
        metavar="FILE.csv",
        help="header, then servo_id,step,t_s,angle_deg a row; t_s since the command was sent",
    )
    parser.add_argument("--arm", default="armpi-mini", help="arm data, for the joints' names")
    add_out(parser)


def run(args: argparse.Namespace) -> int:
    """Fit the steps; write nothing unless every servo can be used.

    Raises
    ------
    CalibrationError : the samples cannot be used, or the verdict is a refusal.
    """
    with refusal_told(args.json) as figures:
        arm = ArmModel.load(args.arm)
        samples = read_samples(args.samples)
        fits = solve(samples)
        verdict = overall(fits)
        figures.update(verdict.plain(), servos=[each.plain() for each in fits])
        check_usable(verdict)
        document = travel_document(fits, arm, made(file_data([args.samples]), figures))
        figures["toml"] = document["toml"]
        return deliver(args, Ending(document, draw(samples, fits), figures, _lines(fits, arm)))


def _lines(fits: Sequence[TravelFit], arm: ArmModel) -> List[str]:
    lines: List[str] = []
    for each in fits:
        lines.append(
            f"servo {each.servo_id}: {each.verdict}; {each.rate_rad_s:.3f} +- "
            f"{each.sd_rate_rad_s:.3f} rad/s, dead time {1000.0 * each.dead_s:.0f} +- "
            f"{1000.0 * each.sd_dead_s:.0f} ms, kind {each.kind}"
        )
        lines.append(
            f"  residual {each.residual_deg:.2f} deg; arrivals off by "
            f"{1000.0 * each.arrival_s:.0f} ms RMS, at most {1000.0 * each.late_s:.0f} ms late"
        )
        lines += [f"  {reason}" for reason in each.reasons]
    return [*lines, "lines for the arm's data file:", *toml_lines(fits, arm)]
