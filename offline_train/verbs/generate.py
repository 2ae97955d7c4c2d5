"""``apex train generate``: draw scenes of one purpose into a data folder.

What was begun is finished by the same command, by one process, several, or a dask cluster; the
bytes are the same. Source: ours.
"""

import argparse
import json
from pathlib import Path
from typing import Any, Callable, Dict, Optional, Tuple

from apex_edge import plugins
from apex_edge.errors import ApexError
from offline_train.trigger import data
from offline_train.trigger.observe import Watching

HELP = "draw scenes of a scenario, or star graphs, into a data folder"
EXAMPLE = "apex train generate --scenario committed --scenes 1000 --seed 1 --purpose train --out d"
_USUAL = Watching()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    known = ", ".join([*plugins.names("scenarios"), *data.STAR_SETS])
    parser.add_argument("--scenario", required=True, metavar="NAME", help=known)
    parser.add_argument("--scenes", type=int, required=True, metavar="N", help="scenes or graphs")
    parser.add_argument("--seed", type=int, required=True, help="same seed, same bytes")
    parser.add_argument("--purpose", required=True, choices=data.STORED_PURPOSES)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="data folder")
    for name, kind, what in (
        ("noise-mm", float, "sd of a position per axis, mm (0.5:3)"),
        ("fps", float, "frames per second (20:30)"),
        ("window", int, "frames of the motion fit (5:20)"),
    ):
        parser.add_argument(f"--{name}", type=_range_of(kind), metavar="LO[:HI]", help=what)
    parser.add_argument("--frames", type=int, help=f"frames watched ({_USUAL.n_frames})")
    parser.add_argument("--horizon", type=float, help=f"s, of the label ({_USUAL.horizon_s:g})")
    parser.add_argument(
        "--soft",
        type=int,
        metavar="N",
        help="soft labels by N roll-outs each, for a few frames of each pair; keeps only those",
    )
    parser.add_argument("--wide", action="store_true", help="the wide features as well")
    parser.add_argument(
        "--only-contacts", action="store_true", help="keep only scenes that end in a contact"
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (1)")
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="dask cluster to use")
    parser.add_argument("--json", action="store_true", help="print what was done as JSON")


def run(args: argparse.Namespace) -> int:
    """Draw what is missing; return 1 when items failed too often, as failed.json tells.

    Raises
    ------
    DataError : an option makes no sense, or the folder holds other data.
    JobError : the folder cannot be written, or workers keep dying.
    MissingExtraError, PluginError : a package or a scenario is missing.
    """
    if args.jobs < 1:
        raise ApexError(f"--jobs {args.jobs}: must be 1 or more")
    description = data.describe(
        args.scenario, args.purpose, args.seed, args.scenes, _watching(args), args.only_contacts
    )
    done = data.write(description, args.out, args.jobs, args.scheduler, is_quiet=args.json)
    if args.json:
        print(json.dumps(dict(vars(done), out=str(args.out)), sort_keys=True))
    else:
        print(
            f"{done.n_items} shards in {args.out}: {done.n_kept} were there, {done.n_done} drawn"
            + (f", {len(done.failed)} failed: see failed.json" if done.failed else "")
        )
    return done.exit_code


def _watching(args: argparse.Namespace) -> Optional[Watching]:
    """Return how to watch as the options say; None where none was given."""
    given: Dict[str, Any] = {
        "noise_m": args.noise_mm and tuple(0.001 * mm for mm in args.noise_mm),
        "fps": args.fps,
        "window": args.window,
        "n_frames": args.frames,
        "horizon_s": args.horizon,
        "is_wide": args.wide or None,
        "n_rollouts": args.soft,
    }
    chosen = {name: value for name, value in given.items() if value is not None}
    return Watching(**chosen) if chosen else None


def _range_of(kind: Callable[[str], Any]) -> Callable[[str], Tuple[Any, Any]]:
    def read(text: str) -> Tuple[Any, Any]:
        low, _, high = text.partition(":")
        try:
            return kind(low), kind(high or low)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"{text!r}: expected LO or LO:HI") from error

    return read
