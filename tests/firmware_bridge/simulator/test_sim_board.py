"""A simulated board that serves a real pseudo-terminal from a thread of its own."""

import gc
import io
import os
import termios
import threading
import time
from pathlib import Path

import pytest
import serial
from lx_frames import Bus, ask, faulty, move, positions

from firmware_bridge.errors import LinkLost, PortError
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.simulator.line_speed import line_baud, set_line_baud
from firmware_bridge.simulator.log import BoardLog
from firmware_bridge.simulator.pty_board import PtyBoard, serving
from firmware_bridge.simulator.wire import WireOptions

PATIENCE_S = 20.0
FAST = WireOptions(is_paced=False)


def n_descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


def until(condition):
    """Wait for something that takes milliseconds, however loaded the machine is."""
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, "it never happened"
        time.sleep(0.002)


def talk(port, data, n_wanted, baud=115200):
    """Open a port with pyserial, send, and return what comes until enough or patience is over."""
    with serial.Serial(port, baud, timeout=PATIENCE_S, exclusive=True) as line:
        line.write(data)
        return line.read(n_wanted)


def test_served_board_answers_a_real_serial_program():
    with serving(PtyBoard(Bus((1, 2)))) as board:
        assert positions(talk(board.port, ask(2), 8)) == [(2, 200)]


def test_served_board_moves_its_servos_in_real_time():
    bus = Bus((1,))
    with serving(PtyBoard(bus)) as board:
        talk(board.port, move(1, 300, 50), 0)
        until(lambda: bus.servos[0].measured == 300)


def test_pacing_is_that_of_the_clock_handed_in():
    clock_s = [0.0]
    board = PtyBoard(Bus((1,)), clock=lambda: clock_s[0])
    with board, serial.Serial(board.port, 115200, timeout=0) as line:
        board._serve_once()
        line.write(ask(1))
        byte_s = 10 / 115200
        until(lambda: board._serve_once() is not None and board.n_bytes_in == 6)
        arrived = []
        for n_bytes in range(1, 16):
            clock_s[0] = n_bytes * byte_s
            board._serve_once()
            until(lambda n=n_bytes: line.in_waiting == min(max(0, n - 6), 8))
            arrived.append(line.in_waiting)
        assert arrived == [0] * 6 + [1, 2, 3, 4, 5, 6, 7, 8, 8]
        assert positions(line.read(8)) == [(1, 100)]


def test_echo_comes_back_before_the_answer():
    with serving(PtyBoard(Bus((1,)), options=WireOptions(is_echo=True))) as board:
        got = talk(board.port, ask(1), 14)
    assert got[:6] == ask(1)
    assert positions(got[6:]) == [(1, 100)]


def test_wrong_baud_gives_no_answer_and_the_right_one_does():
    bus = Bus((1,))
    with serving(PtyBoard(bus)) as board:
        with serial.Serial(board.port, 9600, timeout=0.2) as line:
            line.write(ask(1))
            until(lambda: board.n_bytes_in == 6)
            assert line.read(8) == b""
        assert positions(talk(board.port, ask(1), 8)) == [(1, 100)]


@pytest.mark.parametrize("baud", [9600, 115200, 1_000_000, 250_000])
def test_baud_that_a_program_sets_is_seen(baud):
    master, slave = os.openpty()
    try:
        with serial.Serial(os.ttyname(slave), baud):
            assert line_baud(slave) == baud
    finally:
        os.close(master)
        os.close(slave)


def test_program_that_sets_no_baud_is_understood():
    master, slave = os.openpty()
    try:
        set_line_baud(slave, 115200)
        assert termios.tcgetattr(slave)[5] == termios.B115200
    finally:
        os.close(master)
        os.close(slave)


def test_link_follows_the_board_through_unplug_and_replug(tmp_path):
    name = tmp_path / "arm"
    board = PtyBoard(Bus((1,)), link=name, options=FAST)
    with serving(board):
        link = SerialLink(str(name), 115200)
        link.open()
        board.unplug()
        assert not name.is_symlink()
        with pytest.raises(LinkLost):
            for _ in range(1000):
                link.write(ask(1))
                link.read_available()
        board.replug()
        assert positions(talk(str(name), ask(1), 8)) == [(1, 100)]
    assert not name.is_symlink()


def test_fault_script_pulls_the_plug_and_puts_it_back(tmp_path):
    name = tmp_path / "arm"
    firmware = faulty(devices=[{"kind": "unplug", "at_s": 0.05, "for_s": 0.2}])
    stream = io.StringIO()
    log = BoardLog(stream, firmware, {"protocol": "lx16a"})
    with serving(PtyBoard(firmware, link=name, options=FAST, log=log)) as board:
        until(lambda: stream.getvalue().count('"plugged in"') == 2)
        assert stream.getvalue().count('"unplugged"') == 1
        until(lambda: board.is_open and name.is_symlink())
        assert positions(talk(str(name), ask(1), 8)) == [(1, 100)]


def test_bytes_under_way_are_lost_with_the_plug():
    bus = Bus((1,))
    clock_s = [0.0]
    board = PtyBoard(bus, clock=lambda: clock_s[0])
    with board, serial.Serial(board.port, 115200) as line:
        line.write(move(1, 900, 0))
        until(lambda: board._serve_once() is not None and board.n_bytes_in == 10)
        clock_s[0] = 5 * 10 / 115200  # half of the frame has arrived
        board._serve_once()
        board.unplug()
        board.replug()
        clock_s[0] = 1.0
        board._serve_once()
    assert bus.servos[0].target == 100


def test_stale_link_is_replaced_and_a_file_is_not(tmp_path):
    stale = tmp_path / "stale"
    stale.symlink_to("/dev/pts/99999")
    with PtyBoard(Bus((1,)), link=stale) as board:
        assert Path(os.readlink(str(stale))).exists()
        assert board.port == str(stale)
    precious = tmp_path / "notes.txt"
    precious.write_text("keep me")
    n_before = n_descriptors()
    with pytest.raises(PortError, match="notes.txt"):
        PtyBoard(Bus((1,)), link=precious)
    assert precious.read_text() == "keep me"
    assert n_descriptors() == n_before


def test_no_thread_or_descriptor_is_left_behind(tmp_path):
    def once():
        board = PtyBoard(Bus((1,)), link=tmp_path / "arm", options=FAST)
        with serving(board):
            for _ in range(5):
                board.unplug()
                board.replug()
            talk(board.port, ask(1), 8)

    once()
    gc.collect()
    before = n_descriptors(), threading.active_count()
    for _ in range(5):
        once()
    gc.collect()
    assert (n_descriptors(), threading.active_count()) == before


def test_error_in_the_board_reaches_its_owner():
    class Broken(Bus):
        def step(self, dt_s):
            raise ZeroDivisionError("in the firmware")

    board = PtyBoard(Broken((1,)))
    with pytest.raises(ZeroDivisionError), serving(board):
        time.sleep(0.05)
    assert not board.is_open


def test_answers_that_nobody_reads_are_dropped_not_kept():
    class Chatty(Bus):
        def replies(self):
            return bytes(100)

    with serving(PtyBoard(Chatty((1,)), options=FAST)) as board:
        until(lambda: board.n_dropped > 10_000)
        assert len(board._pending) == 0
