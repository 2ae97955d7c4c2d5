"""A served board on a pty and the session on it, in real time."""

import time
from contextlib import ExitStack

import numpy as np

from firmware_bridge import codec
from firmware_bridge.bus import Bus, BusSettings
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator.faulty import servos_of
from firmware_bridge.simulator.make import Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving

# board and host share this process: on a busy machine an answer may take its time
PATIENT = BusSettings(slack_s=0.02, budget_s=0.1)
ARMS = {"sts": "so-101", "lx16a": "lx16a-arm", "rrc-bus": "armpi"}


class LiveArm:
    def __init__(self, protocol, faults=None, ids=(), **options):
        name = ARMS[protocol]
        script = None if faults is None else {"version": 1, "devices": faults}
        setup = Setup(protocol, "" if ids else name, ids, faults=script)
        self.arm = ArmModel.load(name)
        self.firmware = setup.firmware()
        self.board = PtyBoard(self.firmware, options=setup.wire())
        self.link = SerialLink(self.board.port, self.firmware.baud)
        bus = Bus(codec.protocol(protocol), self.link, PATIENT)
        self.session = ArmSession(self.arm, bus, time.monotonic, **options)
        self._stack = ExitStack()

    def __enter__(self):
        self._stack.enter_context(serving(self.board))
        self._stack.callback(self.session.close)
        return self

    def __exit__(self, *_):
        self._stack.close()

    def ready(self):
        self.session.open()
        self.session.arm()
        return self

    def swing(self, by_rad=0.4, duration_s=0.8):
        goal = self.arm.home_rad.copy()
        goal[0] += by_rad
        report = self.session.move(goal[None], np.array([duration_s]))
        assert report.is_accepted, report.reason
        return goal

    def tick_until(self, is_done, timeout_s=8.0):
        end_s = time.monotonic() + timeout_s
        while not is_done() and time.monotonic() < end_s:
            self.session.tick()
            time.sleep(0.01)
        return is_done()

    def tick_for(self, seconds):
        self.tick_until(lambda: False, seconds)

    def is_state(self, state):
        return lambda: self.session.state is state

    def arrive(self):
        return self.tick_until(self.is_state(SessionState.ARMED))

    def true_rad(self):
        at = {servo.servo_id: servo.actual for servo in servos_of(self.firmware)}
        return self.arm.angles_rad(np.array([at[i] for i in self.arm.servo_ids]))

    def n_commands(self):
        return self.link.n_bytes_out
