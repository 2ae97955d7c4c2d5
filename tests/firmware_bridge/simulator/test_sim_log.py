"""What a board's log holds, and that feeding it again does the same again."""

import io
import json
import random
import subprocess
import sys

import pytest
from lx_frames import Bus, move

from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.errors import ProtocolError, SimulatorFileError
from firmware_bridge.simulator.log import BoardLog, read_log
from firmware_bridge.simulator.make import DEFAULT_IDS, FAMILIES, Setup, firmware, replay_log
from firmware_bridge.simulator.wire import Wire, WireOptions

FAULTS = {
    "version": 1,
    "line": [
        {"kind": ["flip", "drop", "insert", "stale"], "rate": 0.2},
        {"kind": "delay", "way": "to_servo", "at_s": 0.5, "delay_s": 0.02},
    ],
    "devices": [
        {"kind": "brown-out", "id": 2, "at_s": 0.6, "for_s": 0.3},
        {"kind": "overheat", "id": 3, "at_s": 0.7},
    ],
}


def talk(wire, setup, seed, n_turns=60):
    """Move and read all servos at odd times, as a host would."""
    rng = random.Random(seed)
    speech = protocol(setup.protocol)
    low, high = speech.ticks
    asked = (Quantity.POSITION, Quantity.TARGET, Quantity.VOLTAGE)
    quantity = next(one for one in asked if one in speech.quantities)
    now_s = 0.0
    wire.advance(now_s)
    for frame in speech.torque(DEFAULT_IDS, True):
        wire.host_sent(frame, now_s)
    for _ in range(n_turns):
        targets = [ServoTarget(one, rng.randint(low, high), 2000) for one in DEFAULT_IDS]
        frames = list(speech.move(targets, rng.randint(20, 400)))
        frames += [query.frame for query in speech.query(quantity, DEFAULT_IDS)]
        frames += list(speech.stop(targets)) if rng.random() < 0.2 else []
        for frame in frames:
            wire.host_sent(frame, now_s)
        now_s += rng.uniform(0.005, 0.05)
        wire.advance(now_s)


def logged(setup, path, **options):
    made = setup.firmware()
    with path.open("w", encoding="utf-8") as stream:
        log = BoardLog(stream, made, setup.header())
        wire = Wire(made, WireOptions(**options), log)
        talk(wire, setup, setup.seed)
        log.end(wire.n_steps)
    return path


@pytest.mark.parametrize("name", sorted(FAMILIES))
@pytest.mark.parametrize("faults", [None, FAULTS])
def test_replay_executes_the_same_commands_at_the_same_times(tmp_path, name, faults):
    path = logged(Setup(name, seed=5, faults=faults), tmp_path / "log.jsonl")
    recorded, executed = replay_log(path)
    assert len(recorded) > 50
    assert executed == recorded


def test_replay_notices_a_log_that_was_changed(tmp_path):
    path = logged(Setup("sts", seed=5), tmp_path / "log.jsonl")
    lines = path.read_text().splitlines(keepends=True)
    moves = [n for n, line in enumerate(lines) if '"move"' in line and '"in"' in lines[n - 1]]
    at = moves[len(moves) // 2] - 1  # the bytes that completed a move
    path.write_text("".join(lines[:at] + lines[at + 1 :]))
    recorded, executed = replay_log(path)
    assert executed != recorded


def test_log_holds_every_byte_and_command_with_its_time():
    stream = io.StringIO()
    bus = Bus((1, 2))
    log = BoardLog(stream, bus, {"protocol": "lx16a"})
    wire = Wire(bus, WireOptions(), log)
    wire.advance(0.0)
    wire.host_sent(move(2, 700, 500), 0.1)
    wire.advance(0.2)
    wire.set_line_baud(9600)
    log.note(wire.n_steps, "unplugged")
    log.end(wire.n_steps)
    records = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert records[0] == {"version": 1, "protocol": "lx16a"}
    assert bytes.fromhex("".join(one.get("in", "") for one in records)) == move(2, 700, 500)
    done = [one for one in records if "do" in one]
    assert done == [{"t_s": 0.1, "servo": 2, "do": "move", "duration_s": 0.5, "ticks": 700.0}]
    assert records[-3:] == [
        {"t_s": 0.2, "baud": 9600},
        {"t_s": 0.2, "note": "unplugged"},
        {"t_s": 0.2, "end": True},
    ]


def test_log_cut_short_by_a_kill_is_read_up_to_there(tmp_path):
    path = logged(Setup("sts"), tmp_path / "log.jsonl")
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    recorded, executed = replay_log(path)
    assert recorded
    assert executed[: len(recorded)] == recorded


@pytest.mark.parametrize(
    "text",
    [
        "",
        "nonsense\n",
        "[]\n",
        '{"version": 2, "protocol": "sts"}\n',
        '{"version": 1}\n',
        '{"version": 1, "protocol": "sts"}\n{"in": "55"}\n',
        '{"version": 1, "protocol": "sts"}\n{"t_s": 1, "in": "5"}\n',
        '{"version": 1, "protocol": "sts"}\n{"t_s": "x", "in": "55"}\n',
    ],
)
def test_what_is_no_log_is_refused(tmp_path, text):
    path = tmp_path / "log.jsonl"
    path.write_text(text)
    with pytest.raises(SimulatorFileError, match=r"log\.jsonl"):
        read_log(path)


def test_log_of_an_unknown_protocol_makes_no_board(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_text('{"version": 1, "protocol": "morse"}\n')
    with pytest.raises(SimulatorFileError, match="morse"):
        replay_log(path)


@pytest.mark.parametrize("name", sorted(FAMILIES))
def test_every_protocol_has_a_firmware_at_its_own_baud(name):
    assert firmware(name).baud == protocol(name).baud


def test_unknown_protocol_is_refused_with_those_there_are():
    with pytest.raises(ProtocolError, match="lx16a"):
        firmware("morse")


def test_simulator_needs_nothing_but_the_standard_library():
    code = (
        "import sys; sys.modules.update(numpy=None, cv2=None, serial=None, tomli=None);"
        "from firmware_bridge.simulator.make import FAMILIES, Setup;"
        "[Setup(name).firmware().step(0.01) for name in FAMILIES]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
