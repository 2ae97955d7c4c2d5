"""The model card of an exported file: what it is, what is promised, and where that ends.

Markdown with plots beside it; everything comes from the document and the evaluations, so the same
file gives the same card. Source: ours; the headings follow the usual model card.
"""

from pathlib import Path
from typing import Any, Dict, List, Mapping, NamedTuple, Optional

from apex_edge.record.whole import write_whole_text
from offline_train.reports import curves, recipe, tables

_KINDS = {
    "linear": "a logistic regression on features of one pair of objects, in plain numpy",
    "graph": "a small graph network over the star around each mover, in plain numpy",
}
_CAVEATS = (
    "All scenes are simulated, and so is how people move in them. Noise is white and Gaussian; a "
    "real colour tracker has correlated errors, drop-outs and objects that hide one another.",
    "Whatever was not yet visibly moving is not counted as an event. The share that was is "
    "stated; no trigger can announce the rest.",
    "Event figures are per pair of tracks behind the gate and the vote below; another gate or "
    "vote voids them.",
    "Boosting is a ceiling by trial, not by proof: trees that learnt on two thirds of the very "
    "test scenes and score the last third.",
    "The trigger warns. It is no safety function in the sense of a standard; limits and the "
    "emergency stop of the arm hold without it.",
)
_LICENCE = (
    "Apache-2.0, as the project it belongs to. It was trained on generated scenes only; there is "
    "no personal data in it."
)


class Tested(NamedTuple):
    """One named test set: what ``evaluate`` and ``curves`` returned for it."""

    name: str
    evaluation: Mapping[str, Any]
    points: Mapping[str, Any]


def card(fields: Mapping[str, Any], stem: str, tests: List[Tested]) -> Dict[str, str]:
    """Return the files of a card by name: ``STEM.md`` and its plots.

    Parameters
    ----------
    fields : a certified model document; stem : name of its file without suffix.

    Raises
    ------
    MissingExtraError : matplotlib is not installed.
    """
    files: Dict[str, str] = {}
    parts = [
        f"# Hazard trigger `{stem}`\n\n{_what(fields)}",
        "## How it was trained\n\n" + _training(fields, stem),
        "## What is certified\n\n" + _certificate(fields),
    ]
    for test in tests:
        pictures = curves.draw(test.evaluation, test.points)
        names = {kind: f"{stem}-{test.name}-{kind}.svg" for kind in pictures}
        files.update({names[kind]: text for kind, text in pictures.items()})
        parts.append(f"## Figures on `{test.name}`\n\n" + section(test, names))
    parts += [
        "## Where it holds\n\n" + _domain(fields),
        "## Cost\n\n" + _cost(fields),
        "## Caveats\n\n" + "\n".join(f"- {text}" for text in _CAVEATS),
        "## Licence\n\n" + _LICENCE,
    ]
    files[f"{stem}.md"] = "\n\n".join(parts) + "\n"
    return files


def section(test: Tested, pictures: Mapping[str, str]) -> str:
    """Return tables and plots of one test set; ``pictures`` maps a kind of plot to its file."""
    found = test.evaluation
    origin = ", ".join(f"{key.replace('_', ' ')} {v}" for key, v in found.get("origin", {}).items())
    text = [
        f"Drawn as: {origin}." if origin else "",
        f"{found['n_scenes']} scenes with {found['n_tracks']} tracks, none of which a model has "
        f"learnt from. {found['n_contacts']} contacts could be watched up to "
        f"{found['lead_s']:.1f} s before; in {found['n_events']} of them "
        f"({tables.share(found['eligible_share'])}) the mover was visible in time, and these are "
        f"the events. Frame figures are over {found['n_frames']} frames that pass the gate, "
        f"{tables.share(found['positive_share'])} of them dangerous. A rule without a threshold of "
        "its own gets the one at which it announces as many events of this very set as the model, "
        "which flatters it a little: the model had to choose before.",
        tables.of_rules(found),
        tables.of_kinds(found),
        "Events announced, by the time before contact:",
        tables.of_leads(found),
    ]
    text += [f"![{_ALT[kind]}]({name})" for kind, name in pictures.items()]
    return "\n\n".join(part for part in text if part)


def write(files: Mapping[str, str], folder: Path) -> None:
    """Write the files of a card or a report into a folder, which is made if need be.

    Raises
    ------
    RecordingError : the folder or a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_whole_text(folder / name, text)


_ALT = {
    "pr": "precision against recall",
    "roc": "recall against false-positive rate",
    "reliability": "share that came true against probability said",
    "leads": "events announced against lead time",
}


def _what(fields: Mapping[str, Any]) -> str:
    joint = " to " if len(fields["windows"]) == 2 else ", "
    windows = joint.join(str(n) for n in fields["windows"])
    return (
        f"Says of two tracked objects whether they will touch within {fields['horizon_s']:g} s: "
        f"{_KINDS[fields['kind']]}. It is read by `apex run` on the device, which checks its hash "
        "and replays its golden vectors first.\n\n"
        + tables.of_text(
            [
                ("kind", fields["kind"]),
                ("features", f"{fields['feature_set']}, version {fields['feature_version']}"),
                ("inputs per pair", str(len(fields["feature_names"]))),
                ("windows it was trained on", f"{windows} frames"),
                ("frame rates", _range(fields["fps_range"], "Hz")),
                ("parameters", str(n_parameters(fields))),
                ("SHA-256", f"`{fields.get('sha256', 'not signed')}`"),
            ],
        )
    )


def _training(fields: Mapping[str, Any], stem: str) -> str:
    rows = [f"- {key}: {value}" for key, value in _flat(fields["provenance"], "")]
    text = "\n".join(rows)
    commands = recipe.commands(fields)
    if commands:
        text += (
            "\n\nThe commands, as far as the file records them (scenes to certify on are taken to "
            "be watched like those to learn from):\n\n```\n" + "\n".join(commands) + "\n```"
        )
    return text + "\n\nSame seed and same library versions give the same bytes."


def _certificate(fields: Mapping[str, Any]) -> str:
    promise = fields["threshold"]
    if promise is None:
        return "Nothing: no threshold has been chosen yet, and the device refuses such a file."
    n_late = _late(promise)
    late = (
        f" Another {n_late} contacts showed too little or too late to count as events."
        if n_late is not None
        else ""
    )
    gate = ", ".join(f"{key} = {value:g}" for key, value in sorted(fields["gate"].items()))
    return (
        f"With {tables.share(promise['confidence'])} confidence the model announces at least "
        f"{tables.share(1.0 - promise['alpha'])} of events {promise['lead_s']:.1f} s or more "
        f"before contact. The threshold (logit {promise['logit']:.4g}) is the "
        f"{_th(promise['k'])} smallest of {promise['n_pos']} scores, one per event of scenes that "
        f"the fit has not seen.{late}\n\n"
        "The promise needs no assumption on how scores are distributed, but it is one on the "
        f"whole procedure: of {1.0 / (1.0 - promise['confidence']):.0f} such files, one may fall "
        "short. It is void where objects, people or noise differ from the scenes it was certified "
        "on; certify anew on recordings of your own table then. It holds under this gate and vote "
        f"only: {gate}."
    )


def _late(promise: Mapping[str, Any]) -> Optional[int]:
    if "n_contacts" not in promise:
        return None
    return int(promise["n_contacts"]) - int(promise["n_pos"])


def _domain(fields: Mapping[str, Any]) -> str:
    units = dict(zip(fields["feature_names"], fields["feature_units"]))
    rows = [
        [name.replace("_m", ", combined") if name == "radius_m" else name]
        + [f"{low:.3g}", f"{high:.3g}", units.get(name, "m")]
        for name, (low, high) in sorted(fields["domain"].items())
    ]
    noise = fields["noise_model"]
    return (
        tables.markdown(("input", "from", "to", "unit"), rows)
        + f"\n\nPosition noise: {noise['kind']}, {_range(noise['sd_m'], 'm')}. Outside these "
        "ranges, with a track younger than the shortest window, or with another horizon, the "
        "device does not ask the model: the k-sigma rule judges (it fires when the closest "
        "approach lies within the combined radius plus k standard deviations of the miss), and "
        "the result is flagged as fallback. The certificate does not cover it."
    )


def _cost(fields: Mapping[str, Any]) -> str:
    return (
        f"{n_parameters(fields)} parameters. The time per frame depends on the machine and is "
        "therefore not part of this card: `apex bench trigger --suite cost` measures it."
    )


def n_parameters(fields: Mapping[str, Any]) -> int:
    """Return how many numbers were learnt."""
    if fields["kind"] == "linear":
        return len(fields["weights"]) + 1
    return _count(fields["graph"]["layers"])


def _count(value: Any) -> int:
    if isinstance(value, dict):
        return sum(_count(part) for part in value.values())
    if isinstance(value, list):
        return sum(_count(part) for part in value)
    return 1


def _flat(value: Any, name: str) -> List[Any]:
    if not isinstance(value, dict):
        return [(name, value)]
    found: List[Any] = []
    for key in sorted(value):
        found += _flat(value[key], f"{name}, {key}" if name else key.replace("_", " "))
    return found


def _range(ends: Any, unit: str) -> str:
    low, high = ends[0], ends[-1]
    return f"{low:g} {unit}" if low == high else f"{low:g} to {high:g} {unit}"


def _th(rank: int) -> str:
    last = rank % 10 if rank % 100 not in (11, 12, 13) else 0
    ending = {1: "st", 2: "nd", 3: "rd"}.get(last, "th")
    return f"{rank}{ending}"
