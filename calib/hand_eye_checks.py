"""What must hold before a hand-eye calibration can mean anything.

Rows that repeat a pose, motions that leave a direction unobserved, rows that do not belong to the
others, and files that were written the other way round. Source: ours.
"""

import itertools
from typing import Callable, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.types import Array
from calib.hand_eye_methods import motions, park
from calib.pose_pairs import PosePairs
from calib.rigid import (
    angle_between_rad,
    inverse,
    mean_pose,
    pose,
    quaternion_from_turn,
    turn_from_quaternion,
    vector_from_turn,
)
from calib.verdict import Limit

# What a hobby arm reaches; errors are weighed by these, so that 3 mm count as much as 1 degree.
GOOD_MM, GOOD_DEG = 3.0, 1.0
# A refused arm: 3-4 x the scatter of sound sets (2.5-4.4 mm); corrupt ones give hundreds of mm.
REFUSED_MM, REFUSED_DEG = 10.0, 5.0
MIN_POSES, WANTED_POSES = 5, 15
MIN_RANGE_DEG, WANTED_RANGE_DEG = 10.0, 30.0
# Two true axes of a hobby arm give 8 degrees and more; 0.5 degrees of noise about one axis 0.7.
MIN_SECOND_DEG, WANTED_SECOND_DEG = 2.5, 6.0
MAX_REJECTED = 1.0 / 3.0
_SAME_MM, _SAME_DEG = 0.1, 0.1
_NEAR_MM, _NEAR_DEG = 20.0, 3.0
_N_SUBSET, _N_TRIALS = 4, 150
_GATE = 3.0  # times the median error


class Motion(NamedTuple):
    """How the gripper turned: largest angle between two poses, and how far about which axes.

    ``spread_deg (3,)`` is RMS over all motions along the principal axes ``axes (3, 3)``, rows in
    the gripper's frame, largest first.
    """

    range_deg: float
    spread_deg: Array
    axes: Array

    def limits(self) -> List[Limit]:
        """Return what is asked of the motions; the texts say which one is missing."""
        main = ", ".join(f"{value:+.2f}" for value in self.axes[0])
        missing = " and ".join("xyz"[axis] for axis in np.argsort(np.abs(self.axes[0]))[:2])
        second = (
            f"turns are all about one axis of the gripper ({main}): only {{:.2f}} deg RMS about a "
            f"second one; add poses that turn the gripper about its {missing}"
        )
        turned = "the gripper turns by at most {:.1f} deg between any two poses; turn it further"
        return [
            Limit(self.range_deg, WANTED_RANGE_DEG, MIN_RANGE_DEG, turned, True),
            Limit(self.spread_deg[1], WANTED_SECOND_DEG, MIN_SECOND_DEG, second, True),
        ]


def motion_of(base_from_gripper: Array) -> Motion:
    """Return how n >= 2 gripper poses (n, 4, 4) turn against each other."""
    first, second = np.triu_indices(len(base_from_gripper), k=1)
    turns = base_from_gripper[:, :3, :3]
    vectors = np.degrees(vector_from_turn(np.swapaxes(turns[second], 1, 2) @ turns[first]))
    _, values, axes = np.linalg.svd(vectors, full_matrices=False)
    spread = np.zeros(3)
    spread[: len(values)] = values / np.sqrt(len(vectors))
    whole = np.zeros((3, 3))
    whole[: len(axes)] = axes
    return Motion(float(np.linalg.norm(vectors, axis=1).max()), spread, whole)


def turn_mismatch_deg(pairs: PosePairs) -> Array:
    """Return (n, n) by how much the turn of gripper and camera between two poses differ.

    Both are fixed to one body, so the angles must be equal whatever the calibration is.
    """
    gripper, camera = motions(pairs.base_from_gripper, pairs.cam_from_target)
    angles = [
        np.linalg.norm(vector_from_turn(each[:, :3, :3]), axis=1) for each in (gripper, camera)
    ]
    first, second = np.triu_indices(len(pairs), k=1)
    result = np.zeros((len(pairs), len(pairs)))
    result[first, second] = np.degrees(np.abs(angles[0] - angles[1]))
    result += result.T
    return result


def repeated(pairs: PosePairs) -> Array:
    """Return the mask (n,) of pairs whose gripper pose, and about the view, were there before.

    They would make leave-one-out praise itself, and they add nothing.
    """
    is_repeated = np.zeros(len(pairs), dtype=bool)
    for index in range(1, len(pairs)):
        before = np.flatnonzero(~is_repeated[:index])
        mm, deg = apart(pairs.base_from_gripper[before], pairs.base_from_gripper[index])
        seen_mm, seen_deg = apart(pairs.cam_from_target[before], pairs.cam_from_target[index])
        is_same = (mm <= _SAME_MM) & (deg <= _SAME_DEG)
        is_repeated[index] = (is_same & (seen_mm <= _NEAR_MM) & (seen_deg <= _NEAR_DEG)).any()
    return is_repeated


def apart(poses: Array, other: Array) -> Tuple[Array, Array]:
    """Return how far poses (n, 4, 4) are from another (4, 4): mm (n,) and degrees (n,)."""
    mm = 1e3 * np.linalg.norm(poses[..., :3, 3] - other[..., :3, 3], axis=-1)
    return mm, np.degrees(angle_between_rad(poses[..., :3, :3], other[..., :3, :3]))


def weighed(mm: Array, deg: Array) -> Array:
    """Return errors as one number each: 1 is at the limit of what a hobby arm should have."""
    result: Array = np.hypot(np.asarray(mm) / GOOD_MM, np.asarray(deg) / GOOD_DEG)
    return result


class Agreement(NamedTuple):
    """Which of n pairs agree with one calibration, and the median errors of those that do."""

    is_kept: Array
    median_mm: float
    median_deg: float
    camera_m: float

    @property
    def is_usable(self) -> bool:
        """Say whether enough agree, and closely enough."""
        n_kept = int(self.is_kept.sum())
        is_many = n_kept >= max(MIN_POSES, (1.0 - MAX_REJECTED) * len(self.is_kept))
        return is_many and self.median_mm <= REFUSED_MM and self.median_deg <= REFUSED_DEG


def agreement(pairs: PosePairs, rng: np.random.RandomState) -> Agreement:
    """Find the pairs that agree with one calibration, up to half being wrong.

    Least median of squares over subsets of four poses, then refitted until nothing changes. A
    pair is out beyond three times the median error, and never within the hobby limit.
    """
    best, best_error = np.ones(len(pairs), dtype=bool), np.inf
    for chosen in _subsets(len(pairs), rng):
        error = weighed(*_errors(pairs, chosen)[1:])
        if np.median(error) < best_error:
            best_error = float(np.median(error))
            best = error <= max(_GATE * best_error, 1.0)
    for _ in range(10):
        # too few to go on from: whoever asked sees that most were rejected
        if best.sum() < _N_SUBSET:
            break
        error = weighed(*_errors(pairs, np.flatnonzero(best))[1:])
        kept = error <= max(_GATE * float(np.median(error[best])), 1.0)
        if (kept == best).all():
            break
        best = kept
    hand, mm, deg = _errors(pairs, np.flatnonzero(best))
    camera_m = float(np.linalg.norm(hand[:3, 3]))
    return Agreement(best, float(np.median(mm[best])), float(np.median(deg[best])), camera_m)


def _subsets(n: int, rng: np.random.RandomState) -> List[Array]:
    everyone = [np.arange(n)]
    if n <= 10:
        return everyone + [np.array(c) for c in itertools.combinations(range(n), min(n, _N_SUBSET))]
    return everyone + [rng.choice(n, _N_SUBSET, replace=False) for _ in range(_N_TRIALS)]


def _errors(pairs: PosePairs, chosen: Array) -> Tuple[Array, Array, Array]:
    """Calibrate on some pairs: the result (4, 4), and errors of the target seen by all (n,) x 2."""
    some = pairs.pick(chosen)
    hand = park(some.base_from_gripper, some.cam_from_target)
    seen = pairs.base_from_gripper @ hand @ pairs.cam_from_target
    mm, deg = apart(seen, mean_pose(seen[chosen]))
    return hand, mm, deg


def _w_first(poses: Array) -> Array:
    quaternion = quaternion_from_turn(poses[:, :3, :3])
    return pose(turn_from_quaternion(np.roll(quaternion, -1, axis=1)), poses[:, :3, 3])


def _same(poses: Array) -> Array:
    return poses


_READINGS: Dict[str, Tuple[Callable[[Array], Array], Callable[[Array], Array]]] = {
    "camera->target is written the other way round (target->camera); invert it": (_same, inverse),
    "base->gripper is the other way round (gripper->base), or the camera stands fixed and the "
    "target is on the gripper; this calibration is for a camera on the gripper": (inverse, _same),
    "both poses are written the other way round; invert both": (inverse, inverse),
    "quaternions are in the order w, x, y, z; write x, y, z, w": (_w_first, _w_first),
}


def other_reading(pairs: PosePairs, rng: np.random.RandomState) -> Optional[str]:
    """Return what to change when the same file, read another way, fits well; else None.

    Inverting both poses keeps a fit and lets camera and target change parts, so of two readings
    that fit the one with the camera nearer to the gripper is meant.
    """
    fits = []
    for advice, (of_gripper, of_target) in _READINGS.items():
        read = PosePairs(
            of_gripper(pairs.base_from_gripper), of_target(pairs.cam_from_target), pairs.row
        )
        found = agreement(read, rng)
        if found.is_usable:
            fits.append((found.camera_m, advice))
    return min(fits)[1] if fits else None
