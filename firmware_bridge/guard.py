"""The limits of motion, all in one function that every path passes before a byte is sent."""

from dataclasses import dataclass
from typing import Optional

import numpy as np

from apex_edge.types import Array
from firmware_bridge.arm_file import Limits
from firmware_bridge.errors import MotionRefused
from firmware_bridge.kinematics import ArmModel

__all__ = ["CheckedPath", "Limits", "check_path"]

_POINTS = ("shoulder", "elbow", "wrist", "tip")
_MIN_SAMPLES = 8
_MAX_SAMPLE_RAD = 0.05  # the tip is at most 0.215 m away: samples are at most about 11 mm apart
_EPS_RAD = 1e-9


@dataclass(frozen=True, eq=False)
class CheckedPath:
    """A path within all limits: ``knots_rad (w + 1, k)`` from the start, at ``knots_s (w + 1,)``.

    ``is_stretched`` when a segment was slowed down to respect a joint's rate.
    """

    knots_rad: Array
    knots_s: Array
    is_stretched: bool

    @property
    def total_s(self) -> float:
        """Duration of the whole path."""
        return float(self.knots_s[-1])

    def at(self, path_s: float) -> Array:
        """Return the joints (k,) after ``path_s`` seconds, held at both ends."""
        columns = self.knots_rad.T
        return np.array([np.interp(path_s, self.knots_s, column) for column in columns])


def check_path(
    arm: ArmModel,
    q_from: Array,
    joints_rad: Array,
    duration_s: Array,
    limits: Optional[Limits] = None,
) -> CheckedPath:
    """Accept a path of straight joint-space segments, slowed to the arm's rates, or refuse it.

    Parameters
    ----------
    q_from : joints (k,) the path starts from.
    joints_rad : way-points (w, k), w >= 1.
    duration_s : time of each segment (w,), stretched where a joint would be too fast.

    Raises
    ------
    MotionRefused : shape, not finite, joint limit, step, duration, workspace, table or base; the
        message names the way-point, the joint or point, what was found and what is allowed.
    """
    bounds = limits if limits is not None else arm.workspace
    start = np.asarray(q_from, dtype=np.float64)
    goals = np.asarray(joints_rad, dtype=np.float64)
    times = np.asarray(duration_s, dtype=np.float64)
    _check_shape(arm, start, goals, times)
    _check_joints(arm, start, goals, bounds)
    if not ((times > 0.0) & (times <= bounds.max_duration_s)).all():
        raise MotionRefused(
            f"duration_s = {times.tolist()}: each must be in (0, {bounds.max_duration_s}]"
        )
    knots = np.vstack([start, goals])
    needed = (np.abs(np.diff(knots, axis=0)) / arm.rate_rad_s).max(axis=1)
    for segment in range(len(goals)):
        _check_segment(arm, knots[segment], knots[segment + 1], segment, bounds)
    safe = np.maximum(times, needed)
    knots_s = np.concatenate([[0.0], np.cumsum(safe)])
    return CheckedPath(knots, knots_s, bool((needed > times + _EPS_RAD).any()))


def _check_shape(arm: ArmModel, start: Array, goals: Array, times: Array) -> None:
    k = arm.n_joints
    is_path = goals.ndim == 2 and len(goals) >= 1 and goals.shape[1] == k
    if not is_path or times.shape != (len(goals),) or start.shape != (k,):
        raise MotionRefused(
            f"a path needs joints (w, {k}), durations (w,) and a start ({k},); "
            f"found {goals.shape}, {times.shape}, {start.shape}"
        )
    for name, values in (("start", start), ("joints_rad", goals), ("duration_s", times)):
        if not np.isfinite(values).all():
            raise MotionRefused(f"{name} is not finite: {values.tolist()}")


def _check_joints(arm: ArmModel, start: Array, goals: Array, bounds: Limits) -> None:
    low, high = arm.limits_rad[:, 0] - _EPS_RAD, arm.limits_rad[:, 1] + _EPS_RAD
    bad = np.argwhere((goals < low) | (goals > high))
    if len(bad):
        w, j = bad[0]
        raise MotionRefused(
            f"way-point {w}: {arm.joint_names[j]} = {goals[w, j]:.4g} rad is outside "
            f"[{arm.limits_rad[j, 0]:.4f}, {arm.limits_rad[j, 1]:.4f}]"
        )
    step = np.abs(np.diff(np.vstack([start, goals]), axis=0))
    bad = np.argwhere(step > bounds.max_step_rad)
    if len(bad):
        w, j = bad[0]
        raise MotionRefused(
            f"way-point {w}: {arm.joint_names[j]} turns {step[w, j]:.4g} rad in one step, "
            f"at most {bounds.max_step_rad} is allowed"
        )


def _check_segment(arm: ArmModel, begin: Array, end: Array, w: int, bounds: Limits) -> None:
    """Walk one segment; its start is left out, for the arm is there already and must get away."""
    n_samples = max(_MIN_SAMPLES, int(np.ceil(np.abs(end - begin).max() / _MAX_SAMPLE_RAD)) + 1)
    share = np.linspace(0.0, 1.0, n_samples + 1)[1:, None]
    points = arm.forward(begin + (end - begin) * share)[:, 1:]
    floor = np.array([bounds.min_link_z_m, bounds.min_link_z_m, bounds.min_tip_z_m])
    is_low = points[..., 2] < floor - _EPS_RAD
    if is_low.any():
        s, p = np.argwhere(is_low)[0]
        raise MotionRefused(
            f"way-point {w}: {_POINTS[p + 1]} comes to z = {points[s, p, 2]:.4f} m, "
            f"the table plane allows {floor[p]} m"
        )
    is_out = (points < np.array(bounds.box_low_m)) | (points > np.array(bounds.box_high_m))
    if is_out.any():
        s, p = np.argwhere(is_out)[0][:2]
        raise MotionRefused(
            f"way-point {w}: {_POINTS[p + 1]} leaves the workspace at "
            f"{np.round(points[s, p], 4).tolist()} m, box {bounds.box_low_m} to {bounds.box_high_m}"
        )
    tip = points[:, 2]
    is_in_base = np.hypot(tip[:, 0], tip[:, 1]) < bounds.base_radius_m
    is_in_base &= tip[:, 2] < bounds.base_height_m
    if is_in_base.any():
        found = np.round(tip[np.argmax(is_in_base)], 4).tolist()
        raise MotionRefused(f"way-point {w}: the tip comes to {found} m, inside the arm's base")
