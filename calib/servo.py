"""Servo position <-> joint angle from protractor readings, approached from both directions.

Positions are ticks, the unit of the servo's protocol (a pulse in us, a step of a turn). They are
exact and the reading is not, so the angle is fitted over the ticks; each direction of
approach has its own offset, and twice that is the backlash. Source: ours.
"""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from calib.csv_rows import read_cells
from calib.spread import rms
from calib.verdict import WARN, Limit, Verdict, judge, known, worst
from firmware_bridge.kinematics import PULSE_MAX_US, PULSE_MIN_US

COLUMNS = ("servo_id", "ticks", "angle_deg", "direction")
UP, DOWN = "up", "down"
MIN_SAMPLES, WANTED_SAMPLES = 6, 10
GOOD_DEG, REFUSED_DEG = 0.5, 2.0
MIN_SPAN_DEG, WANTED_SPAN_DEG = 30.0, 60.0
PWM_TICKS = (PULSE_MIN_US, PULSE_MAX_US)
_CLEAR_SHARE = 0.01  # of what the servo takes: nearer positions give no slope
_MIN_OFF_DEG = 1.5  # a protractor is read to half a degree: nothing nearer is an outlier
_GATE_SD = 4.0


@dataclass(frozen=True)
class ServoSamples:
    """Readings (n,): ``is_up`` when the position was approached from below; ``row`` from 1."""

    servo_id: Array
    ticks: Array
    angle_deg: Array
    is_up: Array
    row: Array

    def pick(self, which: Array) -> "ServoSamples":
        """Return some of the readings, by mask or index."""
        return ServoSamples(*(getattr(self, name)[which] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class ServoFit:
    """One servo: ``ticks = zero_ticks + ticks_per_rad * angle``, midway between both directions.

    Residuals are RMS in degrees, ``left_out_deg`` that of readings predicted by the others;
    ``bend_deg`` how far a curve through the readings leaves the line at its ends. NaN: not known.
    """

    servo_id: int
    verdict: str
    reasons: Tuple[str, ...]
    span_deg: float
    n_samples: int
    rejected: Tuple[Tuple[int, str], ...]
    zero_ticks: float = math.nan
    ticks_per_rad: float = math.nan
    sd_zero_ticks: float = math.nan
    sd_ticks_per_rad: float = math.nan
    backlash_deg: float = math.nan
    sd_backlash_deg: float = math.nan
    residual_up_deg: float = math.nan
    residual_down_deg: float = math.nan
    left_out_deg: float = math.nan
    bend_deg: float = math.nan

    def plain(self) -> Dict[str, Any]:
        """Return it as plain values, with null for what is not known."""
        rejected = [{"row": row, "reason": why} for row, why in self.rejected]
        return {**known(asdict(self)), "reasons": list(self.reasons), "rejected": rejected}


class _Line(NamedTuple):
    """A least-squares fit: ``beta (p,)``, its covariance, residuals and leverages (n,)."""

    beta: Array
    cov: Array
    residual: Array
    leverage: Array


def read_samples(path: Path, ticks_range: Tuple[int, int] = PWM_TICKS) -> ServoSamples:
    """Read a file of servo_id, ticks, angle_deg, direction (up or down) below a header line.

    Raises
    ------
    CalibrationError : unreadable, or a row that is not of that form or out of range.
    """
    rows = [
        _sample(f"{path}: row {index + 1}", cells, ticks_range)
        for index, cells in enumerate(read_cells(path, 4)[1:])
    ]
    if not rows:
        raise CalibrationError(f"{path}: no sample in the file")
    ids, positions, angles, ups = zip(*rows)
    return ServoSamples(
        np.array(ids),
        np.array(positions),
        np.array(angles),
        np.array(ups),
        np.arange(1, len(rows) + 1),
    )


def samples_text(samples: ServoSamples) -> str:
    """Return samples as the text of a file that ``read_samples`` reads."""
    lines = [",".join(COLUMNS)]
    for i in range(len(samples.row)):
        direction = UP if samples.is_up[i] else DOWN
        lines.append(
            f"{samples.servo_id[i]},{samples.ticks[i]:g},{samples.angle_deg[i]:g},{direction}"
        )
    return "\n".join(lines) + "\n"


def _sample(
    where: str, cells: List[str], ticks_range: Tuple[int, int]
) -> Tuple[int, float, float, bool]:
    try:
        servo_id, ticks, angle_deg = int(cells[0]), float(cells[1]), float(cells[2])
    except ValueError:
        raise CalibrationError(
            f"{where}: expected servo_id, ticks, angle_deg, direction; found {cells}"
        ) from None
    if cells[3].lower() not in (UP, DOWN):
        raise CalibrationError(f"{where}: direction must be up or down, found {cells[3]!r}")
    # written so that NaN is refused
    if not ticks_range[0] <= ticks <= ticks_range[1]:
        raise CalibrationError(
            f"{where}: ticks = {ticks:g} is outside [{ticks_range[0]}, {ticks_range[1]}]"
        )
    if not -360.0 <= angle_deg <= 360.0:
        raise CalibrationError(f"{where}: angle_deg = {angle_deg:g} is outside [-360, 360]")
    return servo_id, ticks, angle_deg, cells[3].lower() == UP


def solve(samples: ServoSamples, ticks_range: Tuple[int, int] = PWM_TICKS) -> Tuple[ServoFit, ...]:
    """Fit each servo of the samples and judge it, in the order of their ids.

    ``ticks_range`` is what the servos take, lowest and highest.
    """
    ids = np.unique(samples.servo_id)
    return tuple(_fit(samples.pick(samples.servo_id == each), ticks_range) for each in ids)


def overall(fits: Sequence[ServoFit]) -> Verdict:
    """Return the worst verdict of all servos, with every reason and whose it is."""
    reasons = [f"servo {fit.servo_id}: {reason}" for fit in fits for reason in fit.reasons]
    return Verdict(worst([fit.verdict for fit in fits]), tuple(reasons))


def _fit(samples: ServoSamples, ticks_range: Tuple[int, int]) -> ServoFit:
    span_deg = float(np.ptp(samples.angle_deg))
    clear = _CLEAR_SHARE * (ticks_range[1] - ticks_range[0])
    early = [
        Limit(len(samples.row), WANTED_SAMPLES, MIN_SAMPLES, "{:.0f} readings", True),
        Limit(span_deg, WANTED_SPAN_DEG, MIN_SPAN_DEG, "readings span {:.1f} deg", True),
        Limit(
            _one_way_share(samples, clear),
            0.95,
            0.85,
            "the angle follows the ticks one way in only {:.0%} of all pairs of readings",
            True,
        ),
    ]
    off = _off_deg(samples, clear)
    kept = _agreeing(off)
    used = samples.pick(kept)
    fit = ServoFit(
        int(samples.servo_id[0]), "", (), span_deg, len(samples.row), _rejected(samples, kept, off)
    )
    if judge(early).is_refused or kept.sum() < MIN_SAMPLES:
        lost = [Limit(float(kept.sum()), MIN_SAMPLES, MIN_SAMPLES, "{:.0f} readings agree", True)]
        return _judged(fit, judge(early + lost))
    fit = _with_line(fit, used)
    bend_deg, is_bent = _bend(used)
    fit = replace(fit, bend_deg=bend_deg)
    verdict = judge([*early, *_limits(fit, 1.0 - kept.mean(), ticks_range)])
    reasons = list(verdict.reasons)
    if not math.isfinite(fit.backlash_deg):
        reasons.append(
            f"approached {UP if used.is_up.any() else DOWN} only: the backlash is not known"
        )
    if is_bent:
        reasons.append(f"ticks and angle are not on a line: {bend_deg:.2f} deg at the ends")
    grade = worst([verdict.grade, *([WARN] if reasons else [])])
    return _judged(fit, Verdict(grade, tuple(reasons)))


def _judged(fit: ServoFit, verdict: Verdict) -> ServoFit:
    return replace(fit, verdict=verdict.grade, reasons=tuple(verdict.reasons))


def _with_line(fit: ServoFit, used: ServoSamples) -> ServoFit:
    line = _least_squares(_design(used), used.angle_deg)
    offset, slope = line.beta[0], line.beta[1]
    is_both = len(line.beta) > 2
    ticks_per_rad = math.degrees(1.0) / slope
    to_zero = np.array([-1.0 / slope, offset / slope**2])
    return replace(
        fit,
        zero_ticks=float(-offset / slope),
        ticks_per_rad=float(ticks_per_rad),
        sd_zero_ticks=math.sqrt(to_zero @ line.cov[:2, :2] @ to_zero),
        sd_ticks_per_rad=float(abs(ticks_per_rad / slope)) * math.sqrt(line.cov[1, 1]),
        backlash_deg=2.0 * abs(float(line.beta[2])) if is_both else math.nan,
        sd_backlash_deg=2.0 * math.sqrt(line.cov[2, 2]) if is_both else math.nan,
        residual_up_deg=rms(line.residual[used.is_up]),
        residual_down_deg=rms(line.residual[~used.is_up]),
        left_out_deg=rms(line.residual / np.maximum(1.0 - line.leverage, 1e-6)),
    )


def _rejected(samples: ServoSamples, kept: Array, off: Array) -> Tuple[Tuple[int, str], ...]:
    return tuple(
        (int(samples.row[i]), f"{off[i]:+.1f} deg off the line of the others")
        for i in np.flatnonzero(~kept)
    )


def _limits(fit: ServoFit, rejected_share: float, ticks_range: Tuple[int, int]) -> List[Limit]:
    span, middle = ticks_range[1] - ticks_range[0], 0.5 * (ticks_range[0] + ticks_range[1])
    residuals = (
        (UP, fit.residual_up_deg),
        (DOWN, fit.residual_down_deg),
        ("left out", fit.left_out_deg),
    )
    limits = [
        Limit(residual, GOOD_DEG, REFUSED_DEG, "residual {:.2f} deg, " + name)
        for name, residual in residuals
        if math.isfinite(residual)
    ]
    if math.isfinite(fit.backlash_deg):
        limits.append(Limit(fit.backlash_deg, 2.0, 8.0, "backlash {:.2f} deg"))
    limits += [
        Limit(rejected_share, 0.1, 0.2, "{:.0%} of the readings contradict the others"),
        Limit(abs(fit.ticks_per_rad), span, span, "{:.0f} ticks per rad; angles in radians?"),
        Limit(
            abs(fit.zero_ticks - middle),
            0.75 * span,
            1.25 * span,
            "angle 0 is {:.0f} ticks off the middle",
        ),
    ]
    return limits


def _design(samples: ServoSamples) -> Array:
    """Return the columns 1, ticks and, where both directions occur, the direction's sign."""
    columns = [np.ones(len(samples.row)), samples.ticks]
    if samples.is_up.any() and not samples.is_up.all():
        columns.append(np.where(samples.is_up, 1.0, -1.0))
    design: Array = np.column_stack(columns)
    return design


def _least_squares(design: Array, angle_deg: Array) -> _Line:
    centre = np.zeros(design.shape[1])
    centre[1] = design[:, 1].mean()  # ticks are far from zero: centred, the sums stay exact
    moved = design - centre
    inverse = np.linalg.pinv(moved.T @ moved)
    beta = inverse @ moved.T @ angle_deg
    residual = angle_deg - moved @ beta
    n_free = max(1, len(angle_deg) - design.shape[1])
    cov = inverse * float(residual @ residual) / n_free
    back = np.eye(design.shape[1])
    back[0, 1] = -centre[1]  # the constant at 0 ticks
    leverage = np.einsum("ij,jk,ik->i", moved, inverse, moved)
    return _Line(back @ beta, back @ cov @ back.T, residual, leverage)


def _pair_slopes(samples: ServoSamples, clear: float) -> Array:
    """Return the slopes (m,) between readings of one direction and clearly different ticks."""
    first, second = np.triu_indices(len(samples.row), k=1)
    step = samples.ticks[second] - samples.ticks[first]
    is_usable = (np.abs(step) >= clear) & (samples.is_up[first] == samples.is_up[second])
    rise = samples.angle_deg[second] - samples.angle_deg[first]
    slopes: Array = rise[is_usable] / step[is_usable]
    return slopes


def _one_way_share(samples: ServoSamples, clear: float) -> float:
    slopes = _pair_slopes(samples, clear)
    if not len(slopes):
        return 0.0
    return float(max(np.mean(slopes > 0.0), np.mean(slopes < 0.0)))


def _off_deg(samples: ServoSamples, clear: float) -> Array:
    """Return how far readings (n,) are from a robust line (Theil-Sen), one a direction."""
    slopes = _pair_slopes(samples, clear)
    left = samples.angle_deg - (np.median(slopes) if len(slopes) else 0.0) * samples.ticks
    off = np.zeros(len(left))
    for way in (samples.is_up, ~samples.is_up):
        if way.any():
            off[way] = left[way] - np.median(left[way])
    return off


def _agreeing(off_deg: Array) -> Array:
    off = np.abs(off_deg)
    kept: Array = off <= max(_GATE_SD * 1.4826 * float(np.median(off)), _MIN_OFF_DEG)
    return kept


def _bend(samples: ServoSamples) -> Tuple[float, bool]:
    """Return the curve's height at the ends in degrees, and whether it is there beyond doubt."""
    design = _design(samples)
    middle, half = samples.ticks.mean(), 0.5 * float(np.ptp(samples.ticks))
    if len(samples.row) <= design.shape[1] + 1 or half <= 0.0:
        return math.nan, False
    curve = ((samples.ticks - middle) / half) ** 2
    line = _least_squares(np.column_stack([design, curve]), samples.angle_deg)
    bend, sd = float(line.beta[-1]), math.sqrt(float(line.cov[-1, -1]))
    return bend, abs(bend) > max(3.0 * sd, GOOD_DEG)
