"""Options and report that the certifying verbs share."""

import argparse
import json
from pathlib import Path
from typing import Any, Mapping

from apex_edge.errors import ApexError
from offline_train.trigger.calibrate import Promise


def add_promise(parser: argparse.ArgumentParser) -> None:
    """Declare what is to be promised and where the certified model goes."""
    usual = Promise()
    parser.add_argument("--out", type=Path, required=True, help="model file, .json or .npz")
    parser.add_argument(
        "--alpha", type=float, default=usual.alpha, help=f"share of misses ({usual.alpha:g})"
    )
    parser.add_argument(
        "--confidence",
        type=float,
        default=usual.confidence,
        help=f"that it is no more ({usual.confidence:g})",
    )
    parser.add_argument(
        "--lead", type=float, default=usual.lead_s, help=f"s before contact ({usual.lead_s:g})"
    )
    parser.add_argument("--json", action="store_true", help="print the certificate as JSON")


def promise_of(args: argparse.Namespace) -> Promise:
    """Return the promise that the options ask for.

    Raises
    ------
    ApexError : one of them is out of range.
    """
    for name in ("alpha", "confidence"):
        value = getattr(args, name)
        if not 0.0 < value < 1.0:
            raise ApexError(f"--{name} {value}: must lie between 0 and 1")
    if not 0.0 <= args.lead <= 5.0:
        raise ApexError(f"--lead {args.lead}: must lie in [0, 5] s")
    return Promise(alpha=args.alpha, confidence=args.confidence, lead_s=args.lead)


def check_out(out: Path) -> None:
    """Refuse a place where nothing can be written, before the work.

    Raises
    ------
    ApexError : its folder does not exist.
    """
    if not out.resolve().parent.is_dir():
        raise ApexError(f"--out {out}: its folder does not exist")


def report(fields: Mapping[str, Any], args: argparse.Namespace) -> str:
    """Return what was certified, as text or as JSON."""
    found = fields["threshold"]
    if args.json:
        return json.dumps({**found, "sha256": fields["sha256"]}, sort_keys=True)
    n_late = found["n_contacts"] - found["n_pos"]
    return (
        f"certified: recall >= {1 - found['alpha']:.3f} at {found['confidence']:.0%} confidence, "
        f"{found['lead_s']:.1f} s before contact, on {found['n_pos']} events; {n_late} contacts "
        f"showed too little or too late to count\nthreshold: logit {found['logit']:.4f}\n"
        f"wrote {args.out}"
    )
