"""Choose the link that an address asks for."""

from firmware_bridge.codec.protocol import ServoProtocol
from firmware_bridge.links.base import Link
from firmware_bridge.links.serial_link import SerialLink


def open_link(port: str, protocol: ServoProtocol) -> Link:
    """Return the link to a port, not opened yet; ``Bus.open`` or ``Link.open`` does that.

    Parameters
    ----------
    port : a device, a pyserial URL (``socket://host:port``, ``rfc2217://...``), or ``i2c://BUS``.
    protocol : gives the baud rate.
    """
    if port.startswith("i2c://"):
        from firmware_bridge.links.i2c import I2cLink

        return I2cLink(port)
    return SerialLink(port, protocol.baud)
