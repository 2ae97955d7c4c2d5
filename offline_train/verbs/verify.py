"""``apex train verify``: load a model file as the device does and say what it promises.

Needs nothing but the device's packages. The golden vectors are replayed by loading.
"""

import argparse
import json
from pathlib import Path
from typing import Any, Dict, List

from apex_edge.triggers import model_file
from apex_edge.triggers.weights import load

HELP = "check a model file as the device would: hash, ranges, golden vectors, certificate"
EXAMPLE = "apex train verify apex_edge/data/trigger-linear.json"
_SHOWN = ("sha256", "kind", "feature_set", "feature_version", "horizon_s", "threshold", "domain")
_SHOWN += ("gate", "windows", "fps_range", "noise_model", "provenance", "metrics")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("file", type=Path, help="model file, .json or .npz")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(args: argparse.Namespace) -> int:
    """Verify and print; return 0 when the device would use the file.

    Raises
    ------
    WeightsError : it would not (exit code 2); says why.
    """
    load(args.file)
    fields = model_file.read(args.file)
    shown = {key: fields[key] for key in _SHOWN}
    shown["n_golden"] = len(fields["golden"])
    if "graph" in fields:
        shown["graph"] = {k: v for k, v in fields["graph"].items() if k not in _LARGE}
    print(json.dumps(shown, sort_keys=True) if args.json else report(shown, str(args.file)))
    return 0


_LARGE = ("layers", "node_scaler")


def report(shown: Dict[str, Any], name: str) -> str:
    """Return what a file promises as text."""
    promise = shown["threshold"]
    lines = [
        f"{name}: usable; {shown['n_golden']} golden vectors come out",
        _row("kind", _kind(shown)),
        _row("features", f"{shown['feature_set']}, version {shown['feature_version']}"),
        _row("horizon", f"{shown['horizon_s']:g} s"),
        _row(
            "certified",
            f"recall >= {1 - promise['alpha']:.3f} at {promise['confidence']:.0%} confidence, "
            f"{promise['lead_s']:g} s ahead, on {promise['n_pos']} events",
        ),
        _row("under", ", ".join(f"{key} {value}" for key, value in shown["gate"].items())),
    ]
    lines += [
        _row("domain", f"{key} {low:.4g} to {high:.4g}")
        for key, (low, high) in sorted(shown["domain"].items())
    ]
    lines += [_row("made by", text) for text in _flat(shown["provenance"])]
    lines.append(_row("sha256", shown["sha256"]))
    return "\n".join(lines)


def _kind(shown: Dict[str, Any]) -> str:
    if "graph" not in shown:
        return str(shown["kind"])
    spec = shown["graph"]
    return (
        f"graph: {spec['architecture']}, {spec['hidden']} wide, {spec['heads']} heads, "
        f"activation {spec['activation']}, edges {spec['edge_mode']}"
    )


def _flat(values: Dict[str, Any], prefix: str = "") -> List[str]:
    lines: List[str] = []
    for key, value in sorted(values.items()):
        if isinstance(value, dict):
            lines += _flat(value, f"{prefix}{key}.")
        else:
            lines.append(f"{prefix}{key} {value}")
    return lines


def _row(name: str, text: str) -> str:
    return f"  {name:10s} {text}"
