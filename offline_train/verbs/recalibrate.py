"""``apex train recalibrate``: certify a model's threshold anew on recordings of your own rig.

A certificate holds for scenes like those it was made on. On another table, camera or with other
hands its promise is void until it has been made anew; this is how. Source: ours.
"""

import argparse
import hashlib
from pathlib import Path

from apex_edge.assemble import load_config
from apex_edge.triggers import model_file
from offline_train.trigger.certify import certify
from offline_train.trigger.export import write
from offline_train.trigger.recorded import Rig, read_folder
from offline_train.verbs.promises import add_promise, check_out, promise_of, report

HELP = "certify a model's threshold anew on recordings of your own rig"
EXAMPLE = "apex train recalibrate --recordings runs --model trigger.json --out mine.json --alpha .1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--recordings", type=Path, required=True, metavar="DIR", help="folder with *.mcap"
    )
    parser.add_argument("--model", type=Path, required=True, help="model file, .json or .npz")
    parser.add_argument("--config", type=Path, help="settings file (TOML) of the rig")
    add_promise(parser)


def run(args: argparse.Namespace) -> int:
    """Certify and write; return 0 on success.

    Raises
    ------
    WeightsError, RecordingError, ConfigError, TooFewEventsError : nothing is written.
    """
    promise = promise_of(args)
    check_out(args.out)
    fields = model_file.read(args.model)
    rig = Rig(load_config(args.config), float(fields["horizon_s"]))
    seen, paths = read_folder(args.recordings, rig)
    origin = {
        "kind": "recordings",
        "recordings": {path.name: _sha256(path) for path in paths},
        "protected": list(rig.config.agent.protected),
    }
    made = certify(fields, seen, promise, origin)
    write(made, args.out)
    print(report(made, args))
    return 0


def _sha256(path: Path) -> str:
    found = hashlib.sha256()
    with path.open("rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            found.update(block)
    return found.hexdigest()
