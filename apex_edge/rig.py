"""A simulated arm behind real bytes: session -> serial port -> pty -> firmware -> servos.

The demo, replays and users without hardware share it. Nothing reaches the servos but bytes.
"""

import time
from typing import Callable

from apex_edge.types import Array
from firmware_bridge.errors import LinkLost
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.session import ArmSession
from firmware_bridge.simulator import PtyBoard, RrcFirmware

PATIENCE_S = 2.0
TICK_S = 0.02


class SimulatedArm:
    """Own a simulated board on a pty and the session that drives it; a context manager.

    Entering opens the port and arms the session at home, where the servos stand.

    Parameters
    ----------
    arm : geometry and rates.
    clock : seconds, real or simulated, on which set-points are paced.
    """

    def __init__(self, arm: ArmModel, clock: Callable[[], float]) -> None:
        self._arm = arm
        self._clock = clock
        self._next_tick_s = clock()
        self.firmware = RrcFirmware(arm)
        self._board = PtyBoard(self.firmware)
        self._link = SerialLink(self._board.port)
        self.session = ArmSession(arm, self._link, clock)

    def __enter__(self) -> "SimulatedArm":
        """Open the port and arm the motors."""
        self.session.open()
        self.session.arm(self.firmware.joints_rad)
        return self

    def __exit__(self, *_: object) -> None:
        """Close the port, then the board behind it."""
        try:
            self.session.close()
        finally:
            self._board.close()

    def advance(self, dt_s: float) -> Array:
        """Let the firmware read what has arrived and its servos turn for ``dt_s``.

        Returns
        -------
        points (4, 3): shoulder, elbow, wrist and tip as the servos really stand.
        """
        self._board.pump()
        self.firmware.step(dt_s)
        return self.points_m()

    def drive(self, dt_s: float) -> Array:
        """Do the host's part as well, for a clock that stands still meanwhile.

        The session is ticked when its time has come and every byte it wrote is delivered first,
        so that simulated time gives the same motion each time. Returns as ``advance``.

        Raises
        ------
        LinkLost : bytes written do not arrive.
        """
        if self._clock() >= self._next_tick_s:
            self._next_tick_s = self._clock() + TICK_S
            self.session.tick()
        give_up_s = time.monotonic() + PATIENCE_S
        while self._board.is_open and self._board.n_bytes_in < self._link.n_bytes_out:
            self._board.pump()
            if time.monotonic() > give_up_s:
                raise LinkLost(f"{self._link.port}: bytes are stuck in the pseudo-terminal")
        return self.advance(dt_s)

    def unplug(self) -> None:
        """Pull the plug: the host's port hangs up."""
        self._board.close()

    def points_m(self) -> Array:
        """Return shoulder, elbow, wrist and tip (4, 3) as the servos really stand."""
        points: Array = self._arm.forward(self.firmware.joints_rad[None, :])[0]
        return points
