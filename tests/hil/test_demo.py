"""The demo as a user calls it: counts, refusals, and the report of scenes in real time."""

import json
from pathlib import Path
from typing import List

import pytest

from apex_edge.assemble import ApexConfig, Kit
from apex_edge.cli import main
from apex_edge.closed_loop import ScenePlayer
from apex_edge.outputs import RunOutputs
from apex_edge.sink import Sink
from apex_edge.twin.scenarios import make


def test_a_fast_demo_counts_what_its_scenes_did(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    counts = tmp_path / "counts.json"
    asked = ["demo", "--fast", "--scenarios", "1", "--kinds", "collision,no-moving", "--jobs", "1"]
    assert main([*asked, "--json", str(counts)]) == 0
    found = json.loads(counts.read_text())
    assert [scene["kind"] for scene in found["scenes"]] == ["collision", "no-moving"]
    collision, still = found["scenes"]
    assert collision["trigger_s"] < collision["reflex_ready_s"] <= collision["command_sent_s"]
    assert collision["command_sent_s"] < collision["arm_arrived_s"] < collision["free_contact_s"]
    assert still["command_sent_s"] is None
    assert found["counts"]["collision"]["n_prevented_eligible"] == 1
    assert found["counts"]["no-moving"]["n_interventions"] == 0
    out = capsys.readouterr().out
    assert "the reflex acts alone" in out
    assert "prevented 1 of 1" in out


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--scenarios", "3"], "--fast"),
        (["--fast", "--kinds", "colision"], "colision"),
        (["--fast", "--scenarios", "0"], "1 or more"),
        (["--fast", "--jobs", "0"], "1 or more"),
    ],
)
def test_options_that_make_no_sense_are_refused(
    capsys: pytest.CaptureFixture, options: List[str], reason: str
) -> None:
    assert main(["demo", *options]) == 2
    assert reason in capsys.readouterr().err


def test_a_scene_in_real_time_leaves_its_pictures_and_a_stopped_arm(tmp_path: Path) -> None:
    kit = Kit.from_config(ApexConfig())
    outputs = RunOutputs(tmp_path, kit.config.twin.fps, {"a": "b"}, ".webm", draws_later=True)
    with outputs, Sink(outputs.write) as sink:
        outcome = ScenePlayer(kit, {}).play(make("no-moving", 2), sink.put, is_real_time=True)
    outputs.report("a still scene")
    assert not outcome.is_intervention
    assert outcome.camera.delivered > 20
    assert outputs.video.n_written > 20
    assert (tmp_path / "report.html").stat().st_size > 1000
