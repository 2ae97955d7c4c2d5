"""Plots of what a model is worth, as SVG that is the same to the byte for the same figures.

Colours are those of Okabe and Ito, which the colour-blind can tell apart; every rule has a line
style and a marker of its own as well, so that the plots survive a black-and-white print. The model
is drawn thick and on top of its baselines. Source: ours.
"""

import io
import math
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from offline_train.extras import module
from offline_train.trigger.evaluate import ANALYTIC, BOOSTING, PAPER_RISK, SPEED

NAMES = ("pr", "roc", "reliability", "leads")
_SETTINGS = {
    "svg.hashsalt": "apex-edge",
    "svg.fonttype": "path",
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.labelcolor": "#222222",
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.fontsize": 9.0,
    "legend.handlelength": 3.2,
}
_SIZE_IN = (5.2, 4.0)
_VISIBLE = "visible in time, of all contacts"
_AS_SAID = "as said"
_BELOW = "below"


class _Style(NamedTuple):
    colour: str
    line: Any
    marker: str
    width: float


_BESIDE = {
    SPEED: _Style("#E69F00", (0, (1, 1.5)), "^", 1.4),
    ANALYTIC: _Style("#009E73", (0, (5, 2)), "s", 1.4),
    PAPER_RISK: _Style("#CC79A7", (0, (5, 1.5, 1, 1.5)), "v", 1.4),
    BOOSTING: _Style("#777777", (0, (2, 1)), "D", 1.4),
}
_MODELS = (
    _Style("#0072B2", "-", "o", 2.4),
    _Style("#D55E00", "-", "P", 2.4),
    _Style("#56B4E9", "-", "X", 2.4),
    _Style("#000000", "-", "*", 2.4),
)


def draw(evaluation: Mapping[str, Any], points: Mapping[str, Any]) -> Dict[str, str]:
    """Return the SVG text of each plot of ``NAMES``.

    Parameters
    ----------
    evaluation : what ``evaluate`` returned; points : what ``curves`` returned, for the same rules.

    Raises
    ------
    MissingExtraError : matplotlib is not installed.
    """
    styles = styles_of(list(evaluation["rules"]))
    rules = evaluation["rules"]
    return {
        "pr": _figure(lambda axes: _pr(axes, points, rules, styles)),
        "roc": _figure(lambda axes: _roc(axes, points, rules, styles)),
        "reliability": _figure(lambda axes: _reliability(axes, points, styles)),
        "leads": _figure(lambda axes: _leads(axes, evaluation, styles)),
    }


def styles_of(names: Sequence[str]) -> Dict[str, _Style]:
    """Return colour, line and marker by rule; a baseline looks the same in every plot."""
    models = [name for name in names if name not in _BESIDE]
    found = {name: _MODELS[place % len(_MODELS)] for place, name in enumerate(models)}
    found.update({name: _BESIDE[name] for name in names if name in _BESIDE})
    return found


def _figure(paint: Callable[[Any], None]) -> str:
    matplotlib = module("matplotlib")
    with matplotlib.rc_context(_SETTINGS):
        figure = module("matplotlib.figure").Figure(figsize=_SIZE_IN, layout="constrained")
        paint(figure.add_subplot())
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()


def _pr(axes: Any, points: Mapping[str, Any], rules: Any, styles: Mapping[str, _Style]) -> None:
    for name in _models_last(styles):
        curve = points[name]["pr"]
        _line(axes, curve["recall"], curve["precision"], styles[name], _with(rules, name, "pr_auc"))
    _unit_axes(axes, "recall (share of dangerous frames)", "precision (share of alarms)")
    axes.set_title("Precision against recall, per frame", loc="left", fontsize=10.5)
    _legend(axes, "lower left", "area")


def _roc(axes: Any, points: Mapping[str, Any], rules: Any, styles: Mapping[str, _Style]) -> None:
    for name in _models_last(styles):
        curve = points[name]["roc"]
        _line(axes, curve["fpr"], curve["recall"], styles[name], _with(rules, name, "roc_auc"))
    axes.plot([0, 1], [0, 1], color="#aaaaaa", linewidth=0.8)
    _unit_axes(axes, "false-positive rate (share of harmless frames)", "recall")
    axes.set_title("Recall against false positives, per frame", loc="left", fontsize=10.5)
    _legend(axes, "lower right", "area")


def _reliability(axes: Any, points: Mapping[str, Any], styles: Mapping[str, _Style]) -> None:
    axes.plot([0, 1], [0, 1], color="#aaaaaa", linewidth=0.8, label=_AS_SAID)
    for name in _models_last(styles):
        curve = points[name].get("reliability")
        if curve is not None:
            style = styles[name]
            _line(axes, curve["said"], curve["came"], style, name, marker=style.marker)
    _unit_axes(axes, "probability the rule says", "share that came true within the horizon")
    axes.set_title("Reliability, 15 equal bins", loc="left", fontsize=10.5)
    _legend(axes, "upper left")


def _leads(axes: Any, evaluation: Mapping[str, Any], styles: Mapping[str, _Style]) -> None:
    rules = evaluation["rules"]
    for name in _models_last(styles):
        found = rules[name]["leads"]
        style = styles[name]
        recall = [math.nan if value is None else value for value in found["recall"]]
        _line(axes, found["lead_s"], recall, style, name, marker=style.marker)
    share = next(iter(rules.values()))["leads"]
    eligible = [math.nan if value is None else value for value in share["eligible_share"]]
    axes.plot(share["lead_s"], eligible, color="#222222", linewidth=0.9, label=_VISIBLE)
    axes.axvline(evaluation["lead_s"], color="#aaaaaa", linewidth=0.8)
    _unit_axes(axes, "lead time before contact (s)", "share of events")
    axes.set_xlim(0.0, share["lead_s"][-1])
    axes.set_title("Announced, of the events visible in time", loc="left", fontsize=10.5)
    _legend(axes, _BELOW)


def _line(
    axes: Any,
    x: Sequence[float],
    y: Sequence[float],
    style: _Style,
    label: str,
    marker: Optional[str] = None,
) -> None:
    axes.plot(
        x,
        y,
        color=style.colour,
        linestyle=style.line,
        linewidth=style.width,
        marker=marker,
        markersize=5.0,
        label=label,
    )


def _unit_axes(axes: Any, x_label: str, y_label: str) -> None:
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)


def _legend(axes: Any, place: str, title: str = "") -> None:
    """Name the lines, the models first although they are drawn last."""
    handles, labels = axes.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda i: _is_beside(labels[i]))
    ordered = ([handles[i] for i in order], [labels[i] for i in order])
    if place == _BELOW:
        axes.legend(*ordered, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
        return
    look = {"framealpha": 0.85, "edgecolor": "none", "alignment": "left"}
    axes.legend(*ordered, loc=place, title=title or None, **look).set_zorder(5)


def _is_beside(label: str) -> int:
    if label in (_VISIBLE, _AS_SAID):
        return 2
    return int(any(label.startswith(name) for name in _BESIDE))


def _with(rules: Any, name: str, figure: str) -> str:
    value = rules[name][figure]
    return name if value is None else f"{name} {value:.3f}"


def _models_last(styles: Mapping[str, _Style]) -> List[str]:
    names: List[Tuple[bool, str]] = [(name not in _BESIDE, name) for name in styles]
    return [name for _, name in sorted(names, key=lambda pair: pair[0])]
