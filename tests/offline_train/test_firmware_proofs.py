"""The proofs of codecs and parser hold in small, and notice what is wrong."""

import random

import pytest

from offline_train.benchmarks.firmware import fuzz, parser_speed, resync, vectors
from offline_train.benchmarks.firmware.byte_machine import FRAMINGS, ByteMachine
from offline_train.benchmarks.firmware.kit import framed_kits, kit
from offline_train.benchmarks.lines import are_all_ok


@pytest.mark.parametrize("module", [vectors, fuzz, resync])
def test_every_promise_is_kept_in_small(module):
    lines = module.measure(0.001, 7)
    assert are_all_ok(lines), [line for line in lines if line.is_ok is False]


def test_a_wrong_byte_is_noticed():
    good = kit("lx16a")
    wrong = good.vectors()[0]._replace(expected=b"\x00")
    lines = vectors._of(good._replace(vectors=lambda: [wrong]), 1, random.Random(1))
    assert [line.is_ok for line in lines if "published" in line.what] == [False]


def test_an_intact_frame_that_does_not_come_is_noticed():
    frames = [b"a", b"b", b"c"]
    assert resync.n_missing(frames, [b"a", b"x", b"b", b"c"]) == 0
    assert resync.n_missing(frames, [b"a", b"c"]) == 1
    assert resync.n_missing(frames, [b"c", b"b", b"a"]) > 0


def test_speed_is_told_for_every_protocol_and_beside_a_byte_machine():
    lines = parser_speed.measure(0.001, 7)
    assert len(lines) == 2 * len(framed_kits())
    assert all(line.figures["value"] > 0.0 for line in lines)


@pytest.mark.parametrize("name", sorted(FRAMINGS))
def test_byte_machine_reads_undamaged_streams_and_swallows_what_a_bad_length_covers(name):
    one = kit(name)
    parser = one.device_parser()
    machine = ByteMachine(parser.header, FRAMINGS[name], parser.check)
    assert machine.feed(one.move_frame * 5) == [one.move_frame] * 5
    bad = bytearray(one.move_frame)
    bad[FRAMINGS[name].length_at] = 60
    stream = bytes(bad) + one.move_frame * 12
    assert 0 < len(machine.feed(stream)) < 12
    assert len(parser.feed(stream)) == 12
