import json

import numpy as np
import pytest

from apex_edge.errors import WeightsError
from apex_edge.triggers import weights
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.triggers.linear import LinearTrigger


@pytest.fixture
def fields():
    return json.loads(weights.SHIPPED.read_text(encoding="utf-8"))


@pytest.fixture
def saved(tmp_path):
    def save(changed, is_rehashed=True):
        if is_rehashed:
            changed["sha256"] = weights.digest(changed)
        path = tmp_path / "weights.json"
        path.write_text(json.dumps(changed), encoding="utf-8")
        return path

    return save


def test_the_shipped_weights_load_and_state_what_they_promise():
    model = weights.load(weights.SHIPPED)
    assert model.weight.shape == (12,)
    promise = model.certificate
    assert promise["unit"] == "event"
    assert promise["n_pos"] >= 299
    assert promise["k"] >= 1
    assert promise["alpha"] == 0.01
    assert model.threshold == promise["logit"]


def test_an_untouched_copy_loads(fields, saved):
    assert weights.load(saved(fields)).bias == fields["bias"]


def test_a_changed_number_breaks_the_hash(fields, saved):
    fields["weights"][0] += 1e-9
    with pytest.raises(WeightsError, match="sha256"):
        weights.load(saved(fields, is_rehashed=False))


def change(path, value):
    def apply(fields):
        spot = fields
        for key in path[:-1]:
            spot = spot[key]
        spot[path[-1]] = value

    return apply


DAMAGE = {
    "another format": (change(["format"], "pickle"), "format"),
    "a newer version": (change(["format_version"], 2), "format_version"),
    "another kind": (change(["kind"], "graph"), "kind"),
    "another feature set": (change(["feature_set"], "wide24"), "feature_set"),
    "another feature version": (change(["feature_version"], 9), "feature_version"),
    "renamed features": (change(["feature_names", 0], "range"), "feature_names"),
    "other units": (change(["feature_units", 0], "m"), "feature_units"),
    "too few weights": (change(["weights"], [1.0]), "shape"),
    "a weight that is text": (change(["weights", 0], "much"), "wrong shape or type"),
    "a scale of zero": (change(["scaler", "scale", 3], 0.0), "positive"),
    "a negative scale": (change(["scaler", "scale", 3], -1.0), "positive"),
    "a clip upside down": (change(["clip", "lo", 1], 1e9), "low end"),
    "a domain upside down": (change(["domain", "sigma"], [2.0, 1.0]), "low end"),
    "an unknown domain": (change(["domain", "colour"], [0.0, 1.0]), "colour"),
    "a horizon of zero": (change(["horizon_s"], 0.0), "horizon_s"),
    "a threshold too large for a float": (change(["threshold", "logit"], 10**400), "OverflowError"),
    "an unknown key": (change(["comment"], "hi"), "comment"),
    "a golden logit that is off": (change(["golden", 1, "logit"], 0.123), "golden vector 1"),
    "a golden feature that is off": (change(["golden", 0, "features", 2], 0.1), "golden vector 0"),
    "no golden vectors": (change(["golden"], []), "golden"),
    "a weight that is off": (change(["weights", 6], 0.5), "golden"),
}


@pytest.mark.parametrize("kind", sorted(DAMAGE))
def test_damage_is_refused_even_with_a_fresh_hash(kind, fields, tmp_path):
    damage, message = DAMAGE[kind]
    damage(fields)
    rest = {key: value for key, value in fields.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    fields["sha256"] = weights.hashlib.sha256(text.encode("ascii")).hexdigest()
    path = tmp_path / "weights.json"
    path.write_text(json.dumps(fields), encoding="utf-8")
    with pytest.raises(WeightsError, match=message) as caught:
        weights.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("word", ["NaN", "Infinity", "-Infinity", "1e999"])
def test_not_a_number_is_refused(word, fields, tmp_path):
    fields["bias"] = "HERE"
    path = tmp_path / "weights.json"
    path.write_text(json.dumps(fields).replace('"HERE"', word), encoding="utf-8")
    with pytest.raises(WeightsError, match="not a number|Out of range"):
        weights.load(path)


@pytest.mark.parametrize("key", ["weights", "golden", "provenance", "sha256", "threshold"])
def test_a_missing_key_is_named(key, fields, tmp_path):
    del fields[key]
    path = tmp_path / "weights.json"
    path.write_text(json.dumps(fields), encoding="utf-8")
    with pytest.raises(WeightsError, match=key):
        weights.load(path)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"[1, 2]", b"{", b"[" * 100000, b"null"])
def test_a_file_that_is_no_weights_file_is_refused(content, tmp_path):
    path = tmp_path / "weights.json"
    path.write_bytes(content)
    with pytest.raises(WeightsError):
        weights.load(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(WeightsError, match="nowhere.json"):
        LinearTrigger(weights_path=tmp_path / "nowhere.json")


def test_the_logit_clips_what_lies_outside_the_training(fields):
    model = weights.check(fields, "shipped")
    far = np.full((1, len(FEATURE_NAMES)), 1e9)
    assert model.logit(far)[0] == model.logit(model.clip_hi[None])[0]
