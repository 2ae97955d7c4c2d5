"""Signed JSON files: every calibration is one, and none is used that was changed or cut short.

::

    {"format": "...", "version": 1, "sha256": "...",
     ...the numbers that are used...,
     "made": {...}}        what it was made from and how well it went; not needed to use it

The hash covers the whole document but itself, in canonical form (sorted keys, no spaces).
Source: ours.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, Mapping, Type

from apex_edge.errors import InputError


def digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of a document's canonical form without its ``sha256``."""
    content = {key: value for key, value in document.items() if key != "sha256"}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def compose(
    kind: str, version: int, content: Mapping[str, Any], made: Mapping[str, Any]
) -> Dict[str, Any]:
    """Return a complete, signed document.

    Parameters
    ----------
    kind : its ``format``, e.g. ``apex-camera``.
    version : of that format.
    content : what users of the file need, plain values only.
    made : what a reader needs to judge it: date, data, versions, figures, verdict.
    """
    document = {"format": kind, "version": version, **content, "made": dict(made)}
    document = json.loads(json.dumps(document))  # tuples become lists, as they will be read
    document["sha256"] = digest(document)
    return document


def to_text(document: Mapping[str, Any]) -> str:
    """Return the document as it is written to a file."""
    return json.dumps(document, indent=2, sort_keys=True) + "\n"


def read(path: Path, kind: str, version: int, error: Type[InputError]) -> Dict[str, Any]:
    """Return a document whose format, version and hash are right.

    Parameters
    ----------
    path : the file.
    kind, version : what it must be.
    error : raised for every fault, with a message that names the file.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as fault:
        raise error(f"{path}: cannot read: {fault}") from fault
    except (ValueError, RecursionError) as fault:
        raise error(f"{path}: not JSON: {fault}") from fault
    if not isinstance(document, dict) or document.get("format") != kind:
        raise error(f"{path}: not a file of format {kind!r}")
    if document.get("version") != version:
        raise error(
            f"{path}: version {document.get('version')!r} is not supported, expected {version}"
        )
    found = digest(document)
    if document.get("sha256") != found:
        raise error(
            f"{path}: the content does not match its hash (stated {document.get('sha256')!r}, "
            f"found {found!r}); calibrate again instead of editing the file"
        )
    return document
