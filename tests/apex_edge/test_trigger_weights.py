import contextlib
import json
import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from apex_edge.errors import RecordingError, WeightsError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.triggers.linear import LinearTrigger
from offline_train.benchmarks.trigger import damages

SHIPPED = model_file.read(weights.SHIPPED)
DOCUMENTS = {"linear": SHIPPED, "graph": damages.made_graph(SHIPPED, 0)}
SUFFIXES = (".json", ".npz")


def load_bytes(tmp_path, data, suffix):
    path = tmp_path / f"model{suffix}"
    path.write_bytes(data)
    return weights.load(path)


def test_the_shipped_weights_load_and_state_what_they_promise():
    model = weights.load(weights.SHIPPED)
    assert model.weight.shape == (12,)
    promise = model.certificate
    assert promise["unit"] == "event"
    assert promise["n_pos"] >= 299
    assert promise["k"] >= 1
    assert promise["alpha"] == 0.01
    assert model.threshold == promise["logit"]


@pytest.mark.parametrize("kind", sorted(DOCUMENTS))
def test_both_forms_hold_the_same_content_and_the_same_bytes_each_time(kind, tmp_path):
    fields = DOCUMENTS[kind]
    for suffix in SUFFIXES:
        first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
        model_file.write(fields, first)
        model_file.write(model_file.read(first), second)
        assert model_file.read(first) == fields
        assert first.read_bytes() == second.read_bytes()
        assert weights.load(first).threshold == fields["threshold"]["logit"]
    assert not list(tmp_path.glob("*.part"))


def test_numpy_itself_reads_the_arrays(tmp_path):
    model_file.write(DOCUMENTS["graph"], tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as archive:
        found = archive["graph.layers.conv.lin_key.weight"]
        names = set(archive.files)
    assert found.tolist() == DOCUMENTS["graph"]["graph"]["layers"]["conv.lin_key.weight"]
    assert "document" in names


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("kind", "damage"), [(kind, name) for kind in DOCUMENTS for name in damages.damages_of(kind)]
)
def test_damage_is_refused_even_with_a_fresh_hash(kind, damage, suffix, tmp_path):
    apply, message = damages.damages_of(kind)[damage]
    data = damages.damaged(DOCUMENTS[kind], apply, suffix)
    with pytest.raises(WeightsError, match=message) as caught:
        load_bytes(tmp_path, data, suffix)
    assert str(tmp_path / f"model{suffix}") in str(caught.value)


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [(".npz", name) for name in damages.OF_NPZ] + [(".json", name) for name in damages.OF_JSON],
)
def test_a_file_that_is_no_model_file_is_refused(suffix, damage, tmp_path):
    table = damages.OF_NPZ if suffix == ".npz" else damages.OF_JSON
    form = model_file.as_npz if suffix == ".npz" else model_file.as_json
    sound = form(DOCUMENTS["graph"])
    spoilt = table[damage](sound)
    assert spoilt != sound
    load_bytes(tmp_path, sound, suffix)
    with pytest.raises(WeightsError):
        load_bytes(tmp_path, spoilt, suffix)


@settings(deadline=None, max_examples=300, suppress_health_check=list(HealthCheck))
@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(sorted(DOCUMENTS)), form=st.booleans())
def test_any_change_of_the_bytes_is_refused_or_changes_nothing(tmp_path, seed, kind, form):
    suffix = SUFFIXES[form]
    sound = (model_file.as_npz if form else model_file.as_json)(DOCUMENTS[kind])
    path = tmp_path / f"model{suffix}"
    path.write_bytes(damages.mutated(sound, np.random.default_rng(seed)))
    try:
        found = model_file.read(path)
    except WeightsError:
        return
    assert found == DOCUMENTS[kind]


@settings(deadline=None, max_examples=200, suppress_health_check=list(HealthCheck))
@given(data=st.binary(max_size=300), suffix=st.sampled_from(SUFFIXES), is_zip=st.booleans())
def test_any_bytes_are_refused(tmp_path, data, suffix, is_zip):
    with pytest.raises(WeightsError):
        load_bytes(tmp_path, b"PK\x03\x04" + data if is_zip else data, suffix)


JSON_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=8,
)


@settings(deadline=None, max_examples=120, suppress_health_check=list(HealthCheck))
@given(data=st.data(), kind=st.sampled_from(sorted(DOCUMENTS)), value=JSON_VALUES)
def test_any_value_in_any_place_loads_or_is_refused(tmp_path, data, kind, value):
    path, spot = [], DOCUMENTS[kind]
    while isinstance(spot, (dict, list)) and spot and (not path or data.draw(st.integers(0, 4))):
        keys = sorted(spot) if isinstance(spot, dict) else range(len(spot))
        path.append(data.draw(st.sampled_from(list(keys))))
        spot = spot[path[-1]]
    spoilt = damages.damaged(DOCUMENTS[kind], damages.changed(path, value), ".json")
    with contextlib.suppress(WeightsError):
        load_bytes(tmp_path, spoilt, ".json")


def test_a_changed_number_breaks_the_hash(tmp_path):
    text = weights.SHIPPED.read_text(encoding="utf-8")
    bias = SHIPPED["bias"]
    spoilt = text.replace(json.dumps(bias), json.dumps(bias * (1.0 + 1e-15)), 1)
    assert spoilt != text
    with pytest.raises(WeightsError, match="sha256"):
        load_bytes(tmp_path, spoilt.encode("ascii"), ".json")


def test_a_file_of_another_suffix_is_refused(tmp_path):
    with pytest.raises(WeightsError, match="ends in"):
        model_file.write(SHIPPED, tmp_path / "model.pkl")
    with pytest.raises(WeightsError, match="ends in"):
        load_bytes(tmp_path, model_file.as_json(SHIPPED), ".pkl")


def test_what_cannot_be_written_is_refused_and_leaves_no_file(tmp_path):
    for value in (float("nan"), float("inf"), {1, 2}):
        with pytest.raises(WeightsError, match="not a document"):
            model_file.write(dict(SHIPPED, bias=value), tmp_path / "m.json")
    with pytest.raises(WeightsError, match="reserved"):
        model_file.write(dict(SHIPPED, metrics={"array": "x"}), tmp_path / "m.npz")
    with pytest.raises(RecordingError, match="cannot write"):
        model_file.write(SHIPPED, tmp_path / "nowhere" / "m.npz")
    assert not list(tmp_path.iterdir())


def test_an_array_without_bytes_is_refused_before_its_rows_fill_the_memory(tmp_path):
    damage = damages.OF_NPZ["an empty array of many rows"]
    with pytest.raises(WeightsError, match="empty arrays are refused"):
        load_bytes(tmp_path, damage(model_file.as_npz(DOCUMENTS["graph"])), ".npz")


def test_a_whole_number_of_many_digits_is_refused_before_it_is_parsed(tmp_path):
    text = json.dumps(dict(SHIPPED, dims="DIGITS")).replace('"DIGITS"', "9" * 3000)
    with pytest.raises(WeightsError, match="3000 digits"):
        load_bytes(tmp_path, text.encode("ascii"), ".json")


def test_a_file_too_large_to_be_read_again_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(model_file, "MAX_BYTES", len(model_file.as_json(SHIPPED)) - 1)
    with pytest.raises(WeightsError, match="read again"):
        model_file.write(SHIPPED, tmp_path / "m.json")
    assert not list(tmp_path.iterdir())


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(WeightsError, match=re.escape("nowhere.json")):
        LinearTrigger(weights_path=tmp_path / "nowhere.json")


def test_a_model_of_the_other_kind_is_refused_and_says_what_to_set(tmp_path):
    model_file.write(DOCUMENTS["graph"], tmp_path / "g.npz")
    with pytest.raises(WeightsError, match="trigger.type = graph"):
        weights.load_linear(tmp_path / "g.npz")
    with pytest.raises(WeightsError, match="trigger.type = linear"):
        weights.load_graph(weights.SHIPPED)


def test_a_model_without_a_threshold_can_be_checked_but_not_used(tmp_path):
    fields = dict(SHIPPED, threshold=None)
    model = weights.check(fields, "fresh")
    assert not (model.logit(np.zeros((1, 12))) >= model.threshold).any()
    model_file.write(fields, tmp_path / "m.json")
    with pytest.raises(WeightsError, match="calibrate"):
        weights.load(tmp_path / "m.json")


def test_the_logit_clips_what_lies_outside_the_training():
    model = weights.check(SHIPPED, "shipped")
    far = np.full((1, len(FEATURE_NAMES)), 1e9)
    assert model.logit(far)[0] == model.logit(model.columns.hi[None])[0]


def test_the_chances_say_what_a_logit_means_and_without_them_the_sigmoid_does():
    chances = {"logit": [-1.0, 1.0, 3.0], "probability": [0.1, 0.3, 0.9]}
    model = weights.check(dict(SHIPPED, chances=chances), "tuned")
    said = model.probability(np.array([-9.0, 0.0, 2.0, 9.0]))
    assert said == pytest.approx([0.1, 0.2, 0.6, 0.9])
    plain = weights.check({k: v for k, v in SHIPPED.items() if k != "chances"}, "plain")
    assert plain.probability(np.array([0.0, 1.0])) == pytest.approx([0.5, 1 / (1 + np.exp(-1.0))])
