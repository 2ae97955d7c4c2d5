"""Teaching colours from a labelled picture, through the function and through the verb."""

import argparse
import json

import cv2
import numpy as np
import pytest

from apex_edge.errors import ColourError, InputError, RecordingError
from apex_edge.perception import ColourTable
from apex_edge.twin.palette import PALETTE, SURROUNDINGS
from calib import colour
from calib.verbs import colour as verb
from calib.verdict import PASS, REFUSE, WARN


def scene(things, ground=SURROUNDINGS["table"], seed=0, sd=4.0):
    picture = np.empty((240, 320, 3), np.uint8)
    picture[:] = np.asarray(ground, dtype=np.uint8)
    for bgr, x, y, r in things:
        cv2.circle(picture, (x, y), r, tuple(float(v) for v in bgr), -1, cv2.LINE_AA)
    noise = np.random.RandomState(seed).normal(0.0, sd, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def parsed(*words):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return parser.parse_args(list(words))


def teach(tmp_path, picture, *words):
    path = tmp_path / "table.png"
    cv2.imwrite(str(path), picture)
    out = tmp_path / "out" / "colours.json"
    out.parent.mkdir(exist_ok=True)
    return out, verb.run(parsed("--image", str(path), "--out", str(out), *words))


RED = (PALETTE["red"], 80, 100, 15)
GREEN = (PALETTE["green"], 220, 120, 18)
SAMPLES = [colour.Sample("red", 80, 100, 11), colour.Sample("green", 220, 120, 13)]


def test_separable_colours_pass_and_are_found_again_in_other_light():
    result = colour.solve(scene([RED, GREEN]), SAMPLES)
    assert result.verdict.grade == PASS
    assert all(q.recall >= 0.98 and q.false_share <= 0.001 for q in result.quality)
    table = ColourTable(result.models)
    for gain in (0.65, 1.15):
        dim = np.clip(scene([RED, GREEN], seed=1) * gain, 0, 255).astype(np.uint8)
        labels = table.classify(dim)
        for label, (_, x, y, r) in enumerate((RED, GREEN), start=1):
            inside = labels[y - r // 2 : y + r // 2, x - r // 2 : x + r // 2]
            assert np.mean(inside == label) >= 0.97
        assert np.mean(labels[:60] > 0) <= 0.001


def test_highlight_in_the_disc_does_not_shift_the_colour():
    clean = colour.solve(scene([RED]), SAMPLES[:1])
    shiny = colour.solve(scene([RED, ((250, 250, 255), 83, 97, 4)]), SAMPLES[:1])
    assert 0.08 <= shiny.quality[0].foreign_share <= 0.2
    assert np.allclose(clean.models[0].chroma, shiny.models[0].chroma, atol=0.02)


def test_disc_drawn_too_large_still_gives_the_object_colour():
    clean = colour.solve(scene([RED]), SAMPLES[:1])
    large = colour.solve(scene([RED]), [colour.Sample("red", 80, 100, 17)])
    assert large.quality[0].verdict == WARN
    assert np.allclose(clean.models[0].chroma, large.models[0].chroma, atol=0.03)


def test_object_of_the_background_colour_is_refused_and_by_how_much_is_said():
    ground = np.asarray(PALETTE["green"]) * 0.9
    result = colour.solve(scene([GREEN], ground), SAMPLES[1:])
    assert result.verdict.grade == REFUSE
    assert result.quality[0].false_share >= 0.5
    assert any("of the background for the object" in reason for reason in result.quality[0].reasons)


def test_background_picture_can_refuse_what_the_picture_itself_would_pass():
    behind = scene([(PALETTE["red"], 160, 120, 90)], seed=3)
    assert colour.solve(scene([RED]), SAMPLES[:1]).verdict.grade == PASS
    assert colour.solve(scene([RED]), SAMPLES[:1], behind).verdict.grade == REFUSE


def test_two_names_for_one_colour_are_refused_as_confused():
    other = (PALETTE["red"], 220, 120, 15)
    samples = [colour.Sample("red", 80, 100, 11), colour.Sample("rose", 220, 120, 11)]
    result = colour.solve(scene([RED, other]), samples)
    assert result.verdict.grade == REFUSE
    assert any("look like" in reason for q in result.quality for reason in q.reasons)


def test_discs_of_one_name_are_pooled():
    dark = tuple(0.6 * v for v in PALETTE["red"])
    picture = scene([RED, (dark, 220, 120, 15)])
    result = colour.solve(
        picture, [colour.Sample("red", 80, 100, 11), colour.Sample("red", 220, 120, 11)]
    )
    assert [q.name for q in result.quality] == ["red"]
    assert result.verdict.grade == PASS


@pytest.mark.parametrize("x, y, r", [(-1, 50, 5), (320, 50, 5), (50, 240, 5), (50, 50, 400)])
def test_sample_outside_the_picture_is_refused(x, y, r):
    with pytest.raises(ColourError, match="320x240 picture"):
        colour.solve(scene([RED]), [colour.Sample("red", x, y, r)])


def test_tiny_disc_is_refused():
    with pytest.raises(ColourError, match="radius must be at least"):
        colour.solve(scene([RED]), [colour.Sample("red", 80, 100, 1.0)])


def test_grey_object_is_refused():
    with pytest.raises(ColourError, match="cannot be told by its hue"):
        colour.solve(scene([((90, 90, 90), 80, 100, 15)]), SAMPLES[:1])


def test_verb_writes_a_file_that_loads_and_a_picture(tmp_path, capsys):
    words = ("--sample", "red:80,100,11", "--sample", "green:220,120,13")
    out, code = teach(tmp_path, scene([RED, GREEN]), *words)
    assert code == 0
    table = ColourTable.load(out)
    assert table.names == ("red", "green")
    assert set(np.unique(table.classify(scene([RED, GREEN], seed=5)))) == {0, 1, 2}
    assert cv2.imread(str(out.with_suffix(".png"))).shape[1] == 960
    assert sorted(p.name for p in out.parent.iterdir()) == ["colours.json", "colours.png"]
    assert "red: pass" in capsys.readouterr().out


def test_verb_prints_json_on_demand(tmp_path, capsys):
    _, code = teach(tmp_path, scene([RED]), "--sample", "red:80,100,11", "--json")
    printed = json.loads(capsys.readouterr().out)
    assert code == 0
    assert printed["verdict"] == "pass"
    assert printed["colours"][0]["recall"] >= 0.98


def test_verb_refuses_and_writes_nothing(tmp_path):
    ground = np.asarray(PALETTE["green"]) * 0.9
    with pytest.raises(ColourError, match="'green'.*of the background") as refused:
        teach(tmp_path, scene([GREEN], ground), "--sample", "green:220,120,13")
    assert refused.value.exit_code == 2
    assert list((tmp_path / "out").iterdir()) == []


def test_one_bad_colour_keeps_the_good_one_from_being_written(tmp_path):
    ground = np.asarray(PALETTE["green"]) * 0.9
    words = ("--sample", "red:80,100,11", "--sample", "green:220,120,13")
    with pytest.raises(ColourError, match="'green'"):
        teach(tmp_path, scene([RED, GREEN], ground), *words)
    assert list((tmp_path / "out").iterdir()) == []


def test_old_file_survives_a_refusal(tmp_path):
    out, _ = teach(tmp_path, scene([RED]), "--sample", "red:80,100,11")
    before = out.read_bytes()
    with pytest.raises(ColourError):
        teach(tmp_path, scene([RED]), "--sample", "red:800,100,11")
    assert out.read_bytes() == before


def test_out_in_a_missing_folder_is_a_typed_error(tmp_path):
    path = tmp_path / "table.png"
    cv2.imwrite(str(path), scene([RED]))
    out = tmp_path / "no" / "colours.json"
    with pytest.raises(InputError, match="cannot write"):
        verb.run(parsed("--image", str(path), "--sample", "red:80,100,11", "--out", str(out)))


def test_frame_of_a_video_can_be_used(tmp_path):
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (320, 240))
    for seq in range(4):
        writer.write(scene([RED] if seq == 2 else [], seed=seq))
    writer.release()
    out = tmp_path / "colours.json"
    words = ("--image", str(path), "--sample", "red:80,100,11", "--out", str(out))
    assert verb.run(parsed(*words, "--frame", "2")) == 0
    with pytest.raises(RecordingError, match="the video has 4"):
        verb.run(parsed(*words, "--frame", "9"))


@pytest.mark.parametrize("name, content", [("a.png", b""), ("a.png", b"x"), ("a.mp4", b"x")])
def test_unreadable_picture_is_a_typed_error(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    words = ("--image", str(path), "--sample", "red:1,1,5", "--out", str(tmp_path / "c.json"))
    with pytest.raises(RecordingError, match=name):
        verb.run(parsed(*words))


@pytest.mark.parametrize("text", ["red", "red:1,2", ":1,2,3", "red:a,b,c", "red:1,2,nan", "1,2,3"])
def test_malformed_sample_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        verb.parse_sample(text)


def test_name_may_hold_a_colon():
    assert verb.parse_sample("big:red:1,2,3") == colour.Sample("big:red", 1.0, 2.0, 3.0)
