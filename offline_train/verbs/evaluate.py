"""``apex train evaluate``: models side by side on test sets, with the four baselines."""

import argparse
import json
import time
from pathlib import Path
from typing import Any, Dict, List, Mapping

from offline_train.reports import card, evaluation, sources, tables
from offline_train.reports.card import Tested
from offline_train.reports.evaluation import Data, Model

HELP = "models side by side on test sets, with speed, k-sigma rule, paper's risk and boosted trees"
EXAMPLE = "apex train evaluate --model trigger.json --data test/ --report report/"
_SHOWN = ("recall", "negative_frames", "harmless_tracks", "pr_auc", "fpr_at_recall_0.99", "ece")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--model",
        type=Path,
        nargs="+",
        required=True,
        help="model files; the first sets recall",
    )
    parser.add_argument(
        "--data", type=Path, nargs="+", required=True, help="folders generated for --purpose test"
    )
    parser.add_argument("--report", type=Path, help="folder for markdown, JSON and plots")
    parser.add_argument("--json", action="store_true", help="print figures and curves as JSON")


def run(args: argparse.Namespace) -> int:
    """Evaluate, print, and write the report; return 0 on success.

    Raises
    ------
    WeightsError, DataError, JobError : a file is damaged, or data is not for testing.
    InputError : models that cannot be compared.
    MissingExtraError : scikit-learn or matplotlib is not installed.
    """
    models = sources.models(args.model)
    evaluation.terms(models)
    sets = sources.sets(args.data)
    tests = [evaluation.examine(one, models, sources.ceiling_inputs) for one in sets]
    if args.report is not None:
        card.write(evaluation.report(tests, models), args.report)
    if args.json:
        print(json.dumps(evaluation.plain(tests, models), allow_nan=False))
    else:
        print("\n\n".join([_text(test) for test in tests] + [_cost(models, sets)]))
    return 0


def _text(test: Tested) -> str:
    found = test.evaluation
    lines = [
        f"{test.name}: {found['n_events']} events, {tables.share(found['eligible_share'])} of the "
        f"contacts; {found['lead_s']:.1f} s before contact"
    ]
    lines.append(_row("rule", ("recall", "neg. frames", "harmless", "PR", "FPR99", "ECE")))
    for name, figures in found["rules"].items():
        lines.append(_row(name, [tables.number(figures.get(key)) for key in _SHOWN]))
    return "\n".join(lines)


def _cost(models: Mapping[str, Model], sets: List[Data]) -> str:
    """Return what scoring a pair takes here and now; not in the report, which stays the same."""
    took: Dict[str, Any] = {}
    seen = sets[0].seen
    for name, model in models.items():
        begin_s = time.process_time()
        model.score(seen)
        each_us = 1e6 * (time.process_time() - begin_s) / len(seen.pair)
        took[name] = f"{each_us:.3g} us a pair in bulk, {evaluation.n_parameters(model.fields)}"
    return "\n".join(f"cost of {name}: {text} parameters" for name, text in took.items())


def _row(name: str, cells: Any) -> str:
    return f"{name:20s}" + "".join(f"{cell:>13s}" for cell in cells)
