"""Real clips, where they are at hand: a colour taught from one frame, then followed."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.types import Frame, TrackStatus
from calib import colour

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("APEX_TEST_DATA", str(ROOT.parent / "shared" / "data"))) / "clips"

pytestmark = pytest.mark.skipif(
    not DATA.is_dir(), reason="no labelled clips; APEX_TEST_DATA names the folder that holds them"
)


def load(name):
    truth = json.loads((DATA / name / "truth.json").read_text())
    video = cv2.VideoCapture(str(DATA / name / truth["video"]))
    frames = []
    while True:
        is_read, picture = video.read()
        if not is_read:
            return truth, frames
        frames.append(picture)


def taught(truth, frames, label):
    radius = 0.5 * np.sqrt(label["area_px2"] / np.pi)
    sample = colour.Sample(label["name"], label["x_px"], label["y_px"], radius)
    result = colour.solve(frames[label["frame"]], [sample])
    assert not result.verdict.is_refused
    return ColourTable(result.models)


def follow(truth, frames, table):
    stage, found = Perception(PerceptionConfig(), table), []
    for seq, picture in enumerate(frames):
        _, tracks = stage.step(Frame(seq, seq / truth["nominal_fps"], picture))
        found.append(tracks.centre_px[tracks.status == TrackStatus.SEEN])
    return found


@pytest.mark.parametrize(
    "name, label", [("dark_green", 3), ("orange_bounce", 0), ("orange_bounce", 7)]
)
def test_colour_taught_from_one_frame_follows_the_ball(name, label):
    truth, frames = load(name)
    found = follow(truth, frames, taught(truth, frames, truth["centres"][label]))
    misses = []
    for centre in truth["centres"]:
        seen = found[centre["frame"]]
        gaps = np.hypot(seen[:, 0] - centre["x_px"], seen[:, 1] - centre["y_px"])
        misses.append(gaps.min() if len(gaps) else np.inf)
    assert np.mean(np.array(misses) <= truth["tolerance_px"]) >= 0.95
    assert sum(len(found[absent["frame"]]) for absent in truth["absent"]) == 0


def test_shadow_of_the_green_ball_is_not_reported():
    truth, frames = load("dark_green")
    found = follow(truth, frames, taught(truth, frames, truth["centres"][3]))
    assert max(len(seen) for seen in found) == 1
