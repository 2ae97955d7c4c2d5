"""The limits of motion, all in one function that every path passes before a byte is sent."""

from dataclasses import dataclass
from typing import Any, List, NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.arm_file import CLAMP, Limits
from firmware_bridge.clearance import clearances, told
from firmware_bridge.errors import MotionRefused
from firmware_bridge.kinematics import ArmModel

__all__ = ["CheckedPath", "Limits", "check_path"]

MAX_WAY_POINTS = 256
_MIN_SAMPLES = 8
_MAX_SAMPLE_RAD = 0.05
_MAX_SAMPLE_M = 0.011  # of the tip's way when one joint turns: a longer arm is sampled more often
_FINER = 8  # once more so fine where a limit is near, so that no dip between samples is missed
_LOST_RAD = 3.2  # farther beyond a limit no arm can stand
# Set-points reach a board up to 2 ms late: one of 0.1 s must catch up by 2 %, and ticks are whole.
_STREAM_SHARE = 0.95
_EPS_RAD = 1e-9
_EPS_M = 1e-9


@dataclass(frozen=True, eq=False)
class CheckedPath:
    """A path within all limits: ``knots_rad (w + 1, k)`` from the start, at ``knots_s (w + 1,)``.

    ``is_stretched`` when a segment was slowed down to respect a joint's rate; ``clamped`` says
    what else was changed, and is empty unless the limits' mode is "clamp".
    """

    knots_rad: Array
    knots_s: Array
    is_stretched: bool
    clamped: Tuple[str, ...] = ()

    @property
    def total_s(self) -> float:
        """Duration of the whole path."""
        return float(self.knots_s[-1])

    def at(self, path_s: float) -> Array:
        """Return the joints (k,) after ``path_s`` seconds, held at both ends."""
        columns = self.knots_rad.T
        return np.array([np.interp(path_s, self.knots_s, column) for column in columns])


class _Fault(NamedTuple):
    """Where a path first breaks a limit of space: after ``share`` of segment ``segment``."""

    segment: int
    share: float
    what: str


def check_path(
    arm: ArmModel,
    q_from: Array,
    joints_rad: Array,
    duration_s: Array,
    limits: Optional[Limits] = None,
    now_s: Optional[float] = None,
    deadline_s: Optional[float] = None,
) -> CheckedPath:
    """Accept a path of straight joint-space segments, slowed to the arm's rates, or refuse it.

    Parameters
    ----------
    q_from : joints (k,) the path starts from.
    joints_rad : way-points (w, k), 1 <= w <= 256.
    duration_s : time of each segment (w,), stretched where a joint would be too fast.
    limits : the arm's own (``arm.workspace``) when None. In mode "clamp" joints, steps and
        durations are brought to their limits and a path that would touch something ends before it;
        ``CheckedPath.clamped`` says so. What is not finite or of the wrong shape is never mended.
    now_s, deadline_s : on one clock; a path whose deadline has passed is refused.

    Raises
    ------
    MotionRefused : shape, not finite, joint limit, step, duration, table, workspace, base, the arm
        itself or the deadline; the message names the way-point, the joint or point, what was found
        and what is allowed.
    """
    bounds = limits if limits is not None else arm.workspace
    start, goals, times = _checked_shape(arm, q_from, joints_rad, duration_s)
    changes: List[str] = []
    goals = _within_limits(arm, start, goals, bounds, changes)
    knots = _within_steps(arm, np.vstack([start, goals]), bounds, changes)
    times = _within_durations(times, bounds, changes)
    needed = (np.abs(np.diff(knots, axis=0)) / (_STREAM_SHARE * arm.rate_rad_s)).max(axis=1)
    if not needed.max() <= max(bounds.max_duration_s, times.max()):
        raise MotionRefused(
            f"way-point {np.argmax(needed)}: needs {needed.max():.4g} s at the arm's rates, "
            f"at most {bounds.max_duration_s} s are allowed"
        )
    safe = np.maximum(times, needed)
    is_stretched = bool((needed > times + _EPS_RAD).any())
    fault = first_fault(arm, knots, bounds)
    if fault is not None:
        knots, safe = _cut(knots, safe, fault, bounds, changes)
    _check_deadline(now_s, deadline_s)
    knots_s = np.concatenate([[0.0], np.cumsum(safe)])
    return CheckedPath(knots, knots_s, is_stretched, tuple(changes))


def _checked_shape(arm: ArmModel, *given: Any) -> Tuple[Array, Array, Array]:
    start, goals, times = (_numbers(each) for each in given)
    k = arm.n_joints
    is_path = goals.ndim == 2 and 1 <= len(goals) <= MAX_WAY_POINTS and goals.shape[1] == k
    if not is_path or times.shape != (len(goals),) or start.shape != (k,):
        raise MotionRefused(
            f"a path needs joints (w, {k}), w in 1..{MAX_WAY_POINTS}, durations (w,) and a start "
            f"({k},); found {goals.shape}, {times.shape}, {start.shape}"
        )
    for name, values in (("start", start), ("joints_rad", goals), ("duration_s", times)):
        if not np.isfinite(values).all():
            raise MotionRefused(f"{name} is not finite: {_few(values)}")
    low, high = arm.limits_rad[:, 0] - _LOST_RAD, arm.limits_rad[:, 1] + _LOST_RAD
    if not ((start >= low) & (start <= high)).all():
        raise MotionRefused(f"start = {_few(start)} rad: no arm stands so far beyond its limits")
    return start, goals, times


def _numbers(values: Any) -> Array:
    """Return values as an array of floats; whatever is none is refused."""
    try:
        raw = values if isinstance(values, np.ndarray) else np.asarray(values, dtype=np.float64)
        if raw.dtype.kind not in "fiu":
            raise MotionRefused(f"a path needs numbers, found an array of {raw.dtype}")
        with np.errstate(all="ignore"):  # a wide float that no double holds becomes inf
            numbers: Array = np.asarray(raw, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise MotionRefused(f"a path needs numbers: {error}") from None
    return numbers


def _few(values: Array) -> str:
    """Return the first few values as text."""
    flat = values.ravel()
    return f"{flat[:8].tolist()}{' ...' if flat.size > 8 else ''}"


def _refuse_or_note(bounds: Limits, what: str, changes: List[str]) -> None:
    if bounds.mode != CLAMP:
        raise MotionRefused(what)
    changes.append(what)


def _within_limits(
    arm: ArmModel, start: Array, goals: Array, bounds: Limits, changes: List[str]
) -> Array:
    low, high = arm.limits_rad[:, 0], arm.limits_rad[:, 1]
    bad = np.argwhere((goals < low - _EPS_RAD) | (goals > high + _EPS_RAD))
    for w, j in bad:
        _refuse_or_note(
            bounds,
            f"way-point {w}: {arm.joint_names[j]} = {goals[w, j]:.4g} rad is outside "
            f"[{low[j]:.4f}, {high[j]:.4f}]",
            changes,
        )
    kept: Array = np.clip(goals, low, high) if len(bad) else goals
    return kept


def _within_steps(arm: ArmModel, knots: Array, bounds: Limits, changes: List[str]) -> Array:
    most = bounds.max_step_rad
    for w in range(len(knots) - 1):
        step = knots[w + 1] - knots[w]
        j = int(np.argmax(np.abs(step)))
        if abs(step[j]) > most:
            _refuse_or_note(
                bounds,
                f"way-point {w}: {arm.joint_names[j]} turns {abs(step[j]):.4g} rad in one step, "
                f"at most {most} is allowed",
                changes,
            )
            knots[w + 1] = knots[w] + step * (most / abs(step[j]))
    return knots


def _within_durations(times: Array, bounds: Limits, changes: List[str]) -> Array:
    most = bounds.max_duration_s
    is_good = (times > 0.0) & (times <= most)
    if is_good.all():
        return times
    _refuse_or_note(bounds, f"duration_s = {_few(times)}: each must be in (0, {most}]", changes)
    kept: Array = np.clip(times, 0.001, most)
    return kept


def _check_deadline(now_s: Optional[float], deadline_s: Optional[float]) -> None:
    if deadline_s is None:
        return
    now = _numbers(np.nan if now_s is None else now_s)
    due = _numbers(deadline_s)
    # written so that NaN is refused; inf is no deadline that anybody can have meant
    if now.shape or due.shape or not (np.isfinite(due) and now < due):
        raise MotionRefused(f"the deadline has passed: it was {deadline_s} s, now it is {now_s} s")


def first_fault(arm: ArmModel, knots_rad: Array, bounds: Limits) -> Optional[_Fault]:
    """Return where a path of knots (w + 1, k) first breaks a limit of space, None when nowhere.

    The start is left out, for the arm is there already and must get away.
    """
    turn = np.abs(np.diff(knots_rad, axis=0))
    spacing = min(_MAX_SAMPLE_RAD, _MAX_SAMPLE_M / arm.links.reach_m)
    counts = np.maximum(_MIN_SAMPLES, np.ceil(turn.max(axis=1) / spacing).astype(int) + 1)
    segment = np.repeat(np.arange(len(counts)), counts)
    order = np.arange(len(segment)) - np.repeat(np.cumsum(counts) - counts, counts) + 1
    count = counts[segment]
    points, room = _look(arm, knots_rad, segment, order / count, bounds)
    is_bad = room < -_EPS_M
    if is_bad.any():
        at = int(np.argmax(is_bad.any(axis=1)))
        what = told(int(np.argmin(room[at])), room[at].min(), points[at], bounds)
        return _Fault(int(segment[at]), float((order[at] - 1) / count[at]), what)
    # between samples a point leaves the chord by no more than this
    sag = arm.links.reach_m * (turn.sum(axis=1) / counts) ** 2 / 8.0
    near = np.flatnonzero(_is_near(points, room, sag[segment]))
    if not len(near):
        return None
    inner = np.arange(1, _FINER) / _FINER - 1.0
    share = ((order[near, None] + inner) / count[near, None]).ravel()
    before = np.repeat((order[near] - 1) / count[near], _FINER - 1)
    segment = np.repeat(segment[near], _FINER - 1)
    points, room = _look(arm, knots_rad, segment, share, bounds)
    is_bad = room < -_EPS_M
    is_bad &= ~_is_getting_away(arm, knots_rad, (segment == 0) & (before <= 0.0), room, bounds)
    if not is_bad.any():
        return None
    at = int(np.argmax(is_bad.any(axis=1)))
    worst = int(np.argmin(np.where(is_bad[at], room[at], np.inf)))
    what = told(worst, room[at, worst], points[at], bounds)
    return _Fault(int(segment[at]), float(before[at]), what)


def _look(
    arm: ArmModel, knots: Array, segment: Array, share: Array, bounds: Limits
) -> Tuple[Array, Array]:
    """Return points (n, 4, 3) and clearances (n, 10) after shares (n,) of segments (n,)."""
    begin = knots[segment]
    points = arm.forward(begin + (knots[segment + 1] - begin) * share[:, None])
    return points, clearances(arm, points, bounds)


def _is_near(points: Array, room: Array, sag_m: Array) -> Array:
    """Say before which samples (n,) a limit may have been broken, though not at them."""
    way = np.full(len(points), np.inf)
    way[1:] = np.sqrt(((points[1:] - points[:-1]) ** 2).sum(axis=2)).max(axis=1)
    before = np.zeros_like(room)
    before[1:] = room[:-1]
    room = np.minimum(room, before)
    # table and box are planes; what is round may come nearer to the middle of a chord
    near: Array = (room[:, :6].min(axis=1) < sag_m) | (room[:, 6:].min(axis=1) < way + 2.0 * sag_m)
    return near


def _is_getting_away(
    arm: ArmModel, knots: Array, is_first: Array, room: Array, bounds: Limits
) -> Array:
    """Say where (n, 10) an arm that starts beyond a limit comes no farther beyond it."""
    if not is_first.any():
        return np.zeros(room.shape, dtype=bool)
    at_start = clearances(arm, arm.forward(knots[:1]), bounds)
    is_allowed: Array = is_first[:, None] & (room >= at_start - _EPS_M)
    return is_allowed & (at_start < 0.0)


def _cut(
    knots: Array, times: Array, fault: _Fault, bounds: Limits, changes: List[str]
) -> Tuple[Array, Array]:
    """Refuse the path, or in mode "clamp" let it end at the last sample before the fault."""
    w, share = fault.segment, fault.share
    what = f"way-point {w}: {fault.what}"
    if bounds.mode != CLAMP or (w == 0 and share <= 0.0):
        raise MotionRefused(what)
    changes.append(f"{what}; the path ends before it")
    if share <= 0.0:
        return knots[: w + 1], times[:w]
    last = knots[w] + (knots[w + 1] - knots[w]) * share
    return np.vstack([knots[: w + 1], last]), np.append(times[:w], times[w] * share)
