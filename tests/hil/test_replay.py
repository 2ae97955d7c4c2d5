"""Replay: equal decisions from one recording, and a clear refusal of what cannot be used."""

import json
import math
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, List

import cv2
import numpy as np
import pytest

import apex_edge
from apex_edge.cli import main
from firmware_bridge.errors import NoSuchPort, PortBusy
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.ready import ReadyArm
from firmware_bridge.simulator import PtyBoard, RrcFirmware

RECORDING = Path(__file__).parents[2] / "examples" / "small-collision.mcap"
GOLDEN = Path(__file__).parents[2] / "examples" / "small-collision.decisions.jsonl"


def replay(source: Path, out: Path, *more: str) -> int:
    return main(["replay", str(source), "--out", str(out), *more])


def flat(value: Any, at: str = "") -> List[Any]:
    """List every leaf of a JSON value with its path."""
    if isinstance(value, dict):
        return [leaf for key in sorted(value) for leaf in flat(value[key], f"{at}.{key}")]
    if isinstance(value, list):
        return [leaf for i, item in enumerate(value) for leaf in flat(item, f"{at}[{i}]")]
    return [(at, value)]


def test_two_replays_give_the_same_bytes_and_the_reviewed_decisions(tmp_path: Path) -> None:
    outs = [tmp_path / "a", tmp_path / "b"]
    assert [replay(RECORDING, out) for out in outs] == [0, 0]
    first, second = ((out / "decisions.jsonl").read_bytes() for out in outs)
    assert first == second
    lines, golden = first.decode().splitlines(), GOLDEN.read_text().splitlines()
    assert len(lines) == len(golden)
    for line, wanted in zip(lines, golden):
        for (path, value), (wanted_path, wanted_value) in zip(
            flat(json.loads(line)), flat(json.loads(wanted))
        ):
            assert path == wanted_path
            if isinstance(wanted_value, float):
                assert math.isclose(value, wanted_value, rel_tol=1e-6, abs_tol=1e-6), path
            else:
                assert value == wanted_value, path


def test_the_replayed_arm_intervenes(tmp_path: Path) -> None:
    assert replay(RECORDING, tmp_path / "out", "--json") == 0
    actions = [
        json.loads(line)["decision"]["action"]
        for line in (tmp_path / "out" / "decisions.jsonl").read_text().splitlines()
    ]
    assert "intervene" in actions


def test_a_video_needs_its_colours(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    video = tmp_path / "clip.avi"
    write_video(video)
    assert replay(video, tmp_path / "out") == 2
    assert "--colours" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_video_without_the_configured_colours_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    video = tmp_path / "clip.avi"
    write_video(video)
    colours = taught(tmp_path, "green", (40, 180, 60))
    assert replay(video, tmp_path / "out", "--colours", str(colours)) == 2
    assert "none of the configured colours (green)" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_truncated_recording_is_refused_with_what_could_be_read(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    cut = tmp_path / "cut.mcap"
    data = RECORDING.read_bytes()
    cut.write_bytes(data[: len(data) // 2])
    assert replay(cut, tmp_path / "out") == 2
    assert "frame" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*.jsonl"))


@pytest.mark.parametrize("content", [b"", b"this is no video"])
def test_an_unreadable_video_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture, content: bytes
) -> None:
    video = tmp_path / "clip.mp4"
    video.write_bytes(content)
    colours = taught(tmp_path, "green", (40, 180, 60))
    assert replay(video, tmp_path / "out", "--colours", str(colours)) == 2
    assert "clip.mp4" in capsys.readouterr().err
    assert not list((tmp_path / "out").glob("*"))


def test_an_unknown_setting_names_the_nearest(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    settings = tmp_path / "apex.toml"
    settings.write_text("[decide]\nmargin = 0.2\n")
    assert replay(RECORDING, tmp_path / "out", "--config", str(settings)) == 2
    assert "margin_s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ('[camera]\ntype = "video"\npath = "x.mp4"\n[arm]\nport = "/dev/ttyS0"\n', "live camera"),
        ('[camera]\ntype = "live"\n[arm]\nport = "/dev/ttyS0"\n', "your own colours"),
        ('[camera]\ntype = "live"\n[arm]\nport = "sim"\n', "twin"),
        ('[camera]\ntype = "twin"\n[arm]\nport = "/dev/ttyS0"\n', "cannot see the arm"),
        ('[agent]\nprotected = ["crimson"]\n', "crimson"),
    ],
)
def test_run_refuses_settings_with_which_an_arm_would_move_wrongly_or_never(
    tmp_path: Path, capsys: pytest.CaptureFixture, settings: str, reason: str
) -> None:
    path = tmp_path / "apex.toml"
    path.write_text(settings)
    assert main(["run", "--config", str(path)]) == 2
    assert reason in capsys.readouterr().err


def test_a_port_that_is_not_there_is_refused_with_what_there_is() -> None:
    with pytest.raises(NoSuchPort, match="ports found"), ReadyArm(
        ArmModel.load(), "/dev/ttyNOPE9", time.monotonic
    ):
        pass


def test_a_port_in_use_is_refused() -> None:
    arm = ArmModel.load()
    board = PtyBoard(RrcFirmware(arm))
    first = SerialLink(board.port)
    first.open()
    try:
        with pytest.raises(PortBusy), ReadyArm(arm, board.port, time.monotonic):
            pass
    finally:
        first.close()
        board.close()


def test_weights_with_a_wrong_hash_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    shipped = Path(apex_edge.__file__).parent / "data" / "trigger-linear.json"
    fields = json.loads(shipped.read_text())
    fields["bias"] = fields["bias"] + 0.1
    weights, settings = tmp_path / "weights.json", tmp_path / "apex.toml"
    weights.write_text(json.dumps(fields))
    settings.write_text(f'[trigger]\nweights = "{weights}"\n')
    assert replay(RECORDING, tmp_path / "out", "--config", str(settings)) == 2
    assert "weights.json" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_record_and_replay_a_scene_of_the_twin(tmp_path: Path) -> None:
    recording = tmp_path / "scene.mcap"
    made = ["record", "--camera", "twin", "--path", "no-moving:1", "--seconds", "1"]
    assert main([*made, "--out", str(recording)]) == 0
    assert replay(recording, tmp_path / "out") == 0
    assert (tmp_path / "out" / "tracks.csv").read_text().count("\n") > 5


def test_replay_runs_from_the_shell(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "apex_edge.cli", "replay", str(tmp_path / "no.mcap")]
    done = subprocess.run(
        [*command, "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "no.mcap" in done.stderr
    assert "Traceback" not in done.stderr


def write_video(path: Path) -> None:
    """Write a second of a white disc on grey: nothing coloured in it."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (160, 120))
    assert writer.isOpened()
    for i in range(15):
        picture = np.full((120, 160, 3), 110, dtype=np.uint8)
        cv2.circle(picture, (20 + 8 * i, 60), 8, (240, 240, 240), -1)
        writer.write(picture)
    writer.release()


def taught(folder: Path, name: str, bgr: "tuple") -> Path:
    """Teach a colour from a drawn picture."""
    picture = np.full((120, 160, 3), 110, dtype=np.uint8)
    cv2.circle(picture, (80, 60), 20, bgr, -1)
    image, colours = folder / "taught.png", folder / "colours.json"
    assert cv2.imwrite(str(image), picture)
    sample = f"{name}:80,60,15"
    made = ["calibrate", "colour", "--image", str(image), "--sample", sample]
    assert main([*made, "--out", str(colours)]) == 0
    return colours
