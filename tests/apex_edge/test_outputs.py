"""What a run leaves behind: whole files after a good end, nothing half written after a bad one."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import List

import pytest
from record_steps import step as make_step

from apex_edge.outputs import RunOutputs
from apex_edge.record.mcap_io import RecordingReader
from apex_edge.sink import NO_PICTURE, Sink
from apex_edge.types import Step

WHOLE = {"decisions.jsonl", "tracks.csv", "annotated.mp4", "montage.png", "recording.mcap"}


def names(folder: Path) -> set:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("draws_later", [False, True])
def test_a_good_run_leaves_every_file(tmp_path: Path, draws_later: bool) -> None:
    with RunOutputs(tmp_path / "out", 30.0, {"a": "b"}, draws_later=draws_later) as outputs:
        for seq in range(3):
            outputs.write(make_step(seq))
    assert names(tmp_path / "out") >= WHOLE
    assert len((tmp_path / "out" / "decisions.jsonl").read_text().splitlines()) == 3
    assert len(list(RecordingReader(tmp_path / "out" / "recording.mcap"))) == 3
    assert outputs.video.n_written == 3


def test_a_failed_run_leaves_only_the_readable_part_of_the_recording(tmp_path: Path) -> None:
    with pytest.raises(KeyError), RunOutputs(tmp_path / "out", 30.0, {"a": "b"}) as outputs:
        outputs.write(make_step(0))
        raise KeyError("something broke")
    assert names(tmp_path / "out") == {"recording.mcap.part"}


def test_a_step_without_picture_is_still_logged(tmp_path: Path) -> None:
    step = make_step(0)
    bare = replace(step, frame=replace(step.frame, colour_bgr=NO_PICTURE, depth_mm=None))
    with RunOutputs(tmp_path / "out", 30.0) as outputs:
        outputs.write(step)
        outputs.write(bare)
    assert len((tmp_path / "out" / "decisions.jsonl").read_text().splitlines()) == 2
    assert outputs.video.n_written == 1


def test_a_slow_writer_costs_pictures_but_never_steps() -> None:
    may_write = threading.Event()
    written: List[Step] = []

    def write(step: Step) -> None:
        assert may_write.wait(10.0)
        written.append(step)

    with Sink(write, max_waiting=2) as sink:
        for seq in range(8):
            sink.put(make_step(seq))
        may_write.set()
    assert [step.frame.seq for step in written] == list(range(8))
    without = [step for step in written if step.frame.colour_bgr.size == 0]
    assert len(without) == sink.n_pictures_left_out > 0


def test_a_writer_that_fails_is_reported_at_the_end() -> None:
    def write(step: Step) -> None:
        raise ValueError("disk full")

    with pytest.raises(ValueError, match="disk full"), Sink(write) as sink:
        sink.put(make_step(0))
        sink.put(make_step(1))
