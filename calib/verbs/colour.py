"""``apex calibrate colour``: teach object colours from labelled discs of a picture."""

import argparse
from pathlib import Path
from typing import List

import cv2
import numpy as np

from apex_edge.errors import ColourError
from apex_edge.perception import colour_file
from apex_edge.types import Array
from calib import colour, files, plot
from calib.lab_import import read_ranges
from calib.made import file_data, made
from calib.verbs import options
from calib.verbs.outcome import Ending, check_usable, deliver, refusal_told

HELP = "teach object colours from a labelled picture"
EXAMPLE = "apex calibrate colour --image table.png --sample red:320,240,12 --out colours.json"


def add_arguments(teach: argparse.ArgumentParser) -> None:
    """Declare the picture, the samples and the file to write."""
    teach.add_argument("--image", required=True, metavar="FILE", help="picture or video")
    teach.add_argument(
        "--frame", type=_frame_number, default=0, metavar="N", help="frame of a video, 0-based"
    )
    teach.add_argument(
        "--sample",
        required=True,
        action="append",
        type=parse_sample,
        metavar="NAME:x,y,r",
        help="a disc of one colour, px; repeat for more colours or more discs of one colour",
    )
    teach.add_argument(
        "--background", metavar="FILE", help="picture of the same table without the objects"
    )
    teach.add_argument(
        "--lab",
        metavar="FILE",
        help="take the sampled colours from HiWonder's lab_config.yaml, and only measure them",
    )
    options.add_out(teach, "colour file to write")


def parse_sample(text: str) -> colour.Sample:
    """Read ``NAME:x,y,r``.

    Raises
    ------
    argparse.ArgumentTypeError : not of that form.
    """
    name, colon, numbers = text.rpartition(":")
    parts = numbers.split(",")
    try:
        x_px, y_px, radius_px = (float(part) for part in parts)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME:x,y,r") from None
    if not colon or not name.strip() or not np.all(np.isfinite([x_px, y_px, radius_px])):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME:x,y,r")
    return colour.Sample(name.strip(), x_px, y_px, radius_px)


def _frame_number(text: str) -> int:
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not a frame number 0, 1, 2, ...")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """Teach the colours; write nothing unless every one of them can be used.

    Raises
    ------
    ColourError : a sample that cannot be used, or a colour that cannot be told apart.
    RecordingError : the picture cannot be read.
    """
    with refusal_told(args.json) as figures:
        inputs = [Path(name) for name in (args.image, args.background, args.lab) if name]
        picture = files.read_picture(Path(args.image), args.frame)
        background = files.read_picture(Path(args.background)) if args.background else None
        ranges = read_ranges(Path(args.lab)) if args.lab else None
        result = colour.solve(picture, args.sample, background, ranges)
        figures.update(frame=args.frame, samples=[list(vars(s).values()) for s in args.sample])
        figures.update(result.figures())
        check_usable(result.verdict, ColourError)
        document = colour_file.compose(result.colours(), made(file_data(inputs), figures))
        shown = _picture(picture, result, args.sample)
        return deliver(args, Ending(document, shown, figures, _lines(result)), inputs)


def _lines(result: colour.ColourResult) -> List[str]:
    return [*_shares(result), *(f"  {reason}" for reason in result.verdict.reasons)]


def _shares(result: colour.ColourResult) -> List[str]:
    return [
        f"{each.name}: {each.verdict}; finds {each.recall:.1%} of its own pixels, takes "
        f"{each.false_share:.3%} of the background"
        for each in result.quality
    ]


def _picture(picture: Array, result: colour.ColourResult, samples: List[colour.Sample]) -> Array:
    """Return the picture with what would be detected in full colour and the rest in grey."""
    grey = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    shown: Array = (0.5 * grey).astype(np.uint8)
    shown[result.labels > 0] = picture[result.labels > 0]
    frame, scale = plot.enlarged(shown)
    for sample in samples:
        centre = scale * (np.array([sample.x_px, sample.y_px]) + 0.5)
        plot.disc(frame, centre, scale * sample.radius_px, (255, 255, 255), 2)
        below = (round(centre[0]), round(centre[1] + scale * sample.radius_px) + 20)
        plot.label(frame, sample.name, below, 0.6)
    headline = "in full colour: what would be detected; circles: the samples"
    return plot.with_panel(frame, result.verdict, headline, _shares(result))
