import pytest

from firmware_bridge.codec import sts
from offline_train.benchmarks.firmware import corruption
from offline_train.benchmarks.firmware.kit import kit
from offline_train.benchmarks.lines import are_all_ok


def test_every_short_change_is_made_exactly_once():
    frame = bytes(10)
    singles = list(corruption.single_bits(frame))
    bursts = list(corruption.bursts(frame))
    pairs = list(corruption.two_bits(frame))
    assert [len(one) for one in (singles, bursts, pairs)] == [80, 9391, 3160]
    assert len({*singles, *bursts}) == 80 + 9391
    assert len(set(pairs)) == 3160


def test_what_a_plain_reader_lets_pass_is_what_is_known():
    lines = corruption.plain_lines()
    assert len(lines) == 5
    assert are_all_ok(lines)


@pytest.mark.parametrize("name", ["sts", "dxl2"])
def test_no_single_damaged_bit_moves_a_checked_servo(name):
    lines = [line for line in corruption.measure(0.002, 1) if f"{name}: " in line.what]
    assert len(lines) >= 5
    assert are_all_ok(lines)


def test_a_frame_that_is_executed_is_noticed_each_time():
    under = kit("sts")
    good = sts.encode(sts.Write(1, 42, (2000).to_bytes(2, "little")))
    with corruption.Progress("frames", 3, is_quiet=True) as progress:
        found = corruption.count(under, [good, good, good[:-1] + b"\x00"], progress)
    assert found == (3, 2, 2)
