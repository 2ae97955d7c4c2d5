"""Malformed inputs of ``apex bench perception``: all kinds run, and what is wrong is counted."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.types import Frame
from offline_train.benchmarks.perception import bad_frames, damage, judge, malformed

SEED = 3
CONFIG = PerceptionConfig()


def test_no_kind_of_malformed_input_gets_anything_made_up(tmp_path):
    found = [malformed.run_case(SEED, i, tmp_path / "case") for i in range(110)]
    failures = [outcome for outcome in found if outcome.result in malformed.FAILURES]
    assert failures == []
    assert {outcome.kind for outcome in found} == set(malformed.ROUND)
    assert {outcome.result for outcome in found} >= {bad_frames.REFUSED, bad_frames.TRUE}


def test_a_case_is_the_same_every_time(tmp_path):
    once, again = (malformed.run_case(SEED, 8, tmp_path / "case") for _ in range(2))
    assert once == again


def test_the_command_runs_its_cases_in_child_processes():
    outcomes = malformed.campaign(SEED, 12, is_quiet=True)
    assert [outcome.index for outcome in outcomes] == list(range(12))
    assert malformed.lines_of(SEED, outcomes)[-1].is_ok


def test_a_crash_and_a_silent_case_are_counted_and_the_rest_goes_on(monkeypatch):
    script = (
        "import os, sys, time, json\n"
        "first, last, results = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]\n"
        "with open(results, 'a') as file:\n"
        "    for i in range(first, last):\n"
        "        print(json.dumps({'begins': i}), file=file, flush=True)\n"
        "        if i == 2: os.abort()\n"
        "        if i == 4: time.sleep(600)\n"
        "        row = {'index': i, 'kind': 'clock', 'result': 'lost', 'detail': ''}\n"
        "        print(json.dumps(row), file=file, flush=True)\n"
    )
    monkeypatch.setattr(
        malformed,
        "command",
        lambda seed, a, b, results: [sys.executable, "-c", script, str(a), str(b), str(results)],
    )
    monkeypatch.setattr(malformed, "SILENCE_S", 2.0)
    outcomes = malformed.campaign(SEED, 7, is_quiet=True)
    results = [outcome.result for outcome in outcomes]
    assert results == ["lost", "lost", "crash", "lost", "hung", "lost", "lost"]
    assert "SIGABRT" in outcomes[2].detail
    assert malformed.lines_of(SEED, outcomes)[-1].is_ok is False


def test_an_exception_nobody_foresaw_is_a_failure(monkeypatch, tmp_path):
    def broken(rng):
        raise ZeroDivisionError("by nothing")

    monkeypatch.setitem(bad_frames.FRAME_CASES, malformed.ROUND[0], broken)
    outcome = malformed.run_case(SEED, 0, tmp_path)
    assert outcome.result == malformed.UNHANDLED
    assert "by nothing" in outcome.detail


def seen_frame(has_camera=False, **changes):
    rng = np.random.RandomState(1)
    picture = damage.balls(rng, 1)[0]
    depth = damage.depth_of(picture) if has_camera else None
    frame = Frame(0, 0.0, picture, depth, damage.camera() if has_camera else None)
    detections, tracks = Perception(CONFIG, ColourTable.builtin()).step(frame)
    assert len(tracks.name) == 2
    return frame, detections, tracks


def test_what_is_truly_there_passes_the_judge():
    assert judge.check(*seen_frame(), CONFIG) == 2
    assert judge.check(*seen_frame(has_camera=True), CONFIG) == 2


def test_a_sighting_on_bare_ground_is_called_made_up():
    frame, detections, tracks = seen_frame()
    bare = replace(frame, colour_bgr=damage.ground(np.random.RandomState(1)))
    with pytest.raises(judge.MadeUp, match="pixels have that hue"):
        judge.check(bare, detections, tracks, CONFIG)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda d, t: (d, replace(t, pos_m=t.pos_m * np.nan)), "not finite"),
        (lambda d, t: (d, replace(t, status=t.status + 2)), "still has a state"),
        (lambda d, t: (replace(d, pos_m=d.pos_m + 0.1), t), "off its own viewing ray"),
        (lambda d, t: (replace(d, pos_sd_m=d.pos_sd_m * 0.0), t), "with deviation 0.0"),
        (lambda d, t: (d, replace(t, track_id=t.track_id * 0)), "a track id twice"),
    ],
)
def test_a_state_that_cannot_be_is_called_made_up(change, message):
    frame, detections, tracks = seen_frame(has_camera=True)
    with pytest.raises(judge.MadeUp, match=message):
        judge.check(frame, *change(detections, tracks), CONFIG)


def test_a_position_from_no_depth_at_all_is_called_made_up():
    frame, detections, tracks = seen_frame(has_camera=True)
    holes = replace(frame, depth_mm=np.zeros_like(frame.depth_mm))
    with pytest.raises(judge.MadeUp, match="not from the table plane"):
        judge.check(holes, detections, tracks, CONFIG)
