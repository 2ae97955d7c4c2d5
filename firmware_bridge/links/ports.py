"""The serial ports of this machine, with the names that stay when cables are swapped."""

from pathlib import Path
from typing import List, NamedTuple

from serial.tools import list_ports

_BY_ID = Path("/dev/serial/by-id")


class PortInfo(NamedTuple):
    """One port. ``usb_id`` is VID:PID in hex; ``stable`` a name that survives replugging.

    Both are "" where there is none.
    """

    device: str
    description: str
    usb_id: str
    stable: str

    def __str__(self) -> str:
        return self.device


def ports(by_id: Path = _BY_ID) -> List[PortInfo]:
    """List the serial ports this machine has.

    Parameters
    ----------
    by_id : the folder in which the system links stable names to devices.
    """
    stable = {}
    if by_id.is_dir():
        stable = {str(link.resolve()): str(link) for link in sorted(by_id.iterdir())}
    found = []
    for port in list_ports.comports():
        vid, pid = getattr(port, "vid", None), getattr(port, "pid", None)
        usb_id = "" if vid is None or pid is None else f"{vid:04x}:{pid:04x}"
        description = getattr(port, "description", None) or ""
        real = str(Path(port.device).resolve())
        found.append(PortInfo(port.device, description, usb_id, stable.get(real, "")))
    return sorted(found)
