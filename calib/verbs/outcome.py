"""What the verbs have in common at their end: figures told, files written whole, or a refusal."""

import json
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Dict, Iterator, Mapping, Sequence

from apex_edge import documents
from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from calib import files
from calib.verdict import REFUSE, Verdict


@contextmanager
def faults_told(is_json: bool) -> Iterator[None]:
    """Tell an unusable input as JSON as well, where JSON was asked for; the error goes on."""
    try:
        yield
    except CalibrationError as error:
        if is_json:
            print(json.dumps({"verdict": REFUSE, "reasons": [str(error)]}))
        raise


def check_usable(verdict: Verdict, figures: Mapping[str, Any], where: str, is_json: bool) -> None:
    """Let a verdict pass that allows a file to be written.

    Raises
    ------
    CalibrationError : it is a refusal; its figures were printed as JSON where that was asked for.
    """
    if not verdict.is_refused:
        return
    if is_json:
        print(json.dumps(figures))
    raise CalibrationError(f"{where}: refused, nothing written: {'; '.join(verdict.reasons)}")


def picture_path(out: Path, *inputs: Path) -> Path:
    """Return where the picture goes: beside ``out``, and over no input."""
    shown = out.with_suffix(".png")
    return out.with_name(out.stem + "-result.png") if shown in (out, *inputs) else shown


def deliver(
    out: Path, document: Mapping[str, Any], picture: Array, told: "Told", *inputs: Path
) -> None:
    """Write a result and its picture, and tell about them.

    Raises
    ------
    InputError : a file cannot be written; then neither is.
    """
    shown = picture_path(out, *inputs)
    text = documents.to_text(document).encode("utf-8")
    files.write_whole({shown: files.encode_png(picture), out: text})
    told.tell(out, shown)


class Told:
    """What is printed at the end: one JSON object, or lines for a reader."""

    def __init__(self, figures: Dict[str, Any], lines: Sequence[str], is_json: bool) -> None:
        self._figures, self._lines, self._is_json = figures, lines, is_json

    def tell(self, out: Path, picture: Path) -> None:
        """Print it, with the names of the files that were written."""
        if self._is_json:
            print(json.dumps({**self._figures, "out": str(out), "picture": str(picture)}))
        else:
            print("\n".join([*self._lines, f"wrote {out} and {picture}"]))
