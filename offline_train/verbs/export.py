"""``apex train export``: finish a certified model: test it, sign it, and write file and card.

Nothing is written that the device would refuse.
"""

import argparse
from pathlib import Path

from apex_edge.errors import InputError
from apex_edge.triggers import model_file, weights
from offline_train.reports import card, evaluation, sources
from offline_train.trigger import export

HELP = "test a certified model, sign it and write the device's file and its card"
EXAMPLE = "apex train export --model certified.json --data test/ --out trigger.npz --card card/"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--model", type=Path, required=True, help="certified model file")
    parser.add_argument(
        "--data", type=Path, nargs="+", required=True, help="folders generated for --purpose test"
    )
    parser.add_argument("--out", type=Path, required=True, help="file to write: .json or .npz")
    parser.add_argument("--card", type=Path, help="folder for the model card and its plots")


def run(args: argparse.Namespace) -> int:
    """Test, sign and write; return 0 on success.

    Raises
    ------
    InputError : the model is not certified, or the folder of ``--out`` does not exist.
    WeightsError, DataError, JobError : a file is damaged, or data is not for testing.
    MissingExtraError : scikit-learn or matplotlib is not installed.
    RecordingError : a file cannot be written.
    """
    if not args.out.resolve().parent.is_dir():
        raise InputError(f"--out {args.out}: its folder does not exist")
    models = sources.models([args.model])
    (model,) = models.values()
    if model.fields["threshold"] is None:
        raise InputError(
            f"{args.model}: has no certified threshold, and the device refuses such a file; "
            "run apex train calibrate first"
        )
    named = {args.out.stem: model}
    sets = sources.sets(args.data)
    tests = [evaluation.examine(one, named, sources.ceiling_inputs) for one in sets]
    fields = evaluation.finished(model.fields, tests)
    export.write(fields, args.out)
    weights.load(args.out)
    print(f"wrote {args.out}: sha256 {fields['sha256']}")
    if args.card is not None:
        files = card.card(model_file.read(args.out), args.out.stem, tests)
        card.write(files, args.card)
        print(f"wrote {args.card / args.out.stem}.md and {len(files) - 1} plots")
    return 0
