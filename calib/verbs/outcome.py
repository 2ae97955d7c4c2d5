"""How every calibration ends: files written whole and figures told, or a refusal."""

import argparse
import json
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Dict, Iterator, Mapping, NamedTuple, Sequence, Type

from apex_edge import documents
from apex_edge.errors import ApexError, CalibrationError, InputError
from apex_edge.types import Array
from calib import files
from calib.verdict import REFUSE, Verdict

Figures = Dict[str, Any]


@contextmanager
def refusal_told(is_json: bool) -> Iterator[Figures]:
    """Tell an error as JSON as well, where JSON was asked for; the error goes on.

    Yields the figures that the verb fills in as they become known; what is known is told.
    """
    figures: Figures = {}
    try:
        yield figures
    except ApexError as error:
        if is_json:
            is_judged = figures.get("verdict") == REFUSE
            reasons = figures["reasons"] if is_judged else [str(error)]
            print(json.dumps({**figures, "verdict": REFUSE, "reasons": reasons}))
        raise


def check_usable(verdict: Verdict, fault: Type[InputError] = CalibrationError) -> None:
    """Let a verdict pass that allows a file to be written.

    Raises
    ------
    fault : it is a refusal.
    """
    if verdict.is_refused:
        raise fault(f"nothing written: {'; '.join(verdict.reasons)}")


def picture_path(out: Path, inputs: Sequence[Path]) -> Path:
    """Return where the picture goes: beside ``out``, and over no input."""
    shown = out.with_suffix(".png")
    taken = {path.resolve() for path in (out, *inputs)}
    return out.with_name(out.stem + "-result.png") if shown.resolve() in taken else shown


class Ending(NamedTuple):
    """A signed document, the picture (h, w, 3) that shows it, and what is told of it."""

    document: Mapping[str, Any]
    picture: Array
    figures: Figures
    lines: Sequence[str]


def deliver(args: argparse.Namespace, ending: Ending, inputs: Sequence[Path] = ()) -> int:
    """Write a result to ``args.out`` and its picture beside it, tell about them; returns 0.

    Raises
    ------
    InputError : a file cannot be written; then neither is.
    """
    shown = picture_path(args.out, inputs)
    text = documents.to_text(ending.document).encode("utf-8")
    files.write_whole({shown: files.encode_png(ending.picture), args.out: text})
    if args.json:
        print(json.dumps({**ending.figures, "out": str(args.out), "picture": str(shown)}))
    else:
        print("\n".join([*ending.lines, f"wrote {args.out} and {shown}"]))
    return 0
