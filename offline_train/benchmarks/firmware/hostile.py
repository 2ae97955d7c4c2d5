"""Hostile targets through a whole session, down to the bytes: no frame on the wire breaks a limit.

Everything is real but time and the servos. Each frame that reaches the simulated board is decoded
there and judged by ``guard_cases``' oracle, which shares no code with the guard. Source: ours.
"""

from collections import Counter
from typing import List, NamedTuple, Tuple

import numpy as np

from apex_edge.types import Array
from apex_edge.verbs.progress import Progress
from firmware_bridge.codec import rrc, rrc_frames
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator.direct_link import DirectLink
from firmware_bridge.simulator.rrc_arm import RrcFirmware
from offline_train.benchmarks.firmware.guard_cases import hostile, pose_faults
from offline_train.benchmarks.firmware.live import quiet
from offline_train.benchmarks.lines import Line, at_least, at_most, note

SUITE = "hostile session"
N_TARGETS = 1_000_000
_ROUNDING_M = 1e-3  # whole pulses: 1.6 mrad on up to 0.3 m
_BATCH = 2000
_MAX_TICKS = 12


class Frame(NamedTuple):
    """One move as the board took it: where from, where to (k,) in ticks, in how many seconds."""

    from_ticks: Array
    to_ticks: Array
    duration_s: float


class Log:
    """Decode what arrives at the board; ``frames`` are those not judged yet."""

    def __init__(self, arm: ArmModel, firmware: RrcFirmware) -> None:
        self._arm, self._firmware = arm, firmware
        self._parser = rrc_frames.device_parser()
        self.frames: List[Frame] = []
        self.n_frames = 0
        self.faults: Counter = Counter()

    def __call__(self, data: bytes) -> bytes:
        """Note the bytes on their way to the board."""
        for raw in self._parser.feed(data):
            self.n_frames += 1
            message = rrc.decode_to_board(raw)
            if not isinstance(message, rrc.PwmMove):
                self.faults[f"unexpected {type(message).__name__}"] += 1
                continue
            told = dict(message.targets)
            goal = np.array([told[i] for i in self._arm.servo_ids], dtype=float)
            servos = {servo.servo_id: servo for servo in self._firmware.servos}
            start = np.array([servos[i].set_point for i in self._arm.servo_ids])
            self.frames.append(Frame(start, goal, message.duration_ms / 1000.0))
        return data

    def judge(self) -> None:
        """Put all noted frames to the oracle and count what is wrong with them."""
        if not self.frames:
            return
        arm = self._arm
        goals = np.array([frame.to_ticks for frame in self.frames])
        starts = np.array([frame.from_ticks for frame in self.frames])
        times = np.array([frame.duration_s for frame in self.frames])
        poses = arm.angles_rad(goals)
        inside = np.clip(poses, arm.limits_rad[:, 0], arm.limits_rad[:, 1])
        is_rounded = np.abs(poses - inside) * np.abs(arm.ticks_per_rad) <= 0.5 + 1e-6
        for fault in pose_faults(arm, np.where(is_rounded, inside, poses), -_ROUNDING_M):
            self.faults[fault] += bool(fault)
        # both ends are whole pulses
        speed = np.maximum(np.abs(goals - starts) - 2.0, 0.0) / times[:, None]
        is_fast = speed > np.abs(arm.ticks_per_rad) * arm.rate_rad_s * 1.001
        self.faults["over speed"] += int(is_fast.any(axis=1).sum())
        self.frames.clear()


def measure(scale: float, seed: int) -> List[Line]:
    """Put hostile targets to a session on the ArmPi mini; a million at scale 1."""
    n_targets = max(100, int(round(N_TARGETS * scale)))
    log, n_accepted, n_faults = run(n_targets, seed)
    wrong = sum(log.faults.values())
    found = ", ".join(f"{what} {n}" for what, n in log.faults.most_common(3) if what)
    return [
        at_most(
            SUITE, f"violating frames of {log.n_frames}: {found or 'none'}", wrong, 0, "{:.0f}"
        ),
        at_most(SUITE, f"faults of the session in {n_targets} targets", n_faults, 0, "{:.0f}"),
        at_least(SUITE, "targets accepted, so that something moves", n_accepted, 1, "{:.0f}"),
        note(SUITE, "share accepted", n_accepted / n_targets),
    ]


def run(n_targets: int, seed: int) -> Tuple[Log, int, int]:
    """Return the judged log, how many targets were accepted, and how often the session broke."""
    rng = np.random.default_rng(seed)
    arm = ArmModel.load("armpi-mini")
    firmware = RrcFirmware(arm)
    log = Log(arm, firmware)
    session = ArmSession(arm, DirectLink(firmware, log), lambda: firmware.t_s)
    session.open()
    session.arm(arm.home_rad)
    n_accepted = n_faults = 0
    with quiet(), Progress("targets", n_targets) as progress:
        for _ in range(n_targets):
            target = hostile(rng, arm)
            deadline_s = None if target.deadline_s is None else firmware.t_s + target.deadline_s
            report = session.move(target.joints_rad, target.duration_s, deadline_s)
            n_accepted += report.is_accepted
            for _ in range(int(rng.integers(_MAX_TICKS)) if report.is_accepted else 0):
                firmware.step(session.rhythm.tick_s)
                session.tick()
            if session.state not in (SessionState.ARMED, SessionState.MOVING):
                n_faults += 1
                session.reset()
                session.arm(firmware.joints_rad)
            if len(log.frames) >= _BATCH:
                log.judge()
            progress.advance()
    session.close()
    log.judge()
    return log, n_accepted, n_faults
