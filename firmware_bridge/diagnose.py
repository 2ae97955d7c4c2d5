"""Why a servo does not answer: it is not there, shares its id, or speaks at another rate.

Takes up to 0.3 s; for an arm that stands. Source: ours.
"""

from typing import Callable, NamedTuple, Optional, Sequence, Tuple

from firmware_bridge.bus import Bus, BusSettings
from firmware_bridge.codec.protocol import Quantity, ServoProtocol
from firmware_bridge.watch import Kind

_BAUDS = (9600, 115_200, 1_000_000, 500_000, 57_600)
_QUICK_S = 0.012
_N_QUICK = 3
_N_ASKED = 3


class Silence(NamedTuple):
    """What was found out about a servo that does not answer."""

    kind: Kind
    text: str


def why_silent(
    bus: Bus, servo_id: int, others: Sequence[int], clock: Callable[[], float]
) -> Silence:
    """Ask a silent servo again, look at what comes instead of an answer, and try other rates.

    It may have taken the id of one of the ``others``, whose answers are garbled then.

    Raises
    ------
    LinkLost : the link is gone.
    """
    is_noisy = _is_noisy(bus, servo_id)
    if is_noisy is None:
        return Silence(
            Kind.BROWN_OUT,
            "was silent for a moment and is back: it was reset, most likely by a dip of its supply",
        )
    if is_noisy:
        return Silence(
            Kind.CLASH,
            f"answers are garbled: two servos have the id {servo_id}; unplug one of them and give "
            "it another id",
        )
    for other in others:
        if _is_noisy(bus, other):
            return Silence(
                Kind.CLASH,
                f"does not answer, and answers of id {other} are garbled: two servos have the id "
                f"{other}; unplug one of them and give it the id {servo_id}",
            )
    usual = bus.link.baud
    for baud in _BAUDS:
        if baud != usual and _answers_at(bus, servo_id, baud, clock):
            return Silence(
                Kind.BAUD,
                f"answers at {baud} baud, the arm's file says {usual}; set the servo's rate, or "
                "the file's [bus] baud",
            )
    return Silence(
        Kind.DEAD,
        f"does not answer at {usual} baud nor at any other; check its cable, its supply and its id",
    )


def _is_noisy(bus: Bus, servo_id: int) -> Optional[bool]:
    """Say whether something comes instead of an answer; None when a good answer comes."""
    n_noisy = 0
    for _ in range(_N_ASKED):
        link = bus.link
        n_in, n_out = link.n_bytes_in, link.n_bytes_out
        if bus.read(question(bus.protocol), [servo_id]):
            return None
        echoed = link.n_bytes_out - n_out if getattr(link, "has_echo", False) else 0
        n_noisy += link.n_bytes_in - n_in > echoed
    return n_noisy > _N_ASKED // 2


def _answers_at(bus: Bus, servo_id: int, baud: int, clock: Callable[[], float]) -> bool:
    usual = bus.link.baud
    if not bus.link.set_baud(baud):
        return False
    try:
        slack_s = bus.settings.slack_s
        quick = BusSettings(
            n_tries=_N_QUICK, slack_s=slack_s, budget_s=max(_QUICK_S, _N_QUICK * slack_s)
        )
        probe = Bus(bus.protocol, bus.link, quick, clock)
        return bool(probe.read(question(bus.protocol), [servo_id]))
    finally:
        if bus.link.is_open:
            bus.link.set_baud(usual)


def question(protocol: ServoProtocol) -> Quantity:
    """Return what every servo of a protocol can be asked for."""
    order: Tuple[Quantity, ...] = (Quantity.MODEL, Quantity.POSITION, Quantity.TARGET)
    return next(quantity for quantity in order if quantity in protocol.quantities)
