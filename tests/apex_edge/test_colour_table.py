"""The colour table and its file."""

import json

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apex_edge.errors import ColourError
from apex_edge.perception import ColourTable, colour_file, lookup
from apex_edge.twin.palette import PALETTE, SURROUNDINGS


def noisy(bgr, gain, seed, sd=6.0):
    rng = np.random.RandomState(seed)
    pixels = np.asarray(bgr) * gain + rng.normal(0.0, sd, (1, 4000, 3))
    return np.clip(pixels, 0, 255).astype(np.uint8)


def colour(name="red", **changes):
    values = {
        "name": name,
        "chroma": [0.5, 0.1],
        "chroma_cov": [[0.01, 0.0], [0.0, 0.01]],
        "log_luma": 4.5,
        "log_luma_sd": 0.4,
        "gate": 16.0,
        "floor": 0.5,
    }
    values.update(changes)
    return values


def write(path, colours, **changes):
    document = colour_file.compose(colours, {})
    document.update(changes)
    path.write_text(json.dumps(document))
    return path


@pytest.mark.parametrize("name", sorted(PALETTE))
@pytest.mark.parametrize("gain", [0.55, 0.8, 1.0, 1.15])
def test_twin_colour_is_recognised_in_shade_and_light(name, gain):
    table = ColourTable.builtin()
    labels = table.classify(noisy(PALETTE[name], gain, 3))
    assert np.mean(labels == table.names.index(name) + 1) >= 0.98


@pytest.mark.parametrize("name", sorted(SURROUNDINGS))
def test_surroundings_are_background(name):
    labels = ColourTable.builtin().classify(noisy(SURROUNDINGS[name], 1.0, 4))
    assert np.mean(labels > 0) <= 0.005


def test_grey_of_any_brightness_is_background():
    ramp = np.repeat(np.arange(256, dtype=np.uint8).reshape(1, 256, 1), 3, axis=2)
    assert not ColourTable.builtin().classify(ramp).any()


@given(st.lists(st.tuples(*[st.integers(0, 255)] * 3), min_size=1, max_size=40))
@settings(max_examples=40, deadline=None)
def test_a_picture_is_labelled_pixel_by_pixel(pixels):
    table = ColourTable.builtin()
    picture = np.array(pixels, dtype=np.uint8).reshape(1, -1, 3)
    alone = [table.classify(picture[:, i : i + 1].copy())[0, 0] for i in range(len(pixels))]
    assert table.classify(picture).tolist() == [alone]


def test_window_of_a_picture_is_labelled_like_the_picture():
    picture = np.random.RandomState(1).randint(0, 256, (40, 60, 3)).astype(np.uint8)
    table = ColourTable.builtin()
    assert np.array_equal(
        table.classify(picture)[7:31, 11:52], table.classify(picture[7:31, 11:52])
    )


def test_file_gives_back_the_same_table(tmp_path):
    builtin = ColourTable.builtin()
    colours = [dict(vars(model)) for model in builtin.models]
    path = write(tmp_path / "c.json", colours)
    picture = np.random.RandomState(2).randint(0, 256, (60, 80, 3)).astype(np.uint8)
    loaded = ColourTable.load(path)
    assert loaded.names == builtin.names
    assert np.array_equal(loaded.classify(picture), builtin.classify(picture))


def test_several_files_are_merged_in_order(tmp_path):
    one = write(tmp_path / "a.json", [colour("red")])
    two = write(tmp_path / "b.json", [colour("green", chroma=[-0.3, 0.4])])
    assert ColourTable.load(one, two).names == ("red", "green")


def test_a_name_in_two_files_is_refused(tmp_path):
    one = write(tmp_path / "a.json", [colour("red")])
    two = write(tmp_path / "b.json", [colour("red")])
    with pytest.raises(ColourError, match="'red' is defined twice"):
        ColourTable.load(one, two)


def test_edited_file_is_refused_by_its_hash(tmp_path):
    path = write(tmp_path / "c.json", [colour()])
    path.write_text(path.read_text().replace("4.5", "4.6"))
    with pytest.raises(ColourError, match="does not match its hash"):
        ColourTable.load(path)


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"chroma": [float("inf"), 0.0]}, "finite"),
        ({"chroma": [0.0, 0.0]}, "outside"),
        ({"chroma": [0.1]}, "2 numbers"),
        ({"chroma_cov": [[1.0, 2.0], [2.0, 1.0]]}, "not a covariance"),
        ({"chroma_cov": [[1.0, 0.1], [0.2, 1.0]]}, "not a covariance"),
        ({"gate": -1.0}, "outside"),
        ({"floor": 1.5}, "outside"),
        ({"log_luma_sd": None}, "finite numbers"),
        ({"name": ""}, "1 to 64 characters"),
    ],
)
def test_value_out_of_range_is_refused_though_the_hash_fits(tmp_path, changes, words):
    with pytest.raises(ColourError, match=words):
        ColourTable.load(write(tmp_path / "c.json", [colour(**changes)]))


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "not JSON"),
        ("[]", "not a file of format"),
        ('{"format": "apex-edge-colours", "version": 9}', "version 9 is not supported"),
        ("[" * 5000, "not JSON"),
    ],
)
def test_other_files_are_refused(tmp_path, text, words):
    path = tmp_path / "c.json"
    path.write_text(text)
    with pytest.raises(ColourError, match=words):
        ColourTable.load(path)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(ColourError, match="cannot read"):
        ColourTable.load(tmp_path / "none.json")


def test_classification_costs_less_than_two_lab_ranges():
    picture = noisy(PALETTE["red"], 1.0, 1)[:, :1].repeat(640, axis=1).repeat(480, axis=0).copy()
    table = ColourTable.builtin()
    low, high = (20, 150, 150), (200, 200, 200)

    def ranges():
        lab = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB)
        return cv2.inRange(lab, low, high), cv2.inRange(lab, low, high)

    def best(call):
        times = []
        for _ in range(15):
            start = cv2.getTickCount()
            call()
            times.append(cv2.getTickCount() - start)
        return min(times)

    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        assert best(lambda: table.classify(picture)) < best(ranges)
    finally:
        cv2.setNumThreads(n_threads)


def test_every_way_of_looking_up_gives_the_same():
    table = np.random.RandomState(0).randint(0, 256, lookup.N_WORDS).astype(np.uint8)
    every_word = np.arange(lookup.N_WORDS, dtype=np.uint16).reshape(256, 256)
    assert np.array_equal(lookup.look_up(table, every_word).ravel(), table)
    assert np.array_equal(lookup.look_up_by_index(table, every_word).ravel(), table)


def test_word_of_a_window_is_the_word_of_the_picture():
    picture = np.random.RandomState(1).randint(0, 256, (40, 60, 3)).astype(np.uint8)
    whole, window = lookup.words(picture), lookup.words(picture[5:30, 7:50])
    assert np.array_equal(whole[5:30, 7:50], window)


@pytest.mark.parametrize(
    "change", [{"lab_min": [0, 0]}, {"lab_min": [0, 0, 256]}, {"lab_max": [1, 2, "x"]}]
)
def test_range_outside_lab_is_refused(tmp_path, change):
    colour = {"name": "red", "lab_min": [0, 10, 20], "lab_max": [255, 200, 220], **change}
    path = tmp_path / "c.json"
    path.write_text(json.dumps(colour_file.compose([colour], {})))
    with pytest.raises(ColourError, match="LAB|lab_m"):
        ColourTable.load(path)
