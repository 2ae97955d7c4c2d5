"""``apex sim-arm`` as a program of its own, spoken to over the port that it makes."""

import json
import signal
import subprocess
import sys
import time

import pytest
import serial

from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.simulator.make import FAMILIES, replay_log

PATIENCE_S = 30.0


class Program:
    """``apex sim-arm`` with a link of its own; killed at the end whatever happens."""

    def __init__(self, tmp_path, name, *options):
        self.link = tmp_path / "arm"
        command = [sys.executable, "-m", "apex_edge.cli", "sim-arm", "--protocol", name]
        command += ["--link", str(self.link), *options]
        self.process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            universal_newlines=True,
            # a test run in the background of a shell has SIGINT switched off, and hands that down
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        )

    def __enter__(self):
        line = self.process.stdout.readline()
        assert str(self.link) in line, self.process.communicate()[1]
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.communicate()

    def end(self, number):
        self.process.send_signal(number)
        return self.process.wait(PATIENCE_S)


def ask(link, name, quantity, servo_ids):
    """Return id -> values, read with pyserial over the link."""
    speech = protocol(name)
    found = {}
    with serial.Serial(str(link), speech.baud, timeout=0.05, exclusive=True) as line:
        for query in speech.query(quantity, servo_ids):
            line.write(query.frame)
            parser, end_s = speech.parser(), time.monotonic() + PATIENCE_S
            while not set(query.servo_ids) <= set(found) and time.monotonic() < end_s:
                for frame in parser.feed(line.read(64)):
                    found.update({one.servo_id: one.values for one in speech.match(query, frame)})
    return found


def send(link, name, frames):
    with serial.Serial(str(link), protocol(name).baud, timeout=0.02, exclusive=True) as line:
        for frame in frames:
            line.write(frame)
            line.read(64)
        line.flush()


def quantity_of(name):
    return Quantity.POSITION if protocol(name).has_feedback else Quantity.TARGET


@pytest.mark.parametrize(
    "name", [one for one in sorted(FAMILIES) if quantity_of(one) in protocol(one).quantities]
)
def test_program_answers_with_real_bytes_over_its_link(tmp_path, name):
    low, high = FAMILIES[name].ticks
    with Program(tmp_path, name) as program:
        found = ask(program.link, name, quantity_of(name), (1, 6))
        assert found == {1: ((low + high + 1) // 2,), 6: ((low + high + 1) // 2,)}


def test_program_moves_its_servos(tmp_path):
    speech = protocol("sts")
    with Program(tmp_path, "sts", "--no-pacing") as program:
        send(program.link, "sts", speech.torque((2,), True))
        send(program.link, "sts", speech.move([ServoTarget(2, 2500, 2000)], 200))
        end_s = time.monotonic() + PATIENCE_S
        place = 0
        while abs(place - 2500) > 20 and time.monotonic() < end_s:
            place = ask(program.link, "sts", Quantity.POSITION, (2,))[2][0]
        assert abs(place - 2500) <= 20


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 128 + signal.SIGTERM)],
)
def test_signal_ends_it_without_a_stale_link(tmp_path, number, code):
    with Program(tmp_path, "sts") as program:
        assert program.link.is_symlink()
        assert program.end(number) == code
        assert not program.link.is_symlink()


def test_it_ends_by_itself_after_the_seconds_asked_for(tmp_path):
    with Program(tmp_path, "sts", "--seconds", "0.2") as program:
        assert program.process.wait(PATIENCE_S) == 0
        assert not program.link.is_symlink()


def test_log_of_a_run_with_faults_replays(tmp_path):
    faults, log = tmp_path / "faults.json", tmp_path / "log.jsonl"
    script = {"version": 1, "devices": [{"kind": "dead", "id": 3, "at_s": 0}]}
    faults.write_text(json.dumps(script))
    speech = protocol("sts")
    options = ("--faults", str(faults), "--log", str(log), "--echo", "--seed", "4")
    with Program(tmp_path, "sts", *options) as program:
        send(program.link, "sts", speech.torque((1, 2, 3), True))
        targets = [ServoTarget(one, 2100, 1000) for one in (1, 2, 3)]
        send(program.link, "sts", speech.move(targets, 100))
        assert program.end(signal.SIGTERM) == 128 + signal.SIGTERM
    recorded, executed = replay_log(log)
    assert {one.servo_id for one in recorded if one.what == "move"} == {1, 2}
    assert executed == recorded


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--faults", "missing.json"), "missing.json"),
        (("--log", "no/such/folder/log"), "no/such/folder/log"),
        (("--arm", "no-such-arm"), "no-such-arm"),
    ],
)
def test_wrong_option_is_one_plain_line_and_no_link(tmp_path, options, message):
    program = Program(tmp_path, "sts", *options)
    _, errors = program.process.communicate(timeout=PATIENCE_S)
    assert program.process.returncode == 2
    assert message in errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []
