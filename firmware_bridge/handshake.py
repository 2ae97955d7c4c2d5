"""Before an arm is armed: are servos and calibration those of the arm's file?

Every id is asked for its model, limits and offset where the protocol has them. Source: ours.
"""

from dataclasses import dataclass
from typing import Callable, Dict, List, Optional, Tuple

from firmware_bridge.bus import Bus, Reading
from firmware_bridge.calibration import compare_calibration
from firmware_bridge.codec.protocol import Quantity
from firmware_bridge.diagnose import question, why_silent
from firmware_bridge.errors import HandshakeFailed
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.servos import Servos

_N_ASKED = 3
_SLACK_TICKS = 2  # a limit that was rounded the other way


@dataclass(frozen=True)
class ServoFound:
    """One servo's answers; None where it or its protocol has none."""

    servo_id: int
    name: str
    is_there: bool
    model: Optional[int] = None
    limits_ticks: Optional[Tuple[int, int]] = None
    offset_ticks: Optional[int] = None


@dataclass(frozen=True)
class Findings:
    """What a handshake found: ``troubles`` forbid to arm, ``notes`` are worth knowing."""

    servos: Tuple[ServoFound, ...]
    troubles: Tuple[str, ...]
    notes: Tuple[str, ...]

    def require(self, port: str) -> None:
        """Refuse an arm with troubles.

        Raises
        ------
        HandshakeFailed : says what differs and what to do.
        """
        if self.troubles:
            raise HandshakeFailed(f"{port}: {'; '.join(self.troubles)}")


def calibrated(arm: ArmModel) -> Findings:
    """Compare the arm's file with the calibration that it names; asks no servo."""
    troubles, notes = compare_calibration(arm)
    return Findings((), tuple(troubles), tuple(notes))


def shake_hands(servos: Servos, clock: Callable[[], float]) -> Findings:
    """Look at the calibration, ask every servo of the arm, and find out why one is silent.

    A board that cannot be asked at all (I2C) is taken as it is, with a note.

    Raises
    ------
    LinkLost : the link is gone.
    """
    arm, bus = servos.arm, servos.bus
    troubles, notes = compare_calibration(arm)
    if not bus.protocol.quantities & {Quantity.MODEL, Quantity.POSITION, Quantity.TARGET}:
        notes.append(f"{bus.protocol.name} cannot be asked whether the servos are there")
        return Findings((), tuple(troubles), tuple(notes))
    there = _ask_all(bus, arm.all_ids)
    for servo_id in arm.all_ids:
        if servo_id not in there:
            others = [i for i in arm.all_ids if i != servo_id]
            silence = why_silent(bus, servo_id, others, clock)
            who = f"{servos.name_of(servo_id)} (id {servo_id})"
            troubles.append(f"{silence.kind.value}: {who} {silence.text}")
    ids = tuple(i for i in arm.all_ids if i in there)
    limits = _read(bus, Quantity.LIMITS, ids)
    offsets = _read(bus, Quantity.OFFSET, ids)
    models = there if Quantity.MODEL in bus.protocol.quantities else {}
    found = tuple(
        ServoFound(
            i,
            servos.name_of(i),
            i in there,
            models[i].values[0] if i in models else None,
            (limits[i].values[0], limits[i].values[1]) if i in limits else None,
            offsets[i].values[0] if i in offsets else None,
        )
        for i in arm.all_ids
    )
    for servo in found:
        _compare(arm, servo, troubles, notes)
    return Findings(found, tuple(troubles), tuple(notes))


def wanted_limits(arm: ArmModel, servo_id: int) -> Tuple[int, int]:
    """Return the positions that the arm's file lets a servo take, lowest and highest."""
    if servo_id in arm.servo_ids:
        j = arm.servo_ids.index(servo_id)
        ends = arm.zero_ticks[j] + arm.ticks_per_rad[j] * arm.limits_rad[j]
        return int(round(float(ends.min()))), int(round(float(ends.max())))
    if arm.gripper is None:
        return arm.tick_range
    low, high = sorted((arm.gripper.open_ticks, arm.gripper.closed_ticks))
    return low, high


def _compare(arm: ArmModel, servo: ServoFound, troubles: List[str], notes: List[str]) -> None:
    who = f"{servo.name} (id {servo.servo_id})"
    if servo.model is not None and arm.bus.model and servo.model != arm.bus.model:
        troubles.append(
            f"{who} is model {servo.model}, the arm's file says {arm.bus.model}; "
            "is this the right arm?"
        )
    if servo.limits_ticks is not None:
        low, high = wanted_limits(arm, servo.servo_id)
        has_low, has_high = servo.limits_ticks
        is_free = has_low >= has_high  # STS: both 0 switch the limits off
        if not is_free and (has_low > low + _SLACK_TICKS or has_high < high - _SLACK_TICKS):
            troubles.append(
                f"{who} itself allows {has_low}..{has_high}, the arm's file {low}..{high}: it "
                "would stop short of where it is sent; write the file's limits into the servo "
                "(apex arm ping --write-limits) or narrow the file's"
            )
        elif is_free or has_low < low - _SLACK_TICKS or has_high > high + _SLACK_TICKS:
            notes.append(f"{who} itself allows {has_low}..{has_high}, wider than {low}..{high}")
    if servo.offset_ticks:
        notes.append(f"{who} keeps an offset of {servo.offset_ticks} ticks of its own")


def _ask_all(bus: Bus, ids: Tuple[int, ...]) -> Dict[int, Reading]:
    """Ask everybody, and those who did not answer again: this machine may have been busy."""
    there: Dict[int, Reading] = {}
    for _ in range(_N_ASKED):
        there.update(bus.read(question(bus.protocol), [i for i in ids if i not in there]))
        if len(there) == len(ids):
            break
    return there


def _read(bus: Bus, quantity: Quantity, ids: Tuple[int, ...]) -> Dict[int, Reading]:
    if quantity not in bus.protocol.quantities or not ids:
        return {}
    return bus.read(quantity, ids)
