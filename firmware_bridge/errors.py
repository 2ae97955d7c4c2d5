"""Everything the arm side raises, in one tree under ``apex_edge.errors.ArmError``.

::

    ArmError
    +-- ProtocolError     a value that no well-formed frame can carry
    +-- LinkLost          the port went away while in use
    +-- PortError         a port that cannot be opened
    |   +-- NoSuchPort    no such port (the message lists those there are)
    |   +-- PortBusy      another program holds the port
    +-- MotionRefused     a path outside the limits; nothing was sent
    +-- NotArmed          the session is not in a state that may do this
    +-- NoReply           a servo or board that did not answer within its retry budget
    +-- HandshakeFailed   the servos on the bus are not those of the arm's file
    +-- SimulatorFileError  a fault script or log that the simulator cannot use
"""

from apex_edge.errors import ArmError


class ProtocolError(ArmError):
    """Refuse a value that no well-formed frame can carry."""

    slug = "arm-protocol"


class LinkLost(ArmError):  # noqa: N818 - says what happened
    """Report a port that went away while in use (unplugged, board reset, hang-up)."""

    slug = "arm-link-lost"


class PortError(ArmError):
    """Report a port that cannot be opened."""

    slug = "arm-port"


class NoSuchPort(PortError):  # noqa: N818 - says what happened
    """Report a port that does not exist; the message lists those that do."""

    slug = "arm-no-such-port"


class PortBusy(PortError):  # noqa: N818 - says what happened
    """Report a port that another program holds or that this user may not open."""

    slug = "arm-port-busy"


class MotionRefused(ArmError):  # noqa: N818 - says what happened
    """Refuse a path outside the limits; nothing of it has been sent."""

    slug = "arm-motion-refused"


class NotArmed(ArmError):  # noqa: N818 - says what happened
    """Refuse an action that the session's state does not allow."""

    slug = "arm-not-armed"


class NoReply(ArmError):  # noqa: N818 - says what happened
    """Report a servo or board that did not answer within its retry budget."""

    slug = "arm-no-reply"


class HandshakeFailed(ArmError):  # noqa: N818 - says what happened
    """Refuse to arm: the servos on the bus are not those of the arm's file and calibration."""

    slug = "arm-handshake"


class SimulatorFileError(ArmError):
    """Refuse a fault script or a log that the simulated firmware cannot use."""

    slug = "arm-simulator-file"
