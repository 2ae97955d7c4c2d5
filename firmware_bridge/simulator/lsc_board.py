"""An LSC / xArm servo controller with bus servos behind it, simulated from the bytes up.

The board keeps action groups and plays them; by pad or app too (``press``), and then it tells the
host unasked. It has no stop command and no watchdog. Servos that do not answer are left out of an
answer (what real boards do then is not published).
"""

from typing import Dict, List, Mapping, Optional, Sequence

from firmware_bridge.codec import lsc
from firmware_bridge.simulator.board import Board
from firmware_bridge.simulator.lx_servo import LxServo
from firmware_bridge.simulator.servo import SimServo

_PULSES_US = (500, 2500)
_FALLBACK_MV = 7400.0  # a board without servos


class LscBoard(Board):
    """A board at 9600 baud; see ``Board`` for the counts.

    Parameters
    ----------
    servos : what it drives.
    groups : number -> moves of an action group, played one after the other.
    """

    def __init__(
        self, servos: Sequence[SimServo], groups: Optional[Mapping[int, Sequence[lsc.Move]]] = None
    ) -> None:
        super().__init__(servos, lsc.device_parser(), lsc.BAUD)
        self.members: List[LxServo] = [LxServo(servo) for servo in self.servos]
        self._groups = dict(groups or {})
        self._percent: Dict[int, int] = {}
        self._running: Optional[lsc.GroupRun] = None
        self._n_played = 0
        self._at = 0
        self._next_s = 0.0

    @property
    def commanded(self) -> Dict[int, int]:
        """Id -> the target it last set out for, of those that were sent somewhere."""
        return {m.servo.servo_id: m.commanded for m in self.members if m.commanded is not None}

    @property
    def battery_mv(self) -> int:
        """Supply voltage."""
        supply_mv = self.servos[0].supply_mv if self.servos else _FALLBACK_MV
        return min(max(int(round(supply_mv)), 0), 20000)

    def press(self, group: int, n_times: int = 1) -> None:
        """Start an action group by pad or app; the host is told unasked."""
        self._run(lsc.GroupRun(group, n_times))
        self.answer(lsc.encode(lsc.GroupRun(group, n_times)))

    def press_stop(self) -> None:
        """Stop the running group by pad or app; the host is told unasked."""
        self._running = None
        self.answer(lsc.encode(lsc.GroupStop()))

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass and play the running group."""
        super().step(dt_s)
        if self._running is not None and self.t_s >= self._next_s - 1e-9:
            self._play(self._running)

    def obey(self, frame: bytes) -> None:
        """Carry out a well-formed frame.

        Raises
        ------
        ProtocolError : an unknown command, or values no host sends.
        """
        message = lsc.decode_to_board(frame)
        if isinstance(message, lsc.Move):
            self._move(message, 100)
        elif isinstance(message, lsc.Unload):
            for member in self._with_ids(message.servo_ids):
                member.set_torque(False)
        elif isinstance(message, lsc.PositionRequest):
            self._tell_positions(message.servo_ids)
        elif isinstance(message, lsc.BatteryRequest):
            self.answer(lsc.encode(lsc.Battery(self.battery_mv)))
        elif isinstance(message, lsc.GroupRun):
            self._run(message)
        elif isinstance(message, lsc.GroupStop):
            self._running = None
        else:
            numbers = self._groups if message.group == lsc.ALL_GROUPS else (message.group,)
            self._percent.update({group: message.percent for group in numbers})

    def _move(self, move: lsc.Move, percent: int) -> None:
        duration_ms = move.duration_ms * 100 // percent
        for servo_id, position in move.targets:
            members = self._with_ids((servo_id,))
            self.n_rejected += not members
            for member in members:
                self.n_clamped += not member.move(position, duration_ms)

    def _tell_positions(self, servo_ids: Sequence[int]) -> None:
        pairs = []
        for servo_id in servo_ids:
            for member in self._with_ids((servo_id,))[:1]:
                pairs.append((servo_id, min(max(member.measured, -500), 1500)))
        if pairs:
            self.answer(lsc.encode(lsc.Positions(tuple(pairs))))

    def _with_ids(self, servo_ids: Sequence[int]) -> List[LxServo]:
        return [m for m in self.members if m.servo.servo_id in servo_ids and m.servo.is_answering]

    def _run(self, run: lsc.GroupRun) -> None:
        if self._groups.get(run.group):
            self._running, self._n_played, self._at, self._next_s = run, 0, 0, self.t_s

    def _play(self, run: lsc.GroupRun) -> None:
        """Send the next move of the group, or tell that it has run to its end."""
        moves, percent = self._groups[run.group], self._percent.get(run.group, 100)
        if self._at == len(moves):
            self._n_played, self._at = self._n_played + 1, 0
            if run.n_times and self._n_played >= run.n_times:
                self._running = None
                self.answer(lsc.encode(lsc.GroupComplete(run.group, run.n_times)))
                return
        move = moves[self._at]
        self._move(move, percent)
        self._at += 1
        self._next_s = self.t_s + max(move.duration_ms, 1) / 10.0 / percent


class LscPwmBoard(LscBoard):
    """A board with PWM servos: pulses of 500..2500 us, and nobody tells where they are."""

    def __init__(
        self, servos: Sequence[SimServo], groups: Optional[Mapping[int, Sequence[lsc.Move]]] = None
    ) -> None:
        super().__init__(servos, groups)
        for member in self.members:
            member.limits = _PULSES_US

    def _tell_positions(self, servo_ids: Sequence[int]) -> None:
        """Say nothing: there is nothing to measure with."""
