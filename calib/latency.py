"""Camera latency: how far the response in the frames lags behind a signal of known time.

The signal is a blinking light or a moving target; the response is the brightness or the position
seen in each frame, on the stamp the frame got. The lag that explains the response best is the
latency from mid-exposure to the stamp, plus whatever delays the signal itself (a display, servos).
Source: ours.
"""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, NamedTuple, Tuple

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from calib.csv_rows import MAX_NUMBER, read_numbers
from calib.spread import jackknife_sd
from calib.verdict import REFUSE, Limit, Verdict, judge, known, worst

MIN_FRAMES, WANTED_FRAMES = 40, 150
MIN_CHANGES, WANTED_CHANGES = 6, 15
GOOD_SHARE, REFUSED_SHARE = 0.8, 0.5
GOOD_SD_S, REFUSED_SD_S = 0.005, 0.02
MAX_LATENCY_S = 2.0  # what [camera] latency_s may be
MAX_DURATION_S = 900.0
_EARLY_S = 0.1  # searched before zero, so that clocks that disagree are noticed
_GRID_S = 0.001
_COARSE_S = 0.002
_RIVAL = 0.85  # another lag that explains this share of what the best does is as good
_N_BLOCKS = 10


@dataclass(frozen=True)
class LatencyResult:
    """``latency_s`` with its sd by the jackknife over parts of the recording.

    ``explained`` is the share of the response's changes that the delayed signal explains;
    ``rival`` that of the best other lag, at ``rival_s``; ``exposure_s`` the smear that fits.
    ``curve`` (g, 2) holds lag and explained share. NaN where not known.
    """

    verdict: Verdict
    latency_s: float
    sd_s: float
    explained: float
    rival: float
    rival_s: float
    exposure_s: float
    frame_period_s: float
    n_frames: int
    n_changes: int
    curve: Array

    def figures(self) -> Dict[str, Any]:
        """Return all figures as plain values, for the file and for ``--json``; null: not known."""
        values = known(asdict(self))
        del values["verdict"], values["curve"]
        return {**self.verdict.plain(), **values}


class _Fit(NamedTuple):
    lags_s: Array
    share: Array
    width_s: float


def read_series(path: Path) -> Tuple[Array, Array]:
    """Read a file of t_s, value below a header line: two arrays (n,).

    Raises
    ------
    CalibrationError : unreadable, not two finite numbers a row, or times that go backwards.
    """
    rows = read_numbers(path, 2)
    back = np.flatnonzero(np.diff(rows[:, 0]) < 0.0)
    if len(back):
        row = int(back[0]) + 1
        raise CalibrationError(
            f"{path}: row {row + 1}: t_s = {rows[row, 0]:.6f} is before {rows[row - 1, 0]:.6f} of "
            "the row above; the clock must not go backwards"
        )
    return rows[:, 0], rows[:, 1]


def solve(
    signal: Tuple[Array, Array], response: Tuple[Array, Array], max_latency_s: float = 0.5
) -> LatencyResult:
    """Find the lag of a response behind a signal.

    Parameters
    ----------
    signal : times (m,) in s and values (m,). Two different values are a blinker, which holds each
        until the next; more are samples of a motion, joined by straight lines.
    response : stamps (n,) of the frames on the same clock, and what each shows (n,).
    max_latency_s : longest lag that is looked for.

    Raises
    ------
    CalibrationError : shapes, values that are not finite, times that go backwards.
    """
    t_signal, values = _checked("signal", *signal)
    t_frame, seen = _checked("frames", *response)
    if not 0.01 <= max_latency_s <= MAX_LATENCY_S:
        raise CalibrationError(
            f"max latency {max_latency_s:g} s is outside [0.01, {MAX_LATENCY_S}]"
        )
    n_changes = _count_changes(values)
    inside = (t_frame >= t_signal[0] + max_latency_s) & (t_frame <= t_signal[-1] - _EARLY_S)
    if len(np.unique(values)) <= 2:  # a blinker holds its last value
        inside = (t_frame >= t_signal[0] - _EARLY_S) & (t_frame <= t_signal[-1] + max_latency_s)
    t_used, used = t_frame[inside], seen[inside]
    early = judge(
        [
            Limit(
                len(t_used),
                WANTED_FRAMES,
                MIN_FRAMES,
                f"{{:.0f}} of {len(t_frame)} frames while the signal ran",
                True,
            ),
            Limit(n_changes, WANTED_CHANGES, MIN_CHANGES, "{:.0f} changes of the signal", True),
        ]
    )
    period_s = float(np.median(np.diff(t_used))) if len(t_used) > 1 else math.nan
    if early.is_refused:
        return _nothing(early, period_s, len(t_used), n_changes)
    if np.ptp(used) <= 1e-9 * max(1.0, float(np.abs(used).max())):
        why = Verdict(REFUSE, ("the frames show no change at all: is the signal in view?",))
        return _nothing(why, period_s, len(t_used), n_changes)
    model = _Signal(t_signal, values)
    best = _search(model, t_used, used, max_latency_s, period_s)
    return _judged(early, model, (t_used, used), best, (period_s, n_changes))


def _checked(name: str, times: Array, values: Array) -> Tuple[Array, Array]:
    t_s, found = np.asarray(times, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if t_s.ndim != 1 or t_s.shape != found.shape or len(t_s) < 2:
        raise CalibrationError(
            f"{name}: times and values must be two equal rows of 2 or more, found {t_s.shape} "
            f"and {found.shape}"
        )
    # written so that NaN is refused
    if not (np.abs(np.concatenate([t_s, found])) <= MAX_NUMBER).all():
        raise CalibrationError(f"{name}: times and values must be finite, up to {MAX_NUMBER:g}")
    if (np.diff(t_s) < 0.0).any():
        raise CalibrationError(f"{name}: the clock goes backwards")
    if not 0.0 < t_s[-1] - t_s[0] <= MAX_DURATION_S:
        raise CalibrationError(
            f"{name}: lasts {t_s[-1] - t_s[0]:.5g} s, expected up to {MAX_DURATION_S:g} s; "
            "are the times in seconds?"
        )
    return t_s, found


def _count_changes(values: Array) -> int:
    """Count how often the signal crosses its middle."""
    above = values > 0.5 * (values.min() + values.max())
    return int(np.count_nonzero(np.diff(above)))


class _Signal:
    """The signal's running integral, so that its mean over any exposure is one subtraction."""

    def __init__(self, t_s: Array, values: Array) -> None:
        self._t = np.arange(t_s[0] - 3.0, t_s[-1] + 3.0, _GRID_S)
        middle = self._t + 0.5 * _GRID_S
        if len(np.unique(values)) <= 2:
            at = np.clip(np.searchsorted(t_s, middle, side="right") - 1, 0, len(values) - 1)
            dense = values[at]
        else:
            dense = np.interp(middle, t_s, values)
        self._sum = np.concatenate([[0.0], np.cumsum(dense[:-1]) * _GRID_S])

    def seen(self, t_s: Array, width_s: float) -> Array:
        """Return the mean over exposures of ``width_s`` around times of any shape."""
        late = np.interp(t_s + 0.5 * width_s, self._t, self._sum)
        result: Array = (late - np.interp(t_s - 0.5 * width_s, self._t, self._sum)) / width_s
        return result


def _search(model: _Signal, t_s: Array, seen: Array, max_latency_s: float, period_s: float) -> _Fit:
    """Try all lags and a few exposures; return the shares explained with the best exposure."""
    lags = np.arange(-_EARLY_S, max_latency_s + _COARSE_S, _COARSE_S)
    fits = []
    for part in (0.1, 0.35, 0.7, 1.0):
        width_s = max(part * min(period_s, 0.2), 2.0 * _GRID_S)
        fits.append(_Fit(lags, _explained(model, t_s, seen, lags, width_s), width_s))
    return max(fits, key=lambda fit: float(fit.share.max()))


def _explained(model: _Signal, t_s: Array, seen: Array, lags: Array, width_s: float) -> Array:
    """Return the share (g,) of the response that the signal explains at each lag.

    A slow drift of the brightness (a parabola over time) is taken out of both before. The sign is
    free: a target may move to the left when the arm turns to the right.
    """
    unit = 2.0 * (t_s - t_s[0]) / (t_s[-1] - t_s[0]) - 1.0
    drift, _ = np.linalg.qr(np.column_stack([np.ones(len(unit)), unit, unit**2]))
    rest = seen - drift @ (drift.T @ seen)
    shown = model.seen(t_s[:, None] - lags[None, :], width_s)
    shown = shown - drift @ (drift.T @ shown)
    power = (shown**2).sum(axis=0) * float(rest @ rest)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(power > 1e-30, (rest @ shown) ** 2 / power, 0.0)
    result: Array = share
    return result


def _peak_s(model: _Signal, t_s: Array, seen: Array, near_s: float, width_s: float) -> float:
    """Return the best lag close to a coarse one, by a parabola through the top of a fine grid."""
    lags = near_s + np.arange(-12, 13) * 0.0005
    share = _explained(model, t_s, seen, lags, width_s)
    top = int(np.argmax(share))
    if not 0 < top < len(lags) - 1:
        return float(lags[top])
    low, mid, high = share[top - 1 : top + 2]
    bend = low - 2.0 * mid + high
    offset = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
    return float(lags[top] + offset * 0.0005)


def _judged(
    early: Verdict,
    model: _Signal,
    frames: Tuple[Array, Array],
    fit: _Fit,
    counts: Tuple[float, int],
) -> LatencyResult:
    t_s, seen = frames
    top = int(np.argmax(fit.share))
    latency_s = _peak_s(model, t_s, seen, float(fit.lags_s[top]), fit.width_s)
    sd_s = _jackknife_s(model, t_s, seen, latency_s, fit.width_s)
    rival, rival_s = _rival(fit, top)
    explained = float(fit.share[top])
    is_edge = top in (0, len(fit.share) - 1)
    limits = [
        Limit(
            explained,
            GOOD_SHARE,
            REFUSED_SHARE,
            "the delayed signal explains only {:.0%} of what the frames show",
            True,
        ),
        Limit(sd_s, GOOD_SD_S, REFUSED_SD_S, "uncertain by {:.4f} s (sd)"),
        Limit(
            latency_s,
            -GOOD_SD_S,
            -REFUSED_SD_S,
            "the frames show the signal {:.3f} s after it was given: two clocks?",
            True,
        ),
    ]
    reasons = list(early.reasons)
    measured = judge(limits)
    reasons += measured.reasons
    grade = worst([early.grade, measured.grade])
    if is_edge:
        grade = REFUSE
        reasons.append(f"the best lag {latency_s:.3f} s is at the edge of what was searched")
    if rival > _RIVAL * explained:
        grade = REFUSE
        reasons.append(
            f"ambiguous: {rival_s:.3f} s fits about as well as {latency_s:.3f} s; the signal "
            "repeats too soon, blink at random or move more slowly"
        )
    return LatencyResult(
        Verdict(grade, tuple(reasons)),
        latency_s,
        sd_s,
        explained,
        rival,
        rival_s,
        fit.width_s,
        counts[0],
        len(t_s),
        counts[1],
        np.column_stack([fit.lags_s, fit.share]),
    )


def _rival(fit: _Fit, top: int) -> Tuple[float, float]:
    """Return the share and lag of the best fit outside the peak itself; NaN when there is none.

    The peak ends where the share has fallen to half of its top.
    """
    low = fit.share < 0.5 * fit.share[top]
    before, after = np.flatnonzero(low[:top]), np.flatnonzero(low[top:])
    outside = np.zeros(len(low), dtype=bool)
    if len(before):
        outside[: before[-1]] = True
    if len(after):
        outside[top + after[0] :] = True
    if not outside.any():
        return math.nan, math.nan
    best = int(np.argmax(np.where(outside, fit.share, -1.0)))
    return float(fit.share[best]), float(fit.lags_s[best])


def _jackknife_s(
    model: _Signal, t_s: Array, seen: Array, latency_s: float, width_s: float
) -> float:
    """Return the sd of the lag from leaving out one part of the recording at a time."""
    block = np.arange(len(t_s)) * _N_BLOCKS // len(t_s)
    found = np.array(
        [
            _peak_s(model, t_s[block != b], seen[block != b], latency_s, width_s)
            for b in range(_N_BLOCKS)
        ]
    )
    return float(jackknife_sd(found))


def _nothing(verdict: Verdict, period_s: float, n_frames: int, n_changes: int) -> LatencyResult:
    nan = math.nan
    return LatencyResult(
        verdict, nan, nan, nan, nan, nan, nan, period_s, n_frames, n_changes, np.zeros((0, 2))
    )
