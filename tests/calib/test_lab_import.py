"""HiWonder's LAB ranges: read, measured on a picture, kept only when they can be used."""

import json

import cv2
import numpy as np
import pytest
from test_calibrate_colour import GREEN, RED, parsed, scene

from apex_edge.errors import ColourError
from apex_edge.perception import ColourTable
from apex_edge.perception.lab_range import LabRange
from calib.lab_import import read_ranges
from calib.verbs import colour as verb

FLAT = """
red:
  max: [255, 255, 255]
  min: [0, 160, 130]
green:
  max: [255, 112, 255]
  min: [0, 0, 120]
"""
ROS = "color_range_list:\n" + "".join(f"  {line}\n" for line in FLAT.strip().splitlines())


def written(tmp_path, text, name="lab_config.yaml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text", [FLAT, ROS, "/**:\n  ros__parameters:\n    " + ROS.replace("\n", "\n    ")]
)
def test_ranges_are_found_at_any_depth(tmp_path, text):
    ranges = read_ranges(written(tmp_path, text))
    assert ranges["red"] == LabRange("red", (0.0, 160.0, 130.0), (255.0, 255.0, 255.0))
    assert sorted(ranges) == ["green", "red"]


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "no colour with min and max"),
        ("red: [1, 2]", "no colour with min and max"),
        ("red: {min: [0, 0], max: [1, 1, 1]}", "three numbers"),
        ("red: {min: [0, 0, 300], max: [1, 1, 301]}", "three numbers"),
        ("red: {min: [9, 0, 0], max: [1, 1, 1]}", "three numbers"),
        ("red: {min: [a, 0, 0], max: [1, 1, 1]}", "three numbers"),
        ("red: {min: [true, 0, 0], max: [1, 1, 1]}", "three numbers"),
        ("a: &a [1]\nb: *a", "aliases"),
        ("red: {min: [", "not a YAML"),
        ("!!python/object/apply:os.system [echo]", "not a YAML"),
    ],
)
def test_what_is_no_list_of_ranges_is_refused(tmp_path, text, words):
    with pytest.raises(ColourError, match=words):
        read_ranges(written(tmp_path, text))


def test_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(ColourError, match="gone.yaml"):
        read_ranges(tmp_path / "gone.yaml")


def test_table_of_a_range_agrees_with_the_exact_range(tmp_path):
    ranges = read_ranges(written(tmp_path, FLAT))
    picture = scene([RED, GREEN])
    lab = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB)
    for name in ("red", "green"):
        exact = cv2.inRange(lab, np.array(ranges[name].lab_min), np.array(ranges[name].lab_max))
        found = ColourTable([ranges[name]]).classify(picture)
        assert np.mean((found > 0) == (exact > 0)) >= 0.995


def import_(tmp_path, text, *words):
    picture = tmp_path / "table.png"
    cv2.imwrite(str(picture), scene([RED, GREEN]))
    out = tmp_path / "colours.json"
    lab = str(written(tmp_path, text))
    return out, parsed("--image", str(picture), "--lab", lab, "--out", str(out), *words)


def test_usable_ranges_are_measured_and_kept(tmp_path, capsys):
    samples = ("--sample", "red:80,100,11", "--sample", "green:220,120,13")
    out, args = import_(tmp_path, FLAT, *samples, "--json")
    assert verb.run(args) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["verdict"] in ("pass", "warn")
    assert all(c["recall"] >= 0.9 for c in printed["colours"])
    table = ColourTable.load(out)
    assert table.models == tuple(read_ranges(tmp_path / "lab_config.yaml")[n] for n in table.names)


def test_range_that_takes_the_table_for_the_object_is_refused(tmp_path):
    wide = FLAT.replace("[0, 160, 130]", "[0, 0, 0]")
    out, args = import_(tmp_path, wide, "--sample", "red:80,100,11")
    with pytest.raises(ColourError, match="of the background for the object"):
        verb.run(args)
    assert not out.exists()


def test_sample_without_a_range_names_what_there_is(tmp_path):
    _, args = import_(tmp_path, FLAT, "--sample", "blue:80,100,11")
    with pytest.raises(ColourError, match="'blue'; there are: green, red"):
        verb.run(args)
