"""Where a camera sits on the gripper, from pose pairs: the best of several methods, or a refusal.

The judge is a fixed target: seen from any pose it must lie at one place of the base frame. Each
pose is predicted by a calibration on the others (leave-one-out), so a method cannot please itself.
Source: ours; the figure is what users of hand-eye tools ask for most.
"""

from dataclasses import dataclass
from typing import Any, Dict, List, Optional, Tuple

import cv2
import numpy as np

from apex_edge.types import Array
from calib.hand_eye_checks import (
    GOOD_DEG,
    GOOD_MM,
    MAX_REJECTED,
    MIN_POSES,
    REFUSED_DEG,
    REFUSED_MM,
    WANTED_POSES,
    Agreement,
    Motion,
    agreement,
    apart,
    motion_of,
    other_reading,
    repeated,
    turn_mismatch_deg,
    weighed,
)
from calib.hand_eye_methods import Method, methods
from calib.pose_pairs import PosePairs
from calib.rigid import mean_pose, quaternion_from_turn, vector_from_turn
from calib.spread import jackknife_sd, rms
from calib.verdict import REFUSE, Limit, Verdict, judge

REFINED = "refined"
MAX_CAMERA_M = 0.5  # no arm on a table carries its camera further from the gripper
SWAPPED_CAMERA_M = 0.2  # the same when the target is even nearer to the base
_MAX_FOLDS = 40
_SEED = 0


@dataclass(frozen=True)
class MethodScore:
    """How one method did: scatter of the fixed target, left out and not, and where it puts X."""

    name: str
    scatter_rms_mm: float
    scatter_rms_deg: float
    in_sample_mm: float
    in_sample_deg: float
    gripper_from_cam: Array

    @property
    def weighed(self) -> float:
        """Return both scatters as one number; 1 is the limit for a hobby arm."""
        return float(weighed(np.array(self.scatter_rms_mm), np.array(self.scatter_rms_deg)))

    def plain(self) -> Dict[str, Any]:
        """Return it as plain values."""
        return {
            "method": self.name,
            "scatter_rms_mm": self.scatter_rms_mm,
            "scatter_rms_deg": self.scatter_rms_deg,
            "in_sample_mm": self.in_sample_mm,
            "in_sample_deg": self.in_sample_deg,
            "translation_m": self.gripper_from_cam[:3, 3].tolist(),
        }


@dataclass(frozen=True)
class Solution:
    """A calibration: ``gripper_from_cam`` (4, 4), ``row`` (m,) of the pairs used.

    ``error_mm``, ``error_deg`` (m,) are of each left-out pose; ``base_from_target`` (m, 4, 4) is
    the target as each pose sees it; ``sd_mm`` (3,) and ``sd_deg`` (3,) by the jackknife.
    """

    method: str
    gripper_from_cam: Array
    row: Array
    error_mm: Array
    error_deg: Array
    base_from_target: Array
    sd_mm: Array
    sd_deg: Array

    @property
    def scatter_mm(self) -> float:
        """RMS of the left-out errors, mm."""
        return rms(self.error_mm)

    @property
    def scatter_deg(self) -> float:
        """RMS of the left-out errors, degrees."""
        return rms(self.error_deg)


@dataclass(frozen=True)
class HandEyeResult:
    """Verdict, and the solution where the data allow one at all; ``notes`` are no faults.

    ``rejected`` holds (row, why); ``methods`` every method tried, best first.
    """

    verdict: Verdict
    n_pairs: int
    solution: Optional[Solution] = None
    methods: Tuple[MethodScore, ...] = ()
    rejected: Tuple[Tuple[int, str], ...] = ()
    notes: Tuple[str, ...] = ()
    motion: Optional[Motion] = None
    turn_mismatch_deg: Optional[float] = None

    def figures(self) -> Dict[str, Any]:
        """Return all figures as plain values, for the file and for ``--json``; null: not known."""
        found = self.solution
        pose = found.gripper_from_cam if found else None
        return {
            **self.verdict.plain(),
            "notes": list(self.notes),
            "method": found.method if found else None,
            "translation_m": pose[:3, 3].tolist() if pose is not None else None,
            "quaternion_xyzw": (
                quaternion_from_turn(pose[:3, :3]).tolist() if pose is not None else None
            ),
            "scatter_rms_mm": found.scatter_mm if found else None,
            "scatter_rms_deg": found.scatter_deg if found else None,
            "sd_translation_mm": found.sd_mm.tolist() if found else None,
            "sd_rotation_deg": found.sd_deg.tolist() if found else None,
            "n_pairs": self.n_pairs,
            "n_used": len(found.row) if found else 0,
            "rejected": [{"row": row, "reason": why} for row, why in self.rejected],
            "range_deg": self.motion.range_deg if self.motion else None,
            "axis_spread_deg": self.motion.spread_deg.tolist() if self.motion else None,
            "turn_mismatch_deg": self.turn_mismatch_deg,
            "methods": [score.plain() for score in self.methods],
            "poses": [
                {"row": int(row), "error_mm": float(mm), "error_deg": float(deg)}
                for row, mm, deg in zip(found.row, found.error_mm, found.error_deg)
            ]
            if found
            else [],
        }


def solve(pairs: PosePairs, is_refined: bool = False) -> HandEyeResult:
    """Find gripper_from_cam from pose pairs and judge it.

    Parameters
    ----------
    pairs : n pose pairs in metres.
    is_refined : let the non-linear refinement take part. It is always listed, but by default it
        cannot win: with an arm noisier than the camera its scatter is smaller and its result worse.

    A result is always returned; whether it may be used is in ``verdict``.
    """
    n = len(pairs)
    if n < MIN_POSES:
        return _refused(
            n, f"{n} pose pairs; at least {MIN_POSES} are needed, {WANTED_POSES} wanted"
        )
    is_repeated = repeated(pairs)
    rejected = [(int(row), "repeats an earlier pose") for row in pairs.row[is_repeated]]
    distinct = pairs.pick(~is_repeated)
    if len(distinct) < MIN_POSES:
        return _refused(
            n,
            f"only {len(distinct)} of {n} gripper poses differ; at least {MIN_POSES} different "
            f"ones are needed, {WANTED_POSES} wanted",
            rejected,
        )
    motion = motion_of(distinct.base_from_gripper)
    still = judge(motion.limits())
    if still.is_refused:
        return HandEyeResult(still, n, rejected=tuple(rejected), motion=motion)
    agreed = agreement(distinct, np.random.RandomState(_SEED))
    mismatch = turn_mismatch_deg(distinct)
    if not agreed.is_usable:
        return _refused(n, _why_not(distinct, agreed, mismatch), rejected, motion)
    kept = agreed.is_kept
    used = distinct.pick(kept)
    solution, scores = _contest(used, is_refined)
    rejected += _named(distinct, kept, mismatch, solution)
    motion = motion_of(used.base_from_gripper)
    typical = _typical(turn_mismatch_deg(used))
    verdict = judge([*motion.limits(), *_limits(solution, 1.0 - kept.mean())])
    if verdict.is_refused:
        advice = other_reading(distinct, np.random.RandomState(_SEED))
        verdict = Verdict(REFUSE, (*verdict.reasons, *([advice] if advice else [])))
    return HandEyeResult(
        verdict,
        n,
        solution,
        tuple(sorted(scores, key=lambda score: score.weighed)),
        tuple(sorted(rejected)),
        _notes(solution, scores),
        motion,
        typical,
    )


def _refused(
    n: int,
    why: str,
    rejected: Optional[List[Tuple[int, str]]] = None,
    motion: Optional[Motion] = None,
) -> HandEyeResult:
    return HandEyeResult(Verdict(REFUSE, (why,)), n, rejected=tuple(rejected or ()), motion=motion)


def _why_not(pairs: PosePairs, agreed: Agreement, mismatch: Array) -> str:
    """Return why the pairs do not agree with one calibration, with what was found."""
    n, n_kept = len(pairs), int(agreed.is_kept.sum())
    found = (
        f"the best that fits {n_kept} of {n} pairs still scatters the target by "
        f"{agreed.median_mm:.1f} mm and {agreed.median_deg:.1f} deg (median), so the pairs do not "
        "agree with each other"
    )
    if agreed.median_mm <= REFUSED_MM and agreed.median_deg <= REFUSED_DEG:
        found = f"{n - n_kept} of {n} pairs do not agree with the others"
    advice = other_reading(pairs, np.random.RandomState(_SEED))
    if advice:
        return f"{found}, but they do if read another way: {advice}"
    typical = _typical(mismatch)
    if typical > REFUSED_DEG:
        return (
            f"{found}; between two poses the gripper's turn differs from the camera's by "
            f"{typical:.1f} deg (median; must be near 0): the rows do not belong together, or "
            "target or camera were moved meanwhile"
        )
    return (
        f"{found}; gripper and camera turn alike ({typical:.2f} deg, median), so the translations "
        "are wrong: check the units, the target's size, and that it did not move"
    )


def _typical(mismatch: Array) -> float:
    return float(np.median(mismatch[np.triu_indices(len(mismatch), k=1)]))


def _contest(pairs: PosePairs, is_refined: bool) -> Tuple[Solution, List[MethodScore]]:
    """Return the solution of the method with the smallest left-out scatter, and all scores."""
    scores, solutions = [], {}
    for name, method in methods().items():
        try:
            score, solution = _score(name, method, pairs)
        except cv2.error:  # some methods give up on motions that others can use
            continue
        if np.isfinite(score.weighed):
            scores.append(score)
            solutions[name] = solution
    able = [score for score in scores if is_refined or score.name != REFINED]
    return solutions[min(able, key=lambda score: score.weighed).name], scores


def _score(name: str, method: Method, pairs: PosePairs) -> Tuple[MethodScore, Solution]:
    hand = method(pairs.base_from_gripper, pairs.cam_from_target)
    seen = pairs.base_from_gripper @ hand @ pairs.cam_from_target
    in_mm, in_deg = apart(seen, mean_pose(seen))
    n = len(pairs)
    fold = np.arange(n) % min(n, _MAX_FOLDS)
    mm, deg, hands = np.empty(n), np.empty(n), []
    for index in range(fold.max() + 1):
        rest, out = pairs.pick(fold != index), pairs.pick(fold == index)
        each = method(rest.base_from_gripper, rest.cam_from_target)
        target = mean_pose(rest.base_from_gripper @ each @ rest.cam_from_target)
        left_out = out.base_from_gripper @ each @ out.cam_from_target
        mm[fold == index], deg[fold == index] = apart(left_out, target)
        hands.append(each)
    sd_mm, sd_deg = _jackknife(np.array(hands))
    score = MethodScore(name, rms(mm), rms(deg), rms(in_mm), rms(in_deg), hand)
    return score, Solution(name, hand, pairs.row, mm, deg, seen, sd_mm, sd_deg)


def _jackknife(hands: Array) -> Tuple[Array, Array]:
    """Return sd of translation (3,) mm and rotation (3,) degrees from left-out results."""
    centre = mean_pose(hands)
    shift = 1e3 * (hands[:, :3, 3] - centre[:3, 3])
    turn = np.degrees(vector_from_turn(centre[:3, :3].T @ hands[:, :3, :3]))
    return jackknife_sd(shift), jackknife_sd(turn)


def _limits(found: Solution, rejected_share: float) -> List[Limit]:
    sd_mm = float(np.linalg.norm(found.sd_mm))
    return [
        Limit(
            found.scatter_mm,
            GOOD_MM,
            REFUSED_MM,
            "the fixed target scatters by {:.1f} mm in the base frame",
        ),
        Limit(
            found.scatter_deg,
            GOOD_DEG,
            REFUSED_DEG,
            "the fixed target scatters by {:.2f} deg in the base frame",
        ),
        Limit(sd_mm, 5.0, 15.0, "the camera's place is uncertain by {:.1f} mm (sd)"),
        _far_limit(found),
        Limit(len(found.row), WANTED_POSES, MIN_POSES, "{:.0f} pose pairs", True),
        Limit(rejected_share, 0.1, MAX_REJECTED, "{:.0%} of the pairs had to be rejected"),
    ]


def _far_limit(found: Solution) -> Limit:
    """Say when the camera lies further from the gripper than the target from the base.

    With both poses inverted everything fits, but camera and target change their parts.
    """
    camera_m = float(np.linalg.norm(found.gripper_from_cam[:3, 3]))
    target_m = float(np.linalg.norm(mean_pose(found.base_from_target)[:3, 3]))
    told = (
        "the camera would be {:.2f} m off the gripper, and the target "
        f"{target_m:.2f} m off the base; is each pose the right way round?"
    )
    most_m = MAX_CAMERA_M if camera_m <= target_m else SWAPPED_CAMERA_M
    return Limit(camera_m, min(target_m, most_m), most_m, told)


def _named(
    pairs: PosePairs, kept: Array, mismatch: Array, found: Solution
) -> List[Tuple[int, str]]:
    """Return row and reason of each pair that does not agree with the solution."""
    target = mean_pose(found.base_from_target)
    out = pairs.pick(~kept)
    mm, deg = apart(out.base_from_gripper @ found.gripper_from_cam @ out.cam_from_target, target)
    differs = np.median(mismatch[np.ix_(~kept, kept)], axis=1) if len(out) else np.zeros(0)
    return [
        (
            int(out.row[i]),
            f"sees the target {mm[i]:.0f} mm and {deg[i]:.1f} deg off; its turns differ from the "
            f"camera's by {differs[i]:.1f} deg (median)",
        )
        for i in range(len(out))
    ]


def _notes(found: Solution, scores: List[MethodScore]) -> Tuple[str, ...]:
    """Say when the refinement, not chosen, would scatter far less and lies elsewhere."""
    for score in scores:
        gain = found.scatter_mm / max(score.scatter_rms_mm, 1e-9)
        moved_mm, _ = apart(score.gripper_from_cam, found.gripper_from_cam)
        if score.name == REFINED and found.method != REFINED and gain > 1.25:
            return (
                f"the refinement scatters by {score.scatter_rms_mm:.2f} mm instead of "
                f"{found.scatter_mm:.2f} and puts the camera {float(moved_mm):.1f} mm away; where "
                "the arm is more exact than the camera it is the better one (--refine)",
            )
    return ()
