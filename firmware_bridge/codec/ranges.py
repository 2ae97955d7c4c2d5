"""What a field of a frame may hold, and the one way to refuse the rest."""

from firmware_bridge.errors import ProtocolError


def require(name: str, value: int, low: int, high: int) -> None:
    """Refuse what is not a whole number in ``low..high``; True and 1.0 are none.

    Raises
    ------
    ProtocolError : names the field, the value and the range.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ProtocolError(f"{name} = {value!r} is not a whole number in {low}..{high}")
