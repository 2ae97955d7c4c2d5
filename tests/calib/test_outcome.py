"""How every calibration ends: what is told, what is written, and over what nothing is written."""

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from apex_edge import documents
from apex_edge.errors import CalibrationError, InputError
from calib.made import file_data, made
from calib.settings import Bench
from calib.verbs.outcome import Ending, check_usable, deliver, picture_path, refusal_told
from calib.verdict import PASS, REFUSE, Limit, judge

PICTURE = np.zeros((4, 4, 3), np.uint8)


def ending(out, is_json=True):
    source = out.parent / "data.csv"
    source.write_text("t_s\n")
    figures = {"verdict": PASS, "reasons": [], "rms_px": 0.1}
    document = documents.compose("apex-test", 1, {}, made(file_data([source]), figures))
    return argparse.Namespace(out=out, json=is_json), Ending(document, PICTURE, figures, ["fine"])


def test_result_names_its_data_and_tells_one_json_object(tmp_path, capsys):
    assert deliver(*ending(tmp_path / "a.json")) == 0
    told = json.loads(capsys.readouterr().out)
    about = json.loads((tmp_path / "a.json").read_text())["made"]
    assert told == {
        "verdict": PASS,
        "reasons": [],
        "rms_px": 0.1,
        "out": str(tmp_path / "a.json"),
        "picture": str(tmp_path / "a.png"),
    }
    assert set(about) == {
        "date",
        "data_sha256",
        "files",
        "versions",
        "verdict",
        "reasons",
        "rms_px",
    }
    assert about["files"] == ["data.csv"]


def test_refusal_tells_each_reason_and_all_figures(capsys):
    verdict = judge([Limit(3.0, 1.0, 2.0, "a {:.0f}"), Limit(9.0, 1.0, 2.0, "b {:.0f}")])
    with pytest.raises(CalibrationError, match="nothing written: a 3"), refusal_told(True) as known:
        known.update(verdict.plain(), rms_px=0.1)
        check_usable(verdict)
    told = json.loads(capsys.readouterr().out)
    assert (told["verdict"], len(told["reasons"]), told["rms_px"]) == (REFUSE, 2, 0.1)


def test_a_good_result_that_cannot_be_written_is_told_as_a_refusal(tmp_path, capsys):
    args, good = ending(tmp_path / "a.json")
    args.out = tmp_path / "no" / "a.json"
    with pytest.raises(InputError, match="cannot write"), refusal_told(True) as known:
        known.update(good.figures)
        deliver(args, good)
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] == REFUSE
    assert "cannot write" in told["reasons"][0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data.csv"]


@pytest.mark.parametrize(
    "out, inputs, shown",
    [
        ("a.json", [], "a.png"),
        ("a.json", ["./a.png"], "a-result.png"),
        ("a.png", [], "a-result.png"),
    ],
)
def test_picture_lies_beside_the_result_and_over_no_input(out, inputs, shown):
    assert picture_path(Path(out), [Path(name) for name in inputs]) == Path(shown)


def test_a_camera_can_be_named_with_and_without_a_settings_file(tmp_path):
    config = tmp_path / "apex.toml"
    config.write_text('[camera]\ntype = "live"\npath = "3"\nfps = 15.0\n')
    camera = Bench.read(config, "board", "9x6@10").camera
    assert (camera.type, camera.path, camera.fps) == ("board", "9x6@10", 15.0)
    assert Bench.read(config, None, None).camera.path == "3"
    assert Bench.read(None, "live", "0").camera.type == "live"
