"""``apex train fit``: fit one model, or train one of the paper's three as the paper does.

The shipped reproduction files were made by these commands, with NAME each of ``diffgraphormer``,
``diffgat`` and ``diffgcn``::

    apex train fit --paper --model NAME --seed 1 --out offline_train/data/paper-NAME.npz
    apex train fit --paper --repo-quirks --model NAME --seed 1 \\
        --out offline_train/data/paper-NAME-quirks.npz
"""

import argparse
import json
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Dict, Optional, Tuple

from apex_edge.errors import ApexError
from apex_edge.triggers import model_file
from apex_edge.triggers.graph_net import ARCHITECTURES
from apex_edge.verbs.progress import Progress
from offline_train.graph_models import files, paper

HELP = "fit a model on generated scenes, or train the paper's graph models as the paper does"
EXAMPLE = "apex train fit --paper --repo-quirks --model diffgraphormer --seed 1 --out paper.npz"
_QUIRKS = {f.name[len("is_") :].replace("_", "-"): f.name for f in fields(paper.Quirks)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--model", required=True, metavar="NAME", help="model to train")
    parser.add_argument("--seed", type=int, required=True, help="same seed, same bytes")
    parser.add_argument("--out", type=Path, required=True, help="model file to write (.npz, .json)")
    parser.add_argument("--paper", action="store_true", help="the paper's stars and training")
    parser.add_argument(
        "--repo-quirks", action="store_true", help="with --paper: all quirks of the released code"
    )
    parser.add_argument(
        "--quirk",
        action="append",
        default=[],
        choices=sorted(_QUIRKS),
        help="with --paper: this quirk alone, may be repeated",
    )
    parser.add_argument("--epochs", type=int, help="passes over the data (paper: 100)")
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")


def run(args: argparse.Namespace) -> int:
    """Train and write; return 0 on success.

    Raises
    ------
    MissingExtraError, ApexError : nothing is written.
    """
    _check(args)
    return _run_paper(args)


def _check(args: argparse.Namespace) -> None:
    if args.seed < 0:
        raise ApexError(f"--seed {args.seed}: must be 0 or more")
    if args.epochs is not None and args.epochs < 1:
        raise ApexError(f"--epochs {args.epochs}: must be 1 or more")
    if not args.out.resolve().parent.is_dir():
        raise ApexError(f"--out {args.out}: its folder does not exist")
    if args.out.suffix not in (".npz", ".json"):
        raise ApexError(f"--out {args.out}: a model file ends in .npz or .json")


def _run_paper(args: argparse.Namespace) -> int:
    if args.model not in ARCHITECTURES:
        raise ApexError(f"--model {args.model}: the paper has {', '.join(ARCHITECTURES)}")
    quirks = paper.REPO_QUIRKS if args.repo_quirks else paper.NO_QUIRKS
    quirks = replace(quirks, **{_QUIRKS[name]: True for name in args.quirk})
    n_epochs = args.epochs or paper.N_EPOCHS
    with Progress("epochs", n_epochs) as progress:
        outcome = paper.train_paper(args.model, quirks, args.seed, n_epochs, progress.advance)
    notes = {
        "provenance": {
            "generator": "paper-star",
            "seed": args.seed,
            "n_graphs": paper.N_GRAPHS,
            "n_epochs": n_epochs,
            "quirks": asdict(quirks),
            "label": "planted target" if quirks.is_designed_label else "risk above 0.75",
            "libraries": files.libraries(),
        },
        "metrics": outcome.metrics,
    }
    model_file.write(files.fields_of(outcome.fit, notes), args.out)
    if args.json:
        print(json.dumps(outcome.metrics, sort_keys=True))
    else:
        print(_report(outcome.metrics, args.out))
    return 0


def _report(metrics: Dict[str, Dict[str, Optional[float]]], out: Path) -> str:
    lines = [_row("evaluation", ("accuracy", "recall", "precision"))]
    for name, row in metrics.items():
        cells = tuple(_cell(row[key]) for key in ("accuracy", "recall", "precision"))
        lines.append(_row(name, cells))
    lines.append(f"wrote {out}")
    return "\n".join(lines)


def _row(name: str, cells: Tuple[str, ...]) -> str:
    return f"{name:12s}" + "".join(f"{cell:>12s}" for cell in cells)


def _cell(value: Optional[float]) -> str:
    return "-" if value is None else f"{value:.3f}"
