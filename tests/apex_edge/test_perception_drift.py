"""A drifting white balance is noticed before the object is lost."""

import logging

import numpy as np
from test_perception import frame, perception

from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.perception.drift import EVERY, LIMIT
from apex_edge.perception.lab_range import LabRange
from apex_edge.types import Frame

THINGS = [("green", 300.0, 240.0, 16.0), ("red", 150.0, 100.0, 14.0)]


def look(stage, gains, n_looks=8, brightness=1.0):
    for seq in range(n_looks * EVERY):
        f = frame(seq, THINGS)
        tinted = f.colour_bgr * np.asarray(gains) * brightness
        stage.step(Frame(seq, f.t_s, np.clip(tinted, 0, 255).astype(np.uint8)))
    return stage.drift


def test_colours_as_taught_use_little_of_their_tolerance(caplog):
    drift = look(perception(), (1.0, 1.0, 1.0))
    assert set(drift.used) == {"green", "red"}
    assert max(drift.used.values()) <= 0.3
    assert drift.drifted == {} and not caplog.records


def test_darker_picture_is_no_drift():
    assert look(perception(), (1.0, 1.0, 1.0), brightness=0.6).drifted == {}


def test_white_balance_that_moved_is_told_once_while_the_object_is_still_found(caplog):
    stage = perception()
    with caplog.at_level(logging.WARNING):
        drift = look(stage, (1.45, 1.0, 0.85))
    assert "green" in drift.drifted and drift.used["green"] > LIMIT
    told = [record for record in caplog.records if "'green'" in record.getMessage()]
    assert len(told) == 1 and "apex calibrate colour" in told[0].getMessage()
    assert "green" in stage.step(frame(999, THINGS))[0].name


def test_nothing_is_said_after_a_single_look():
    assert look(perception(), (1.45, 1.0, 0.85), n_looks=2).used == {}


def test_imported_range_has_no_middle_to_drift_from():
    table = ColourTable([LabRange("green", (0.0, 0.0, 0.0), (255.0, 110.0, 255.0))])
    stage = Perception(PerceptionConfig(), table)
    assert "green" in stage.step(frame(0, THINGS))[0].name
    assert look(stage, (1.0, 1.0, 1.0)).used == {}
