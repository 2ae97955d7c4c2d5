"""The baud rate that the host has set on a pseudo-terminal, which itself does not care."""

import array
import fcntl
import sys
import termios
from typing import Dict

_CONSTANTS: Dict[int, int] = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdigit() and name != "B0"
}
_ISPEED, _OSPEED = 4, 5
# struct termios2 of Linux: a rate without a constant of its own is in its last two words
_TCGETS2 = 0x802C542A
_N_WORDS = 11


def line_baud(descriptor: int) -> int:
    """Return the output baud rate set on a terminal; 0 when it has none."""
    found = int(termios.tcgetattr(descriptor)[_OSPEED])
    if found in _CONSTANTS or not sys.platform.startswith("linux"):
        return _CONSTANTS.get(found, 0)
    words = array.array("I", [0] * _N_WORDS)
    fcntl.ioctl(descriptor, _TCGETS2, words)
    return words[-1]


def set_line_baud(descriptor: int, baud: int) -> None:
    """Set a baud rate that has a constant, for programs that never set one; else do nothing."""
    for constant, rate in _CONSTANTS.items():
        if rate == baud:
            attributes = termios.tcgetattr(descriptor)
            attributes[_ISPEED] = attributes[_OSPEED] = constant
            termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
