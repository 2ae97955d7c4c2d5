"""How fast each servo really gets there, from recorded steps: rate, acceleration or lag, dead time.

Each step is one command from rest to rest; its samples are (t_s, angle), t_s counted from the
moment the command had been sent. Source: ours.
"""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from calib.csv_rows import read_numbers
from calib.spread import rms
from calib.travel_model import KINDS, LAG, Fitted, Travel, crossing, first_guess, fit
from calib.verdict import WARN, Limit, Verdict, judge, known, worst

COLUMNS = ("servo_id", "step", "t_s", "angle_deg")
WITHIN_DEG = 1.0  # an arm within this of its target has arrived
_SPACING_S = 0.05
_TAIL = 3  # samples at the end that say where the step ended
_CHOICE = 0.9  # the simpler kind stays unless the other one leaves less than this of the residual


@dataclass(frozen=True)
class TravelSamples:
    """Samples (n,): servo, number of the step, time since the command, joint angle."""

    servo_id: Array
    step: Array
    t_s: Array
    angle_deg: Array


class Step(NamedTuple):
    """One step, turned so that it goes up from 0: times (n,), ways (n,) in rad, and the turn."""

    t_s: Array
    way_rad: Array
    turn_rad: float
    rest_deg: float


@dataclass(frozen=True)
class TravelFit:
    """One servo. ``accel_rad_s2`` or ``time_constant_s`` is NaN: the kind has the other one.

    ``arrival_s`` is the RMS of predicted against recorded arrivals, ``late_s`` the latest of them
    against the prediction.
    """

    servo_id: int
    verdict: str
    reasons: Tuple[str, ...]
    n_steps: int
    n_samples: int
    largest_turn_deg: float
    kind: str = ""
    dead_s: float = math.nan
    rate_rad_s: float = math.nan
    accel_rad_s2: float = math.nan
    time_constant_s: float = math.nan
    sd_dead_s: float = math.nan
    sd_rate_rad_s: float = math.nan
    residual_deg: float = math.nan
    arrival_s: float = math.nan
    late_s: float = math.nan

    @property
    def travel(self) -> Travel:
        """Return the fitted model."""
        shape = self.time_constant_s if self.kind == LAG else self.accel_rad_s2
        return Travel(self.kind, self.dead_s, self.rate_rad_s, shape)

    @property
    def lag_s(self) -> float:
        """How long after the end of the ramp the joint stands within a degree."""
        return self.dead_s + self.travel.settle_s(math.radians(WITHIN_DEG))

    def plain(self) -> Dict[str, Any]:
        """Return it as plain values, with null for what is not known."""
        return {**known(asdict(self)), "reasons": list(self.reasons)}


def read_samples(path: Path) -> TravelSamples:
    """Read a file of servo_id, step, t_s, angle_deg below a header line.

    Raises
    ------
    CalibrationError : unreadable, or a row that is not of that form or out of range.
    """
    rows = read_numbers(path, len(COLUMNS))
    if not len(rows):
        raise CalibrationError(f"{path}: no sample in the file")
    for index, (servo_id, step, t_s, angle_deg) in enumerate(rows):
        where = f"{path}: row {index + 1}"
        if servo_id != round(servo_id) or not 1 <= servo_id <= 253 or step != round(step):
            raise CalibrationError(f"{where}: servo_id and step must be whole numbers, ids 1..253")
        if not (-60.0 <= t_s <= 600.0 and -720.0 <= angle_deg <= 720.0):
            raise CalibrationError(
                f"{where}: t_s = {t_s:g}, angle_deg = {angle_deg:g}; allowed are -60..600 s from "
                "the command and -720..720 deg"
            )
    return TravelSamples(rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2], rows[:, 3])


def samples_text(samples: TravelSamples) -> str:
    """Return samples as the text of a file that ``read_samples`` reads."""
    rows = zip(samples.servo_id, samples.step, samples.t_s, samples.angle_deg)
    lines = [f"{i},{k},{t:.6f},{angle:.5f}" for i, k, t, angle in rows]
    return "\n".join([",".join(COLUMNS), *lines]) + "\n"


def gather(steps: Sequence[Tuple[int, Array]]) -> TravelSamples:
    """Return recorded steps, each a servo id and samples (n, 2) of t_s and angle in rad."""
    if not steps:
        raise CalibrationError("no step was recorded")
    ids = [np.full(len(samples), servo_id) for servo_id, samples in steps]
    order = [np.full(len(samples), k) for k, (_, samples) in enumerate(steps)]
    rows = np.concatenate([samples for _, samples in steps])
    return TravelSamples(
        np.concatenate(ids), np.concatenate(order), rows[:, 0], np.degrees(rows[:, 1])
    )


def record(
    move: Callable[[], None],
    read_rad: Callable[[], float],
    clock: Callable[[], float],
    watch_s: float,
) -> Array:
    """Command one step of an arm with feedback and watch it; returns samples (n, 2).

    ``move`` returns when the command has been sent; ``read_rad`` takes as long as a reading does
    (an angle that is not finite is left out). The first sample is from before the command.
    """
    before = read_rad()
    move()
    sent_s = clock()
    rows = [(0.0, before)]
    while clock() - sent_s < watch_s:
        begun_s = clock()
        angle = read_rad()
        rows.append((0.5 * (begun_s + clock()) - sent_s, angle))
    samples = np.array(rows)
    kept: Array = samples[np.isfinite(samples[:, 1])]
    return kept


def solve(samples: TravelSamples) -> Tuple[TravelFit, ...]:
    """Fit each servo of the samples and judge it, in the order of their ids."""
    return tuple(_fit(samples, int(servo_id)) for servo_id in np.unique(samples.servo_id))


def overall(fits: Sequence[TravelFit]) -> Verdict:
    """Return the worst verdict of all servos, with every reason and whose it is."""
    reasons = [f"servo {each.servo_id}: {reason}" for each in fits for reason in each.reasons]
    return Verdict(worst([each.verdict for each in fits]), tuple(reasons))


def steps_of(samples: TravelSamples, servo_id: int) -> List[Step]:
    """Return the steps of one servo that have enough samples to say anything, in order."""
    mine = samples.servo_id == servo_id
    steps = []
    for number in np.unique(samples.step[mine]):
        which = np.flatnonzero(mine & (samples.step == number))
        which = which[np.argsort(samples.t_s[which], kind="stable")]
        t_s, angle = samples.t_s[which], np.radians(samples.angle_deg[which])
        if len(which) < 2 * _TAIL or t_s[0] > 0.0:
            continue
        begin = float(angle[t_s <= 0.0].mean())
        turn = float(angle[-_TAIL:].mean()) - begin
        rest_deg = float(np.degrees(np.ptp(angle[-_TAIL:])))
        steps.append(Step(t_s, (angle - begin) * np.sign(turn), abs(turn), rest_deg))
    return steps


def _fit(samples: TravelSamples, servo_id: int) -> TravelFit:
    n_given = len(np.unique(samples.step[samples.servo_id == servo_id]))
    steps = [step for step in steps_of(samples, servo_id) if step.turn_rad > math.radians(3.0)]
    n_samples = sum(len(step.t_s) for step in steps)
    largest = math.degrees(max([step.turn_rad for step in steps], default=0.0))
    nothing = TravelFit(servo_id, "", (), len(steps), n_samples, largest)
    early = [
        Limit(len(steps), 4, 2, "{:.0f} steps from rest to rest", True),
        Limit(n_given - len(steps), 0, n_given / 2, "{:.0f} steps without rest before and after"),
        Limit(largest, 60.0, 20.0, "the largest step turns {:.1f} deg", True),
    ]
    if judge(early).is_refused:
        return _judged(nothing, judge(early))
    spacing_s = float(np.median(np.concatenate([np.diff(step.t_s) for step in steps])))
    unrest_deg = max(step.rest_deg for step in steps)
    early.append(Limit(spacing_s, 0.5 * _SPACING_S, _SPACING_S, "samples {:.3f} s apart"))
    early.append(Limit(unrest_deg, 0.7, 2.0, "a step still moves by {:.1f} deg at its end"))
    if judge(early).is_refused:
        return _judged(nothing, judge(early))
    found = _with_model(nothing, _best(steps), steps)
    limits = [
        Limit(found.residual_deg, 0.7, 2.5, "residual {:.2f} deg"),
        Limit(found.sd_rate_rad_s / found.rate_rad_s, 0.03, 0.15, "sd of the rate {:.1%}"),
        Limit(found.arrival_s, 0.02, 0.08, "arrivals are {:.3f} s off the predicted ones"),
        Limit(abs(found.dead_s), 0.15, 0.5, "dead time {:.3f} s"),
    ]
    return _judged(found, judge([*early, *limits]))


def _judged(found: TravelFit, verdict: Verdict) -> TravelFit:
    reasons = list(verdict.reasons)
    grade = verdict.grade
    if not verdict.is_refused and found.dead_s < -0.005:
        reasons.append(f"it moves {-found.dead_s:.3f} s before the command: are the clocks one?")
        grade = worst([grade, WARN])
    return replace(found, verdict=grade, reasons=tuple(reasons))


def _best(steps: Sequence[Step]) -> Fitted:
    """Return the better of both kinds; the lag where they are about as good."""
    t_s = np.concatenate([step.t_s for step in steps])
    way = np.concatenate([step.way_rad for step in steps])
    turn = np.concatenate([np.full(len(step.t_s), step.turn_rad) for step in steps])
    lag, trapezoid = (fit(t_s, way, turn, first_guess(kind, t_s, way, turn)) for kind in KINDS)
    is_better = rms(trapezoid.residual_rad) < _CHOICE * rms(lag.residual_rad)
    return trapezoid if is_better else lag


def _with_model(found: TravelFit, best: Fitted, steps: Sequence[Step]) -> TravelFit:
    travel, within = best.travel, math.radians(WITHIN_DEG)
    off = []
    for step in steps:
        arrived_s, gap_s = crossing(step.t_s, step.way_rad, step.turn_rad, within)
        # it arrived somewhere between two samples
        off.append(arrived_s - 0.5 * gap_s - travel.arrival_s(step.turn_rad, within))
    is_lag = travel.kind == LAG
    return replace(
        found,
        kind=travel.kind,
        dead_s=travel.dead_s,
        rate_rad_s=travel.rate_rad_s,
        accel_rad_s2=math.nan if is_lag else travel.shape,
        time_constant_s=travel.shape if is_lag else math.nan,
        sd_dead_s=best.sd_dead_s,
        sd_rate_rad_s=best.sd_rate_rad_s,
        residual_deg=math.degrees(rms(best.residual_rad)),
        arrival_s=rms(np.array(off)),
        late_s=float(np.max(off)),
    )
