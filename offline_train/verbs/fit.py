"""``apex train fit``: fit one model to watched scenes, or train the paper's as the paper does.

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
from typing import Any, Dict, Optional, Tuple

from apex_edge import plugins
from apex_edge.errors import ApexError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.graph_net import ARCHITECTURES
from apex_edge.verbs.progress import Progress
from offline_train.graph_models import files, paper
from offline_train.trigger import data, learn
from offline_train.trigger.export import Trained, write
from offline_train.trigger.learn import LABELS, LINEAR, WIDE
from offline_train.trigger.metrics import frame_figures
from offline_train.trigger.observe import Observed

HELP = "fit a model on generated scenes, or train the paper's graph models as the paper does"
EXAMPLE = "apex train fit --paper --repo-quirks --model diffgraphormer --seed 1 --out paper.npz"
_QUIRKS = {f.name[len("is_") :].replace("_", "-"): f.name for f in fields(paper.Quirks)}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    known = ", ".join([LINEAR, WIDE, *plugins.names("graph_models")])
    parser.add_argument("--model", required=True, metavar="NAME", help=known)
    parser.add_argument("--seed", type=int, required=True, help="same seed, same bytes")
    parser.add_argument("--out", type=Path, required=True, help="model file to write (.npz, .json)")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--data", type=Path, metavar="DIR", help="see apex train generate")
    source.add_argument("--paper", action="store_true", help="the paper's stars and training")
    parser.add_argument(
        "--label", choices=LABELS, default="truth", help="with --data: what to learn (truth)"
    )
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
    parser.add_argument("--epochs", type=int, help="passes over the data (15; paper: 100)")
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")


def run(args: argparse.Namespace) -> int:
    """Train and write; return 0 on success.

    Raises
    ------
    MissingExtraError, ApexError : nothing is written.
    """
    check(args)
    return _run_paper(args) if args.paper else _run_data(args)


def check(args: argparse.Namespace) -> None:
    """Refuse options that make no sense, before any work.

    Raises
    ------
    ApexError : says which and why.
    """
    if args.seed < 0:
        raise ApexError(f"--seed {args.seed}: must be 0 or more")
    if args.epochs is not None and args.epochs < 1:
        raise ApexError(f"--epochs {args.epochs}: must be 1 or more")
    if not args.out.resolve().parent.is_dir():
        raise ApexError(f"--out {args.out}: its folder does not exist")
    if args.out.suffix not in (".npz", ".json"):
        raise ApexError(f"--out {args.out}: a model file ends in .npz or .json")


def _run_data(args: argparse.Namespace) -> int:
    if args.repo_quirks or args.quirk:
        raise ApexError("--repo-quirks and --quirk go with --paper")
    seen, description = data.read(args.data, "train")
    target = learn.targets(seen, args.label)
    n_epochs = args.epochs or learn.N_EPOCHS
    with Progress("epochs", n_epochs) as progress:
        trained = learn.fit(seen, target, args.model, args.seed, n_epochs, progress.advance)
    made = {"label": args.label, "model": args.model, "seed": args.seed}
    return finish(args, trained, (seen, description), made)


def finish(
    args: argparse.Namespace,
    trained: Trained,
    source: Tuple[Observed, data.Description],
    made: Dict[str, Any],
) -> int:
    """Write the model file, not yet certified, and print how it does on its own scenes."""
    seen, description = source
    made = dict(made, libraries=learn.libraries(trained))
    fields_now = learn.document(trained, seen, description, made)
    write(fields_now, args.out)
    said = learn.said_by(weights.check(fields_now, str(args.out)), seen)
    found = frame_figures(seen.label.astype(bool), said)
    if args.json:
        print(json.dumps(found, sort_keys=True))
        return 0
    print(f"on its own {len(said)} frames, contact within the horizon as the truth:")
    print("\n".join(f"  {name:22s}{_cell(value)}" for name, value in found.items()))
    print(f"wrote {args.out}; not certified: apex train calibrate makes it usable")
    return 0


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
