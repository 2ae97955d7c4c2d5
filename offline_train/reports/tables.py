"""Tables in markdown, and figures as people read them."""

from typing import Any, Dict, List, Mapping, Optional, Sequence

FIGURES = (
    ("recall", "event recall"),
    ("negative_frames", "negative frames firing"),
    ("harmless_tracks", "harmless tracks firing"),
    ("pr_auc", "PR area"),
    ("roc_auc", "ROC area"),
    ("fpr_at_recall_0.90", "FPR at recall .90"),
    ("fpr_at_recall_0.95", "FPR at .95"),
    ("fpr_at_recall_0.99", "FPR at .99"),
    ("ece", "ECE"),
    ("brier", "Brier"),
    ("log_loss", "log-loss (nat)"),
    ("fallback_share", "frames outside its domain"),
)
_SHARES = ("recall", "negative_frames", "harmless_tracks", "fallback_share")
_SHOWN_LEADS_S = (0.2, 0.6, 1.0, 1.4, 2.0, 3.0)


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a markdown table; the first column is text, the others are figures."""
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def of_text(rows: Sequence[Sequence[str]]) -> str:
    """Return a markdown table of names and texts, without a head."""
    return "\n".join(["| | |", "|---|---|"] + ["| " + " | ".join(row) + " |" for row in rows])


def share(value: Optional[float]) -> str:
    """Return a share in percent; a dash where there is none."""
    return "-" if value is None else f"{100.0 * value:.1f} %"


def number(value: Optional[float]) -> str:
    """Return a figure with three digits that count; a dash where there is none."""
    return "-" if value is None else f"{value:.3g}"


def of_rules(evaluation: Mapping[str, Any]) -> str:
    """Return the main table: one row per rule, event figures first."""
    rows: List[List[str]] = []
    for name, found in evaluation["rules"].items():
        cells = [
            share(found.get(key)) if key in _SHARES else number(found.get(key))
            for key, _ in FIGURES
        ]
        rows.append([name] + cells)
    return markdown(["rule"] + [title for _, title in FIGURES], rows)


def of_kinds(evaluation: Mapping[str, Any]) -> str:
    """Return the share of harmless tracks that fire by kind; empty where no kinds are known."""
    rules = evaluation["rules"]
    kinds: Dict[str, Any] = next(iter(rules.values()))["by_kind"]
    if not kinds:
        return ""
    head = ["harmless tracks firing"] + [f"{kind} (n = {kinds[kind]['n']})" for kind in kinds]
    rows = [
        [name] + [share(one["fired"] / one["n"]) for one in found["by_kind"].values()]
        for name, found in rules.items()
    ]
    return markdown(head, rows)


def of_leads(evaluation: Mapping[str, Any]) -> str:
    """Return event recall by lead time, the eligible share in the first row."""
    rules = evaluation["rules"]
    leads = next(iter(rules.values()))["leads"]
    places = [leads["lead_s"].index(lead_s) for lead_s in _SHOWN_LEADS_S]
    head = ["lead before contact"] + [f"{lead_s:.1f} s" for lead_s in _SHOWN_LEADS_S]
    rows = [["*visible in time*"] + [share(leads["eligible_share"][i]) for i in places]]
    rows += [
        [name] + [share(found["leads"]["recall"][i]) for i in places]
        for name, found in rules.items()
    ]
    return markdown(head, rows)
