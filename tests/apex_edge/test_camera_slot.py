import threading

import numpy as np
import pytest

from apex_edge.cameras.base import NewestSlot, is_stale
from apex_edge.types import Frame


def frame(seq, t_s=0.0, is_repeated=False):
    return Frame(seq, t_s, np.zeros((2, 2, 3), np.uint8), is_repeated=is_repeated)


def test_newest_frame_wins_and_the_older_counts_as_dropped():
    slot = NewestSlot()
    for seq in range(4):
        slot.put(frame(seq))
    assert slot.get(0.0).seq == 3
    assert (slot.stats.grabbed, slot.stats.delivered, slot.stats.dropped) == (4, 1, 3)


def test_a_frame_is_never_delivered_twice():
    slot = NewestSlot()
    slot.put(frame(0))
    assert slot.get(0.0).seq == 0
    assert slot.get(0.0) is None
    assert slot.stats.delivered == 1


def test_waiting_reader_gets_the_frame_that_comes():
    slot = NewestSlot()
    threading.Timer(0.02, slot.put, [frame(7)]).start()
    assert slot.get(10.0).seq == 7


def test_close_wakes_a_waiting_reader_at_once():
    slot = NewestSlot()
    threading.Timer(0.02, slot.close).start()
    assert slot.get(30.0) is None
    assert slot.is_closed


def test_unread_frame_survives_close_and_later_ones_do_not_count():
    slot = NewestSlot()
    slot.put(frame(1))
    slot.close()
    slot.put(frame(2))
    assert slot.get(0.0).seq == 1
    assert slot.get(0.0) is None
    assert slot.stats.grabbed == 1


def test_repeated_frames_are_counted():
    slot = NewestSlot()
    slot.put(frame(0))
    slot.put(frame(1, is_repeated=True))
    assert slot.stats.repeated == 1


def test_stale_frame_is_counted_and_not_delivered():
    slot = NewestSlot(max_age_s=0.1, clock=lambda: 5.0)
    slot.put(frame(0, t_s=4.8))
    assert slot.get(0.0) is None
    slot.put(frame(1, t_s=4.95))
    assert slot.get(0.0).seq == 1
    assert (slot.stats.stale, slot.stats.delivered, slot.stats.dropped) == (1, 1, 0)


@pytest.mark.parametrize("t_s, expected", [(4.95, False), (4.8, True), (float("nan"), True)])
def test_staleness_goes_by_capture_time(t_s, expected):
    assert is_stale(frame(0, t_s), 5.0, 0.1) is expected


def test_many_frames_through_two_threads_keep_order_and_add_up():
    slot = NewestSlot()
    seen = []

    def read_all():
        while True:
            got = slot.get(30.0)
            if got is None:
                return
            seen.append(got.seq)

    reader = threading.Thread(target=read_all)
    reader.start()
    for seq in range(3000):
        slot.put(frame(seq))
    slot.close()
    reader.join()
    assert seen == sorted(set(seen)), "in order, none twice"
    assert seen[-1] == 2999
    assert slot.stats.delivered == len(seen)
    assert slot.stats.grabbed == 3000 == slot.stats.delivered + slot.stats.dropped
