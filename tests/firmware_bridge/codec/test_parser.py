"""The parser loses no intact frame, whatever stands around it."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import lx
from firmware_bridge.codec.parser import IMPOSSIBLE, NEEDS_MORE, Parser
from firmware_bridge.simulator.damage import DAMAGE
from offline_train.benchmarks.firmware.kit import framed_kits
from offline_train.benchmarks.firmware.resync import damaged_stream, n_missing
from offline_train.benchmarks.firmware.vectors import is_same_in_chunks

KITS = framed_kits()
NAMES = [kit.name for kit in KITS]
kits = pytest.mark.parametrize("kit", KITS, ids=NAMES)


def delivered(parser, data):
    return parser.feed(data) + parser.flush()


def toy_measure(buffer, start):
    """Length byte behind the header; frames of up to 20 bytes."""
    if len(buffer) - start < 3:
        return NEEDS_MORE
    return buffer[start + 2] if 4 <= buffer[start + 2] <= 20 else IMPOSSIBLE


def toy_check(frame):
    return sum(frame[2:]) & 0xFF == 0


def toy(body):
    """Make a frame whose bytes behind the header add up to 0."""
    inside = bytes((len(body) + 4,)) + body
    return b"\xaa\x55" + inside + bytes((-sum(inside) & 0xFF,))


def toy_parser():
    return Parser(b"\xaa\x55", toy_measure, toy_check)


@kits
@pytest.mark.parametrize("kind", sorted(DAMAGE))
def test_every_intact_frame_between_damaged_ones_is_delivered(kit, kind):
    rng = random.Random(kind)
    frames = [kit.random_reply(rng) for _ in range(400)]
    stream, intact = damaged_stream(frames, kind, rng)
    assert len(intact) < 400
    assert n_missing(intact, delivered(kit.host_parser(), stream)) == 0


@kits
@given(seed=st.integers(0, 10**9))
def test_any_chunks_give_the_same_frames(kit, seed):
    assert is_same_in_chunks(kit, random.Random(seed))


@kits
@given(before=st.binary(max_size=40), seed=st.integers(0, 10**9), after=st.binary(max_size=40))
def test_an_intact_frame_is_delivered_whatever_stands_around_it(kit, before, seed, after):
    frame = kit.random_reply(random.Random(seed))
    assert frame in delivered(kit.host_parser(), before + frame + after)


@kits
@given(seed=st.integers(0, 10**9), cut=st.integers(1, 60))
def test_a_frame_behind_a_cut_one_is_delivered(kit, seed, cut):
    rng = random.Random(seed)
    first, second, third = (kit.random_reply(rng) for _ in range(3))
    got = delivered(kit.host_parser(), first[: min(cut, len(first) - 1)] + second + third)
    assert n_missing([second, third], got) == 0


def test_a_cut_frame_that_passes_its_checksum_hides_nothing():
    # the length of the cut frame reaches two bytes into the intact one and the sum happens to fit
    intact = lx.encode_reply(lx.Message(5, lx.POS_READ, (300,)))
    for value in range(256):
        cut = b"\x55\x55\x01\x05\x1c" + bytes((value,))
        if sum(cut[2:] + intact[:2]) & 0xFF == 0xFF:
            break
    got = delivered(lx.host_parser(), cut + intact + intact)
    assert got[0] == cut + intact[:2]  # well formed, and nobody can tell
    assert got[1:] == [intact, intact]


def test_a_cut_frame_that_ends_where_a_header_seems_to_stand_hides_nothing():
    # servo 0x55: behind the first 0x55 of its frame, "55 55" looks like the header of another
    intact = lx.encode_reply(lx.Message(0x55, lx.TEMP_READ, (35,)))
    cut = b"\x55\x55\x01\x05\x1c\x88\x00"
    assert sum(cut[2:] + intact[:1]) & 0xFF == 0xFF
    assert delivered(lx.host_parser(), cut + intact)[-1] == intact


def test_a_whole_frame_inside_a_longer_one_is_delivered_beside_it():
    inner = toy(b"\x01\x02")
    outer = toy(b"\x07" + inner + b"\x08")
    assert delivered(toy_parser(), outer) == [outer, inner]


def test_frames_without_a_header_follow_one_another():
    parser = Parser(b"", lambda buffer, start: 2 if len(buffer) - start >= 2 else NEEDS_MORE, bool)
    assert parser.feed(b"\x01\x02\x03") == [b"\x01\x02"]
    assert parser.feed(b"\x04") == [b"\x03\x04"]
    assert parser.n_held == 0


@given(st.lists(st.binary(max_size=60), max_size=30))
def test_less_than_one_frame_is_held_back_and_every_byte_is_counted(chunks):
    parser = toy_parser()
    frames = []
    for chunk in chunks:
        frames += parser.feed(chunk)
        assert parser.n_held < 20
    frames += parser.flush()
    assert parser.n_held == 0
    n_bytes = sum(map(len, chunks))
    assert parser.n_frames == len(frames)
    if not frames:
        assert parser.n_skipped == n_bytes


def test_what_went_by_is_counted():
    good, bad = toy(b"\x01\x02"), bytearray(toy(b"\x03\x04"))
    bad[-1] ^= 1
    parser = toy_parser()
    parser.feed(b"noise" + bytes(bad) + good + b"x")
    assert (parser.n_frames, parser.n_bad, parser.n_skipped) == (1, 1, 5 + len(bad) + 1)


def test_silence_frees_what_stands_behind_an_unfinished_frame():
    parser = toy_parser()
    whole = toy(b"\x01")
    assert parser.feed(b"\xaa\x55\x14" + whole) == []
    assert parser.flush() == [whole]
