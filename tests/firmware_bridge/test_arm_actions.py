"""``apex arm`` over real bytes: what each action prints, moves and refuses."""

import json

import pytest

from apex_edge.cli import main
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.simulator.make import Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving
from firmware_bridge.verbs.common import listening

ARMS = {"sts": "so-101", "lx16a": "lx16a-arm", "rrc": "armpi-mini", "lsc": "xarm-1s"}


@pytest.fixture
def plugged(tmp_path):
    """Return a function that plugs in an arm and returns its board and the words to reach it."""
    open_boards = []

    def plug(protocol, faults=None):
        setup = Setup(protocol, arm=ARMS[protocol], faults=faults, is_plain=True)
        # unpaced: what is said counts here, not how long the wire takes
        board = PtyBoard(setup.firmware(), tmp_path / "arm", setup.wire(is_paced=False))
        context = serving(board)
        context.__enter__()
        open_boards.append(context)
        return board, ["--arm", ARMS[protocol], "--port", board.port]

    yield plug
    for context in open_boards:
        context.__exit__(None, None, None)


def servo(board, servo_id):
    return next(one for one in board.firmware.servos if one.servo_id == servo_id)


@pytest.mark.parametrize("protocol", sorted(ARMS))
def test_ping_finds_every_servo_and_moves_none(plugged, capsys, protocol):
    board, words = plugged(protocol)
    before = [one.actual for one in board.firmware.servos]
    assert main(["arm", "ping", *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["troubles"] == [] and all(one["is_there"] for one in found["servos"])
    assert [one.actual for one in board.firmware.servos] == before


def test_ping_names_a_dead_servo_and_fails(plugged, capsys):
    dead = {"version": 1, "devices": [{"kind": "dead", "at_s": 0.0, "id": 3}]}
    _, words = plugged("sts", dead)
    assert main(["arm", "ping", *words]) == 1
    out = capsys.readouterr().out
    assert "trouble: " in out and "elbow_flex (id 3)" in out


def test_ping_writes_the_limits_of_the_file(plugged, capsys):
    board, words = plugged("sts")
    assert main(["arm", "ping", *words, "--write-limits", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["notes"] == []
    assert board.firmware.member(1).get("min_position") > 0


@pytest.mark.parametrize("protocol", sorted(ARMS))
def test_read_tells_the_pose_in_radians(plugged, capsys, protocol):
    _, words = plugged(protocol)
    assert main(["arm", "read", *words, "--json"]) == 0
    state = json.loads(capsys.readouterr().out)
    assert state["source"] == ("commanded" if protocol == "rrc" else "measured")
    assert None not in state["joints_rad"] and state["missing_ids"] == []


@pytest.mark.parametrize(
    ("protocol", "joint", "servo_id"), [("sts", "shoulder_pan", 1), ("rrc", "yaw", 6)]
)
def test_jog_turns_one_joint_and_leaves_the_others(plugged, protocol, joint, servo_id):
    board, words = plugged(protocol)
    before = {one.servo_id: one.actual for one in board.firmware.servos}
    assert main(["arm", "jog", *words, joint, "3"]) == 0
    moved = {i for i in before if abs(servo(board, i).actual - before[i]) > 3.0}
    assert moved - {1 if protocol == "rrc" else 6} == {servo_id}  # the gripper may close


def test_move_to_a_place_out_of_reach_moves_nothing(plugged, capsys):
    board, words = plugged("sts")
    before = [one.actual for one in board.firmware.servos]
    assert main(["arm", "move", *words, "--tip", "2,0,0.1"]) == 2
    assert "cannot reach" in capsys.readouterr().err
    assert [one.actual for one in board.firmware.servos] == before


def test_move_below_the_table_is_refused_and_moves_nothing(plugged, capsys):
    board, words = plugged("sts")
    before = [one.target for one in board.firmware.servos]
    assert main(["arm", "move", *words, "--joints", "shoulder_lift=95"]) == 2
    assert "way-point 0" in capsys.readouterr().err
    after = [one.target for one in board.firmware.servos]
    assert after == pytest.approx(before, abs=2.0)


def test_dry_run_prints_bytes_and_needs_no_port(capsys):
    assert main(["arm", "jog", "--arm", "so-101", "--dry-run", "shoulder_pan", "2"]) == 0
    out = capsys.readouterr().out
    assert "ff ff fe" in out and "measured: shoulder_pan" in out


def test_torque_goes_off_and_comes_back_where_the_servo_stands(plugged):
    board, words = plugged("sts")
    assert main(["arm", "torque", *words, "off"]) == 0
    assert not any(one.is_torque_on for one in board.firmware.servos)
    pan = servo(board, 1)
    pan.actual += 200.0  # turned by hand
    by_hand = pan.actual
    assert main(["arm", "torque", *words, "on"]) == 0
    assert all(one.is_torque_on for one in board.firmware.servos)
    assert pan.target == pytest.approx(by_hand, abs=2.0)


def test_estop_stops_a_servo_on_its_way(plugged):
    board, words = plugged("lx16a")
    options = type("Options", (), {"arm": "lx16a-arm", "port": board.port})
    with listening(options) as servos:
        servos.bus.move([ServoTarget(6, 900)], 20_000, is_verified=False)
        servos.bus.read(Quantity.POSITION, (6,))
    assert main(["arm", "estop", *words]) == 0
    one = servo(board, 6)
    assert abs(one.target - one.actual) < 2.0 and one.target < 880.0


def test_several_ports_or_none_ask_for_one(monkeypatch, capsys):
    monkeypatch.setattr("firmware_bridge.verbs.common.ports", lambda: [])
    assert main(["arm", "read", "--arm", "so-101"]) == 2
    assert "name a --port; ports found: none" in capsys.readouterr().err


@pytest.mark.parametrize("words", [["yaw", "3"], ["shoulder_pan", "40"], ["shoulder_pan", "nan"]])
def test_jog_refuses_unknown_joints_and_long_ways_before_it_opens_a_port(words, capsys):
    assert main(["arm", "jog", "--arm", "so-101", "--port", "/dev/null", *words]) == 2
    assert "apex: " in capsys.readouterr().err
