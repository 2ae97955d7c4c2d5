"""``apex train sweep``: try regularisation and clip of the linear trigger with Optuna."""

import argparse
import functools
import json
from pathlib import Path

from apex_edge.errors import ConfigError
from apex_edge.record.whole import write_whole_text
from offline_train.sweep import HEARTBEAT_S, Plan, sweep
from offline_train.trigger.tuning import linear_pr_auc

HELP = "try settings of the linear trigger by held-out PR-AUC; go on where a run was stopped"
EXAMPLE = "apex train sweep --trials 20 --seed 1 --out sweep.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--trials", type=int, default=20, help="complete trials wanted (20)")
    parser.add_argument("--seed", type=int, required=True, help="of the scenes and the sampler")
    parser.add_argument("--scenes", type=int, default=3000, help="training scenes (3000)")
    parser.add_argument("--jobs", type=int, default=1, help="worker processes (1)")
    parser.add_argument(
        "--storage",
        metavar="URL",
        help="data base of the trials, such as sqlite:///sweep.db (beside --out, named .db)",
    )
    parser.add_argument("--heartbeat", type=int, default=HEARTBEAT_S, metavar="S")
    parser.add_argument("--out", type=Path, required=True, help="file for the best settings")


def run(args: argparse.Namespace) -> int:
    """Sweep and write the best settings; return 0 on success.

    Raises
    ------
    ConfigError : an option that makes no sense.
    JobError : the data base cannot be used, or nothing completes.
    MissingExtraError : Optuna or scikit-learn is not installed.
    """
    for name, value in (("scenes", args.scenes), ("heartbeat", args.heartbeat)):
        if value < 1:
            raise ConfigError(f"--{name} {value}: expected 1 or more")
    out = args.out.resolve()
    if not out.parent.is_dir():
        raise ConfigError(f"--out {args.out}: its folder does not exist")
    plan = Plan(
        storage=args.storage or f"sqlite:///{out.with_suffix('.db')}",
        name=f"linear-{args.scenes}-scenes-seed-{args.seed}",
        seed=args.seed,
        heartbeat_s=args.heartbeat,
    )
    objective = functools.partial(linear_pr_auc, seed=args.seed, n_scenes=args.scenes)
    swept = sweep(objective, args.trials, plan, args.jobs)
    report = {
        "format": "apex-sweep",
        "format_version": 1,
        "study": plan.name,
        "n_complete": swept.n_complete,
        "pr_auc": swept.best_value,
        "best": swept.best,
    }
    write_whole_text(args.out, json.dumps(report, indent=1, sort_keys=True) + "\n")
    settings = ", ".join(f"{name} {value:.4g}" for name, value in sorted(swept.best.items()))
    print(f"{swept.n_complete} trials, {swept.n_lost} workers lost; best {settings}")
    print(f"held-out PR-AUC {swept.best_value:.4f}; wrote {args.out}")
    return 0
