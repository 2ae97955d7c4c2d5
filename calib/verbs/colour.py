"""``apex calibrate colour``: teach object colours from labelled discs of a picture."""

import argparse
import json
from pathlib import Path
from typing import Any, Dict, List

import cv2
import numpy as np

from apex_edge import documents
from apex_edge.errors import ColourError
from apex_edge.perception import colour_file
from apex_edge.types import Array
from calib import colour, files
from calib.lab_import import read_ranges
from calib.made import files_digest, made
from calib.verdict import REFUSE

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
    teach.add_argument("--out", required=True, metavar="FILE", help="colour file to write")
    teach.add_argument("--json", action="store_true", help="print the result as JSON")


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
    out = Path(args.out)
    picture = files.read_picture(Path(args.image), args.frame)
    background = files.read_picture(Path(args.background)) if args.background else None
    ranges = read_ranges(Path(args.lab)) if args.lab else None
    result = colour.solve(picture, args.sample, background, ranges)
    shown = out.with_suffix(".png")
    if shown in (out, Path(args.image), Path(args.background or args.image)):
        shown = out.with_name(out.stem + "-found.png")
    figures = {**result.verdict.plain(), "colours": result.figures()}
    if result.verdict.is_refused:
        if args.json:
            print(json.dumps(figures))
        raise ColourError(_refusal(result))
    document = colour_file.compose(result.colours(), _made(args, result))
    overlay = files.encode_png(_overlay(picture, result, args.sample))
    files.write_whole({shown: overlay, out: documents.to_text(document).encode("utf-8")})
    if args.json:
        print(json.dumps({**figures, "out": str(out), "picture": str(shown)}))
    else:
        print("\n".join([*_lines(result), f"wrote {out} and {shown}"]))
    return 0


def _refusal(result: colour.ColourResult) -> str:
    bad = [q for q in result.quality if q.verdict == REFUSE]
    each = "; ".join(f"colour {q.name!r}: {', '.join(q.reasons)}" for q in bad)
    return f"not separable, nothing written: {each}"


def _lines(result: colour.ColourResult) -> List[str]:
    lines = []
    for quality in result.quality:
        lines.append(
            f"{quality.name}: {quality.verdict}; finds {quality.recall:.1%} of its own pixels, "
            f"takes {quality.false_share:.3%} of the background"
        )
        lines += [f"  {reason}" for reason in quality.reasons]
    return lines


def _made(args: argparse.Namespace, result: colour.ColourResult) -> Dict[str, Any]:
    """Return what a reader needs to judge the file later."""
    sources = [Path(name) for name in (args.image, args.background, args.lab) if name]
    return made(
        files_digest(sources),
        result.verdict,
        image=Path(args.image).name,
        frame=args.frame,
        background=Path(args.background).name if args.background else None,
        lab_ranges=Path(args.lab).name if args.lab else None,
        samples=[[s.name, s.x_px, s.y_px, s.radius_px] for s in args.sample],
        quality=result.figures(),
    )


def _overlay(picture: Array, result: colour.ColourResult, samples: List[colour.Sample]) -> Array:
    """Return the picture with what would be detected in full colour and the rest in grey."""
    grey = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    shown: Array = (0.5 * grey).astype(np.uint8)
    shown[result.labels > 0] = picture[result.labels > 0]
    for sample in samples:
        centre = (int(round(sample.x_px)), int(round(sample.y_px)))
        cv2.circle(shown, centre, max(1, int(round(sample.radius_px))), (255, 255, 255), 1)
        below = (centre[0], centre[1] + int(sample.radius_px) + 14)
        cv2.putText(shown, sample.name, below, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1)
    return shown
