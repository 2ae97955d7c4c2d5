"""The commands that made a model, as far as its document records them. Source: ours."""

from typing import Any, List, Mapping, Sequence

from apex_edge.triggers.wide import WIDE_SET


def commands(fields: Mapping[str, Any]) -> List[str]:
    """Return the commands, one a line; none where the document does not say enough.

    Scenes to certify on and frames a scene are taken to be watched as usual.
    """
    made = fields["provenance"]
    if "command" in made:
        return [str(made["command"])]
    if not {"data", "model", "seed"} <= set(made):
        return []
    label = f" --label {made['label']}" if "label" in made else ""
    how = f"fit --model {made['model']}"
    if "teacher_sha256" in made:
        how = (
            f"distill --teacher TEACHER --student {made['model']} --mix-truth {made['mix_truth']:g}"
        )
    lines = [
        _generate(made["data"], "train", fields),
        f"apex train {how} --data train{label} --seed {made['seed']} --out fitted.json",
    ]
    certified, promise = made.get("certified_on", {}), fields["threshold"]
    if promise is not None and certified.get("kind") == "generated":
        lines += [
            _generate(certified, "calibration", fields),
            "apex train calibrate --model fitted.json --data calibration "
            f"--alpha {promise['alpha']:g} --confidence {promise['confidence']:g} "
            f"--lead {promise['lead_s']:g} --out certified.json",
        ]
    return lines


def _generate(drawn: Mapping[str, Any], purpose: str, fields: Mapping[str, Any]) -> str:
    flags = [" --only-contacts"] if drawn.get("only_contacts") else []
    flags += [" --wide"] if fields["feature_set"] == WIDE_SET else []
    flags += [f" --soft {drawn['n_rollouts']}"] if "n_rollouts" in drawn else []
    noise_mm = [1000.0 * sd for sd in fields["noise_model"]["sd_m"]]
    return (
        f"apex train generate --scenario {drawn['scenario']} --scenes {drawn['n_scenes']} "
        f"--seed {drawn['seed']} --purpose {purpose} --noise-mm {_span(noise_mm)} "
        f"--fps {_span(fields['fps_range'])} --window {_span(fields['windows'])} "
        f"--horizon {fields['horizon_s']:g}{''.join(flags)} --out {purpose}"
    )


def _span(ends: Sequence[float]) -> str:
    return f"{ends[0]:g}:{ends[-1]:g}"
