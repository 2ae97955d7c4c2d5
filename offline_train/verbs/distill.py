"""``apex train distill``: a student learns what a teacher's model file says, with its doubt.

The teacher may be a graph model and the student linear, or the other way round: a linear model
labels scenes for a graph model.
"""

import argparse
from pathlib import Path

from apex_edge import plugins
from apex_edge.errors import ApexError
from apex_edge.triggers import model_file, weights
from apex_edge.verbs.progress import Progress
from offline_train.trigger import data, learn
from offline_train.trigger.distill import soft_target
from offline_train.verbs.fit import check, finish

HELP = "fit a student to what a trained model says, mixed with the truth if wanted"
EXAMPLE = "apex train distill --teacher graph.npz --mix-truth 0.5 --data d --seed 1 --out s.json"
_TRUTHS = ("truth", "soft")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    known = ", ".join([learn.LINEAR, learn.WIDE, *plugins.names("graph_models")])
    parser.add_argument("--teacher", type=Path, required=True, metavar="FILE", help="model file")
    parser.add_argument("--student", default=learn.LINEAR, metavar="NAME", help=known)
    parser.add_argument("--data", type=Path, required=True, help="see apex train generate")
    parser.add_argument(
        "--mix-truth", type=float, default=0.0, metavar="SHARE", help="share of the truth (0)"
    )
    parser.add_argument("--label", choices=_TRUTHS, default="truth", help="which truth (truth)")
    parser.add_argument("--seed", type=int, required=True, help="same seed, same bytes")
    parser.add_argument("--epochs", type=int, help="passes over the data of a graph model (15)")
    parser.add_argument("--out", type=Path, required=True, help="model file to write (.npz, .json)")
    parser.add_argument("--json", action="store_true", help="print the metrics as JSON")


def run(args: argparse.Namespace) -> int:
    """Distil and write; return 0 on success.

    Raises
    ------
    WeightsError : the teacher's file is damaged; it needs no certificate.
    MissingExtraError, ApexError : nothing is written.
    """
    check(args)
    if not 0.0 <= args.mix_truth <= 1.0:
        raise ApexError(f"--mix-truth {args.mix_truth}: must lie between 0 and 1")
    fields = model_file.read(args.teacher)
    teacher = weights.check(fields, str(args.teacher))
    seen, description = data.read(args.data, "train")
    said = learn.said_by(teacher, seen)
    truth = learn.targets(seen, args.label) if args.mix_truth > 0.0 else said
    target = soft_target(said, truth, args.mix_truth)
    n_epochs = args.epochs or learn.N_EPOCHS
    with Progress("epochs", n_epochs) as progress:
        trained = learn.fit(seen, target, args.student, args.seed, n_epochs, progress.advance)
    made = {
        "label": args.label,
        "mix_truth": args.mix_truth,
        "teacher_sha256": fields["sha256"],
        "model": args.student,
        "seed": args.seed,
    }
    return finish(args, trained, (seen, description), made)
