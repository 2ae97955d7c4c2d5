"""The process that stops the arm of a dead or stalled host."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from live_arm import LiveArm

from firmware_bridge import supervisor
from firmware_bridge.deadman import Deadman
from firmware_bridge.session import SessionState
from firmware_bridge.supervisor import IDLE, WATCH, Beat, StopBytes

DESCRIPTORS = Path("/proc/self/fd")


@pytest.fixture
def line():
    ours, theirs = socket.socketpair()
    ours.settimeout(5.0)
    with ours, theirs:
        yield ours, theirs


def is_gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_a_beat_survives_its_packet():
    beat = Beat(WATCH, 12.5, 0.12, (StopBytes(0.0, b"abc"), StopBytes(0.02, b"")))
    assert Beat.unpack(beat.pack()) == beat


def test_the_bytes_are_those_of_the_moment():
    beat = Beat(WATCH, 10.0, 0.12, (StopBytes(0.0, b"a"), StopBytes(0.02, b"b")))
    assert [beat.stop_at(t_s) for t_s in (9.9, 10.0, 10.019, 10.021, 11.0)] == [
        b"a", b"a", b"a", b"b", b"b",
    ]  # fmt: skip
    assert Beat(IDLE, 10.0, 0.12).stop_at(11.0) == b""


def test_silence_while_moving_sends_the_stop_and_says_so(line):
    ours, theirs = line
    deadman = Deadman()
    deadman.start(theirs.fileno())
    deadman.beat([StopBytes(0.0, b"HALT")], is_moving=True)
    assert ours.recv(4) == b"HALT"
    assert "stalled" in deadman.check()
    deadman.clear()
    deadman.beat([], is_moving=False)
    assert deadman.check() == ""
    deadman.stop()


def test_silence_while_standing_is_no_matter(line):
    ours, theirs = line
    deadman = Deadman()
    deadman.start(theirs.fileno())
    deadman.beat([StopBytes(0.0, b"HALT")], is_moving=False)
    ours.settimeout(0.4)
    with pytest.raises(socket.timeout):
        ours.recv(4)
    assert deadman.check() == ""
    deadman.stop()


def test_a_host_that_says_goodbye_leaves_no_process_and_no_descriptor(line):
    ours, theirs = line
    before = len(list(DESCRIPTORS.iterdir()))
    deadman = Deadman()
    deadman.start(theirs.fileno())
    pid = deadman.pid
    deadman.beat([StopBytes(0.0, b"HALT")], is_moving=True)
    deadman.stop()
    assert is_gone(pid)
    assert len(list(DESCRIPTORS.iterdir())) == before
    ours.settimeout(0.3)
    with pytest.raises(socket.timeout):
        ours.recv(4)


def test_a_supervisor_that_dies_is_a_trouble(line):
    deadman = Deadman()
    deadman.start(line[1].fileno())
    os.kill(deadman.pid, signal.SIGKILL)
    end_s = time.monotonic() + 5.0
    while not deadman.check() and time.monotonic() < end_s:
        time.sleep(0.01)
    assert "supervisor process" in deadman.trouble
    assert not deadman.is_on


def test_it_needs_nothing_but_the_standard_library():
    program = (
        "import sys; sys.argv = ['x']; import runpy; runpy.run_path(%r);"
        "sys.exit(any(m.split('.')[0] in ('numpy', 'serial', 'apex_edge') for m in sys.modules))"
    )
    command = [sys.executable, "-I", "-S", "-c", program % supervisor.__file__]
    assert subprocess.run(command).returncode == 0


def test_a_host_that_stalls_in_motion_finds_itself_in_fault():
    with LiveArm("sts", deadman=Deadman()) as live:
        live.ready().swing(0.8, 2.0)
        live.tick_for(0.2)
        time.sleep(0.5)
        held = live.true_rad()
        live.tick_for(0.3)
        assert live.session.state is SessionState.FAULT
        assert "stalled" in live.session.reason
        assert np.abs(live.true_rad() - held).max() < 0.02
        live.session.reset()
        live.session.arm()
        live.swing(0.1)
        assert live.arrive()


def test_closing_the_session_ends_its_supervisor():
    deadman = Deadman()
    with LiveArm("sts", deadman=deadman) as live:
        live.ready()
        pid = deadman.pid
        assert not is_gone(pid)
        live.session.close()
        assert is_gone(pid)
