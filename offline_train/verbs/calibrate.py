"""``apex train calibrate``: certify the threshold of a model on generated scenes.

Source: APEX section "Trigger" (the score is compared with a threshold); the certificate is ours.
"""

import argparse
from pathlib import Path

from apex_edge.triggers import model_file
from offline_train.trigger import data
from offline_train.trigger.certify import certify
from offline_train.trigger.export import write
from offline_train.verbs.promises import add_promise, check_out, promise_of, report

HELP = "certify a model's threshold on a data folder drawn for calibration"
EXAMPLE = "apex train calibrate --model model.json --data calibration --out trigger.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--model", type=Path, required=True, help="model file, .json or .npz")
    parser.add_argument(
        "--data", type=Path, required=True, metavar="DIR", help="folder of apex train generate"
    )
    add_promise(parser)


def run(args: argparse.Namespace) -> int:
    """Certify and write; return 0 on success.

    Raises
    ------
    WeightsError, DataError, JobError, TooFewEventsError : nothing is written.
    """
    promise = promise_of(args)
    check_out(args.out)
    fields = model_file.read(args.model)
    seen, about = data.read(args.data, "calibration")
    made = certify(fields, seen, promise, {"kind": "generated", **data.origin(about)})
    write(made, args.out)
    print(report(made, args))
    return 0
