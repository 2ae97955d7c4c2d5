"""``apex train trigger``: all steps of a shipped trigger in one command.

The shipped models were made by exactly these commands::

    apex train trigger --seed 1 --out apex_edge/data/trigger-linear.json --card docs/models
    apex train trigger --model diffgraphormer --seed 1 --out apex_edge/data/trigger-graph.npz \\
        --card docs/models
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Dict, Tuple

from apex_edge import plugins
from apex_edge.errors import ApexError
from offline_train.reports import card
from offline_train.reports.tables import number
from offline_train.trigger.calibrate import Promise
from offline_train.trigger.export import write
from offline_train.trigger.learn import LINEAR, WIDE
from offline_train.trigger.pipeline import Sizes, train

HELP = "a hazard trigger in one go: generate, fit, certify, test and write it"
EXAMPLE = "apex train trigger --seed 1 --out trigger-linear.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--out", type=Path, required=True, help="weights file to write")
    known = ", ".join([LINEAR, WIDE, *plugins.names("graph_models")])
    parser.add_argument("--model", default=LINEAR, metavar="NAME", help=f"{known} ({LINEAR})")
    parser.add_argument("--seed", type=int, required=True, help="same seed, same bytes")
    parser.add_argument("--alpha", type=float, default=Promise.alpha, help="miss rate to certify")
    parser.add_argument(
        "--scale", type=float, default=1.0, help="scenes, as a multiple of the usual number"
    )
    parser.add_argument("--card", type=Path, help="folder for the model card and its plots")
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")


def run(args: argparse.Namespace) -> int:
    """Train and write; return 0 on success.

    Raises
    ------
    MissingExtraError, TooFewEventsError, ApexError : nothing is written.
    """
    _check(args)
    usual = Sizes()
    sizes = Sizes(
        *(max(1, int(args.scale * n)) for n in (usual.train, usual.calibration, usual.test))
    )
    fields, tested = train(args.model, args.seed, sizes, Promise(alpha=args.alpha), _progress)
    files = card.card(fields, args.out.stem, [tested]) if args.card is not None else {}
    write(fields, args.out)
    if args.card is not None:
        card.write(files, args.card)
    print(json.dumps(fields["metrics"], sort_keys=True) if args.json else _report(fields, args.out))
    return 0


def _check(args: argparse.Namespace) -> None:
    if args.seed < 0:
        raise ApexError(f"--seed {args.seed}: must be 0 or more")
    if not 0.0 < args.alpha < 1.0:
        raise ApexError(f"--alpha {args.alpha}: must lie between 0 and 1")
    if not 0.0 < args.scale <= 100.0:
        raise ApexError(f"--scale {args.scale}: must lie in (0, 100]")
    if not args.out.resolve().parent.is_dir():
        raise ApexError(f"--out {args.out}: its folder does not exist")


def _progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _report(fields: Dict[str, Any], out: Path) -> str:
    promise = fields["threshold"]
    lines = [_row("rule", ("recall", "neg. frames", "harmless", "PR", "ROC"))]
    (tested,) = fields["metrics"].values()
    for name, row in tested["rules"].items():
        keys = ("recall", "negative_frames", "harmless_tracks", "pr_auc", "roc_auc")
        lines.append(_row(name, tuple(number(row[key]) for key in keys)))
    n_late = promise["n_contacts"] - promise["n_pos"]
    lines.append(
        f"certified: recall >= {1 - promise['alpha']:.3f} at {promise['confidence']:.0%} "
        f"confidence, {promise['lead_s']:.1f} s before contact, on {promise['n_pos']} events; "
        f"{n_late} contacts showed too little or too late to count"
    )
    lines.append(f"wrote {out}")
    return "\n".join(lines)


def _row(name: str, cells: Tuple[str, ...]) -> str:
    return f"{name:11s}" + "".join(f"{cell:>14s}" for cell in cells)
