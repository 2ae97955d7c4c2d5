"""Each fault of a script does what its name says, at its time, and the same for the same seed."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lx_frames import ask, faulty, move, positions, question, run

from firmware_bridge.codec.protocol import ServoFlag
from firmware_bridge.errors import LinkLost, NoSuchPort, SimulatorFileError
from firmware_bridge.simulator.cutter import SHAPES, Cutter
from firmware_bridge.simulator.damage import DAMAGE
from firmware_bridge.simulator.direct_link import DirectLink
from firmware_bridge.simulator.faults import load_script, parse_script

CLEAN = {1: question(faulty(), 1), 2: question(faulty(), 2)}


def servo(firmware, servo_id):
    return next(one for one in firmware.servos if one.servo_id == servo_id)


@pytest.mark.parametrize("kind", sorted(DAMAGE))
def test_damage_to_the_host_changes_every_answer_it_strikes(kind):
    firmware = faulty([{"kind": kind, "way": "to_host", "rate": 1.0}])
    for _ in range(20):
        assert question(firmware, 1) != CLEAN[1]
    assert firmware.n_struck == (0, 20)


def test_damage_to_the_servo_keeps_it_from_moving():
    firmware = faulty([{"kind": "flip", "way": "to_servo", "rate": 1.0}])
    firmware.feed(move(1, 900, 100))
    run(firmware, 0.5)
    assert servo(firmware, 1).measured == 100
    assert firmware.n_struck == (1, 0)


def test_rate_is_the_share_of_frames():
    firmware = faulty([{"kind": ["flip", "drop"], "way": "to_host", "rate": 0.1}])
    n_bad = sum(question(firmware, 1) != CLEAN[1] for _ in range(2000))
    assert n_bad == firmware.n_struck[1]
    assert 150 < n_bad < 250


def test_faults_strike_within_their_time_only():
    firmware = faulty([{"kind": "lose", "rate": 1.0, "from_s": 1.0, "until_s": 2.0}])
    found = []
    for _ in range(3):
        found.append(question(firmware, 1) == CLEAN[1])
        firmware.step(1.0)
    assert found == [True, False, True]


def test_fault_at_a_time_strikes_one_frame():
    firmware = faulty([{"kind": "lose", "way": "to_host", "at_s": 0.5}])
    found = []
    for _ in range(4):
        found.append(question(firmware, 1) == CLEAN[1])
        firmware.step(0.4)
    assert found == [True, True, False, True]


def test_frames_are_struck_whatever_the_chunks():
    def all_bytes(chunk):
        firmware = faulty([{"kind": ["flip", "insert", "drop"], "rate": 0.5}], seed=3)
        sent = ask(1) * 40
        out = b""
        for at in range(0, len(sent), chunk):
            firmware.feed(sent[at : at + chunk])
            out += firmware.replies()
        return out

    assert all_bytes(1) == all_bytes(7) == all_bytes(1000)


def test_stale_answer_is_an_older_one_of_another_servo():
    firmware = faulty([{"kind": "stale", "way": "to_host", "at_s": 1.0}])
    question(firmware, 2)
    question(firmware, 1)
    firmware.step(1.0)
    assert question(firmware, 1) == CLEAN[2]
    assert question(firmware, 1) == CLEAN[1]


def test_delayed_answer_comes_late_and_holds_up_those_behind_it():
    firmware = faulty([{"kind": "delay", "way": "to_host", "at_s": 0.0, "delay_s": 0.05}])
    assert question(firmware, 1, 0.04) == b""
    assert question(firmware, 2) == b""
    assert question(firmware, 3, 0.02)[:16] == CLEAN[1] + CLEAN[2]


def test_delayed_command_is_executed_late():
    firmware = faulty([{"kind": "delay", "way": "to_servo", "at_s": 0.0, "delay_s": 0.5}])
    firmware.feed(move(1, 900, 0))
    run(firmware, 0.45)
    assert servo(firmware, 1).measured == 100
    run(firmware, 0.1)
    assert servo(firmware, 1).measured > 100


def test_reordered_answer_comes_behind_the_next():
    firmware = faulty([{"kind": "reorder", "way": "to_host", "at_s": 0.0}])
    assert question(firmware, 1) == b""
    assert question(firmware, 2) == CLEAN[2] + CLEAN[1]


def test_reordered_answer_comes_alone_when_there_is_no_next():
    firmware = faulty([{"kind": "reorder", "way": "to_host", "at_s": 0.0}])
    assert question(firmware, 1, 0.015) == b""
    run(firmware, 0.01)
    assert firmware.replies() == CLEAN[1]


def test_half_a_frame_reaches_the_servo_when_the_line_falls_silent():
    firmware = faulty([{"kind": "lose", "way": "to_servo", "at_s": 5.0}])
    firmware.feed(ask(1)[:3])
    firmware.step(0.1)
    firmware.feed(ask(1)[3:])
    firmware.step(0.1)
    assert firmware.replies() == CLEAN[1]


def test_same_seed_gives_the_same_damage():
    def all_bytes(seed):
        firmware = faulty([{"kind": ["flip", "garbage"], "rate": 0.5}], seed=seed)
        return [question(firmware, 1, 0.002) for _ in range(50)]

    assert all_bytes(1) == all_bytes(1) != all_bytes(2)


def test_stuck_servo_stays_until_the_fault_is_over_and_reports_a_stall():
    firmware = faulty(devices=[{"kind": "stuck", "id": 2, "at_s": 0.1, "for_s": 1.0}])
    run(firmware, 0.2)
    for servo_id in (1, 2):
        firmware.feed(move(servo_id, 500, 100))
    run(firmware, 0.6)
    assert servo(firmware, 1).measured == 500
    assert servo(firmware, 2).measured == 200
    assert servo(firmware, 2).flags & ServoFlag.STALL
    run(firmware, 1.0)
    assert servo(firmware, 2).measured == 500
    assert servo(firmware, 2).flags == ServoFlag.NONE


def test_overheated_servo_is_limp_and_says_so():
    firmware = faulty(devices=[{"kind": "overheat", "id": 1, "at_s": 0.1, "for_s": 1.0}])
    run(firmware, 0.2)
    assert servo(firmware, 1).flags & ServoFlag.OVERHEAT
    assert not servo(firmware, 1).is_torque_on
    assert servo(firmware, 2).is_torque_on
    run(firmware, 1.0)
    assert servo(firmware, 1).flags == ServoFlag.NONE


def test_brown_out_resets_every_servo_for_a_while():
    firmware = faulty(devices=[{"kind": "brown-out", "at_s": 0.1, "for_s": 0.5}])
    run(firmware, 0.2)
    assert [question(firmware, one) for one in (1, 2, 3)] == [b"", b"", b""]
    run(firmware, 0.5)
    assert question(firmware, 1) == CLEAN[1]
    assert [one.n_resets for one in firmware.servos] == [1, 1, 1]
    assert not any(one.is_torque_on for one in firmware.servos)


def test_dead_servo_is_silent_and_the_others_are_not():
    firmware = faulty(devices=[{"kind": "dead", "id": 1, "at_s": 0.0}])
    assert question(firmware, 1) == b""
    assert question(firmware, 2) == CLEAN[2]


def test_servos_of_the_same_id_talk_over_each_other():
    firmware = faulty(devices=[{"kind": "id-clash", "id": 2, "with": 1, "at_s": 0.1, "for_s": 1.0}])
    run(firmware, 0.2)
    garbled = question(firmware, 1)
    assert len(garbled) == len(CLEAN[1])
    assert positions(garbled) == []
    assert question(firmware, 2) == b""
    run(firmware, 1.0)
    assert question(firmware, 2) == CLEAN[2]


def test_servo_at_another_baud_answers_at_that_one_only():
    firmware = faulty(devices=[{"kind": "wrong-baud", "id": 2, "baud": 9600, "at_s": 0.0}])
    assert firmware.listen(115200)
    assert question(firmware, 2) == b""
    assert question(firmware, 1) == CLEAN[1]
    assert firmware.listen(9600)
    assert question(firmware, 2) == CLEAN[2]
    assert question(firmware, 1) == b""
    assert not firmware.listen(57600)


def test_nothing_passes_while_the_plug_is_out():
    firmware = faulty(devices=[{"kind": "unplug", "at_s": 0.1, "for_s": 0.2}])
    run(firmware, 0.15)
    assert not firmware.is_plugged
    assert question(firmware, 1, 0.05) == b""
    run(firmware, 0.2)
    assert firmware.is_plugged
    assert question(firmware, 1) == CLEAN[1]


BAD = [
    ([], "expected an object"),
    ({}, "version is None"),
    ({"version": 2}, "version is 2"),
    ({"version": True}, "version is True"),
    ({"version": 1, "lines": []}, "unknown key 'lines'"),
    ({"version": 1, "line": {}}, "expected a list"),
    ({"version": 1, "line": [{"kind": "smash", "rate": 1}]}, "expected one of"),
    ({"version": 1, "line": [{"kind": [], "rate": 1}]}, "expected one of"),
    ({"version": 1, "line": [{"kind": "flip"}]}, "either rate or at_s"),
    ({"version": 1, "line": [{"kind": "flip", "rate": 0.1, "at_s": 1}]}, "either rate or at_s"),
    ({"version": 1, "line": [{"kind": "flip", "rate": 1.5}]}, "0..1"),
    ({"version": 1, "line": [{"kind": "flip", "rate": "0.1"}]}, "expected a number"),
    ({"version": 1, "line": [{"kind": "flip", "rate": float("nan")}]}, "expected a number"),
    ({"version": 1, "line": [{"kind": "flip", "rate": 1, "way": "up"}]}, "expected one of"),
    ({"version": 1, "line": [{"kind": "flip", "rate": 1, "id": 3}]}, "unknown key 'id'"),
    ({"version": 1, "devices": [{"kind": "stuck"}]}, "needs at_s"),
    ({"version": 1, "devices": [{"kind": "stuck", "at_s": 1, "id": 1.5}]}, "whole number"),
    ({"version": 1, "devices": [{"kind": "stuck", "at_s": 1, "id": 300}]}, "1..253"),
    ({"version": 1, "devices": [{"kind": "stuck", "at_s": 1, "baud": 9600}]}, "has no baud"),
    ({"version": 1, "devices": [{"kind": "unplug", "at_s": 1, "id": 2}]}, "has no id"),
    ({"version": 1, "devices": [{"kind": "id-clash", "at_s": 1, "id": 2}]}, "needs with"),
]


@pytest.mark.parametrize(("found", "message"), BAD)
def test_bad_script_is_refused_with_its_reason(found, message):
    with pytest.raises(SimulatorFileError, match=message):
        parse_script(found)


def test_script_file_is_read_or_refused_by_name(tmp_path):
    path = tmp_path / "faults.json"
    path.write_text(json.dumps({"version": 1, "line": [{"kind": "flip", "rate": 0.1}]}))
    assert load_script(path).line[0].ways == ("to_servo", "to_host")
    path.write_text("{")
    with pytest.raises(SimulatorFileError, match="faults.json"):
        load_script(path)
    with pytest.raises(SimulatorFileError, match="missing.json"):
        load_script(tmp_path / "missing.json")


def test_fault_of_a_servo_that_is_not_there_is_refused():
    with pytest.raises(SimulatorFileError, match="no servo has id 9; there are: 1, 2, 3"):
        faulty(devices=[{"kind": "dead", "id": 9, "at_s": 0.0}])


FRAMES = {
    "lx16a": "55 55 01 07 01 F4 01 E8 03 16",
    "lsc": "55 55 08 03 01 E8 03 01 F4 01",
    "rrc": "AA 55 04 07 01 F4 01 01 01 DC 05 22",
    "sts": "FF FF 01 05 03 2A 00 08 C4",
    "dxl2": "FF FF FD 00 01 09 00 03 74 00 00 08 00 00 42 89",
}


@pytest.mark.parametrize("protocol", sorted(FRAMES))
@pytest.mark.parametrize("chunk", [1, 3, 100])
def test_cutter_finds_frames_and_loses_no_byte(protocol, chunk):
    one = bytes.fromhex(FRAMES[protocol])
    stream = one + b"\x01\x02" + one + one + b"\x03" + one[:4]
    cutter = Cutter(SHAPES[protocol])
    pieces = []
    for at in range(0, len(stream), chunk):
        pieces += cutter.feed(stream[at : at + chunk])
    assert pieces.count(one) == 3
    assert b"".join(pieces) + cutter.flush() == stream


def test_direct_link_is_lost_with_the_plug_and_opens_again_later():
    firmware = faulty(devices=[{"kind": "unplug", "at_s": 0.1, "for_s": 0.2}])
    link = DirectLink(firmware)
    link.open()
    link.wait_readable(0.05)
    with pytest.raises(LinkLost):
        for _ in range(100):
            link.wait_readable(0.01)
    with pytest.raises(NoSuchPort):
        link.open()
    run(firmware, 0.3)
    link.open()
    link.write(ask(1))
    assert positions(link.read_available()) == [(1, 100)]


@given(
    protocol=st.sampled_from(sorted(SHAPES)),
    stream=st.lists(st.sampled_from([0x55, 0xAA, 0xFF, 0xFD, 0x00, 0x03, 0x07]), max_size=80),
    chunk=st.integers(1, 20),
)
def test_cutting_is_the_same_for_any_chunks_and_loses_nothing(protocol, stream, chunk):
    whole = Cutter(SHAPES[protocol])
    expected = whole.feed(bytes(stream))
    cutter, pieces = Cutter(SHAPES[protocol]), []
    for at in range(0, len(stream), chunk):
        pieces += cutter.feed(bytes(stream[at : at + chunk]))
    assert b"".join(pieces) + cutter.flush() == bytes(stream)
    frames = [one for one in expected if one.startswith(SHAPES[protocol].header)]
    assert [one for one in pieces if one.startswith(SHAPES[protocol].header)] == frames
