"""``apex bench hand-eye``: simulated arms of known truth, and a real file spoilt in many ways.

The first table gives the error of the calibration itself, which no real arm can show. The second
counts what became of spoilt copies of a file: refused, solved rightly without the spoilt rows, or
solved wrongly, which must not happen. Source: ours.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.errors import CalibrationError, ConfigError
from apex_edge.record.whole import write_whole_text
from apex_edge.types import Array
from apex_edge.verbs.progress import Progress
from calib.hand_eye import REFINED, HandEyeResult, solve
from calib.hand_eye_checks import apart
from calib.pose_pairs import PosePairs, pairs_text, read_pairs
from calib.rigid import (
    inverse,
    pose,
    quaternion_from_turn,
    turn_from_quaternion,
    turn_from_vector,
)

HELP = "hand-eye calibration on simulated arms, and on a real file spoilt in many ways"
EXAMPLE = "apex bench hand-eye --runs 60 --pairs pairs.csv"
HAND = pose(turn_from_vector(np.array([0.1, -0.2, 1.5])), np.array([0.02, -0.03, 0.06]))
TARGET = pose(turn_from_vector(np.array([3.0, 0.1, 0.2])), np.array([0.35, 0.05, 0.0]))
RIGHT_MM, RIGHT_DEG = 3.0, 1.0
"""A solved spoilt file is right within this of the sound one."""


class Noise(NamedTuple):
    """Standard deviations: of each axis' turn in degrees and of each coordinate in mm."""

    arm_deg: float = 0.5
    arm_mm: float = 1.0
    camera_deg: float = 0.2
    camera_mm: float = 0.5


def simulate(
    n: int,
    rng: np.random.RandomState,
    half_range_deg: float = 40.0,
    n_axes: int = 3,
    noise: Optional[Noise] = None,
) -> PosePairs:
    """Return n pairs of an arm that turns evenly within a range about one to three axes.

    ``HAND`` and ``TARGET`` are the truth.
    """
    shake = noise if noise is not None else Noise()
    turns_deg = rng.uniform(-half_range_deg, half_range_deg, (n, 3))
    turn = np.eye(3)
    for axis in (2, 1, 0)[:n_axes]:  # yaw, pitch, roll
        turn = turn @ turn_from_vector(np.radians(turns_deg[:, axis])[:, None] * np.eye(3)[axis])
    gripper = pose(
        np.broadcast_to(turn, (n, 3, 3)), rng.uniform(-0.08, 0.08, (n, 3)) + [0.2, 0.0, 0.2]
    )
    camera = inverse(gripper @ HAND) @ TARGET
    return PosePairs(
        gripper @ _shake(n, rng, shake.arm_deg, shake.arm_mm),
        camera @ _shake(n, rng, shake.camera_deg, shake.camera_mm),
        np.arange(1, n + 1),
    )


def _shake(n: int, rng: np.random.RandomState, deg: float, mm: float) -> Array:
    turns = turn_from_vector(np.radians(deg) * rng.standard_normal((n, 3)))
    return pose(turns, 1e-3 * mm * rng.standard_normal((n, 3)))


SETUPS: Dict[str, Dict[str, Any]] = {
    **{f"{n} poses": {"n": n} for n in (5, 10, 15, 25, 40)},
    "15 poses within +-15 deg": {"n": 15, "half_range_deg": 15.0},
    "15 poses, two axes only": {"n": 15, "n_axes": 2},
    "15 poses, one axis": {"n": 15, "n_axes": 1},
    "15 poses within +-3 deg": {"n": 15, "half_range_deg": 3.0},
    "4 poses": {"n": 4},
    "25 poses, exact arm": {"n": 25, "noise": Noise(0.05, 0.2, 0.5, 1.0)},
}

Spoil = Callable[[PosePairs, np.random.RandomState], str]
"""Returns the text of a spoilt file."""


def _cells(pairs: PosePairs) -> List[List[str]]:
    return [line.split(",") for line in pairs_text(pairs).splitlines()]


def _text(cells: List[List[str]]) -> str:
    return "\n".join(",".join(row) for row in cells) + "\n"


def _cell(value: str) -> Spoil:
    def spoil(pairs: PosePairs, rng: np.random.RandomState) -> str:
        cells = _cells(pairs)
        cells[rng.randint(1, len(cells))][rng.randint(14)] = value
        return _text(cells)

    return spoil


def _columns(change: int) -> Spoil:
    def spoil(pairs: PosePairs, rng: np.random.RandomState) -> str:
        cells = _cells(pairs)
        row = rng.randint(1, len(cells))
        cells[row] = cells[row][:change] if change < 0 else cells[row] + ["0.5"] * change
        return _text(cells)

    return spoil


def _scaled(first: int, last: int, low: float, high: float, is_one: bool = False) -> Spoil:
    """Multiply some columns, of one row or of all, by a factor out of a range."""

    def spoil(pairs: PosePairs, rng: np.random.RandomState) -> str:
        cells, factor = _cells(pairs), rng.uniform(low, high)
        rows = [rng.randint(1, len(cells))] if is_one else range(1, len(cells))
        for row in rows:
            for column in range(first, last):
                cells[row][column] = repr(float(cells[row][column]) * factor)
        return _text(cells)

    return spoil


def _poses(change: Callable[[PosePairs, np.random.RandomState], Tuple[Array, Array]]) -> Spoil:
    def spoil(pairs: PosePairs, rng: np.random.RandomState) -> str:
        gripper, target = change(pairs, rng)
        return pairs_text(PosePairs(gripper, target, np.arange(1, len(gripper) + 1)))

    return spoil


def _knocked(low_share: float, high_share: float, deg: float, mm: float) -> Spoil:
    """Turn and shift the camera's pose of some rows by up to five times what is given."""

    def change(pairs: PosePairs, rng: np.random.RandomState) -> Tuple[Array, Array]:
        n_bad = max(1, int(round(rng.uniform(low_share, high_share) * len(pairs))))
        bad = rng.choice(len(pairs), n_bad, replace=False)
        way = rng.standard_normal((2, n_bad, 3))
        way /= np.linalg.norm(way, axis=2, keepdims=True)
        size = rng.uniform(1.0, 5.0, (n_bad, 1))
        knock = pose(turn_from_vector(np.radians(deg) * size * way[0]), 1e-3 * mm * size * way[1])
        sides = [pairs.base_from_gripper.copy(), pairs.cam_from_target.copy()]
        side = sides[rng.randint(2)]
        side[bad] = side[bad] @ knock
        return sides[0], sides[1]

    return _poses(change)


def _picked(choose: Callable[[int, np.random.RandomState], Tuple[Array, Array]]) -> Spoil:
    """Take gripper and camera poses from rows that are chosen each for itself."""

    def change(pairs: PosePairs, rng: np.random.RandomState) -> Tuple[Array, Array]:
        of_gripper, of_target = choose(len(pairs), rng)
        return pairs.base_from_gripper[of_gripper], pairs.cam_from_target[of_target]

    return _poses(change)


def _swapped(n: int, rng: np.random.RandomState) -> Tuple[Array, Array]:
    other = np.arange(n)
    one, two = rng.choice(n, 2, replace=False)
    other[[one, two]] = other[[two, one]]
    return np.arange(n), other


def _stuck(n: int, rng: np.random.RandomState) -> Tuple[Array, Array]:
    """Let the last part of the run keep one camera pose, as a frozen picture does."""
    other = np.arange(n)
    start = rng.randint(1, int(0.5 * n))
    other[start:] = start
    return np.arange(n), other


def _w_first(poses: Array) -> Array:
    quaternion = quaternion_from_turn(poses[:, :3, :3])
    return pose(turn_from_quaternion(np.roll(quaternion, 1, axis=1)), poses[:, :3, 3])


def _simulated(**setup: Any) -> Spoil:
    return lambda pairs, rng: pairs_text(simulate(rng=rng, **setup))


SPOILS: Dict[str, Spoil] = {
    "a cell is nan": _cell("nan"),
    "a cell is inf": _cell("-inf"),
    "a cell is text": _cell("n/a"),
    "a cell is empty": _cell(""),
    "a row is short": _columns(-1),
    "a row is long": _columns(1),
    "no header": lambda pairs, rng: _text(_cells(pairs)[1:]),
    "a quaternion is not unit": _scaled(3, 7, 1.1, 3.0, is_one=True),
    "all quaternions are not unit": _scaled(10, 14, 0.1, 0.9),
    "a quaternion is zero": _scaled(10, 14, 0.0, 0.0, is_one=True),
    "all in mm": lambda pairs, rng: _scaled(7, 10, 1e3, 1e3)(pairs, rng),
    "gripper in mm": _scaled(0, 3, 1e3, 1e3),
    "gripper in cm": _scaled(0, 3, 100.0, 100.0),
    "camera in inches": _scaled(7, 10, 39.37, 39.37),
    "target drawn 1.3-2 x too large": _scaled(7, 10, 1.3, 2.0),
    "2-4 poses": _picked(lambda n, rng: (np.arange(rng.randint(2, 5)),) * 2),  # type: ignore[return-value]
    "one pose over and over": _picked(lambda n, rng: (np.full(n, rng.randint(n)),) * 2),  # type: ignore[return-value]
    "four poses over and over": _picked(lambda n, rng: (np.arange(n) % 4,) * 2),  # type: ignore[return-value]
    "rows shuffled": _picked(lambda n, rng: (np.arange(n), rng.permutation(n))),
    "rows shifted by one": _picked(lambda n, rng: (np.arange(n), np.roll(np.arange(n), 1))),
    "two rows swapped": _picked(_swapped),
    "camera stuck": _picked(_stuck),
    "camera inverted": _poses(lambda p, rng: (p.base_from_gripper, inverse(p.cam_from_target))),
    "gripper inverted": _poses(lambda p, rng: (inverse(p.base_from_gripper), p.cam_from_target)),
    "both inverted": _poses(
        lambda p, rng: (inverse(p.base_from_gripper), inverse(p.cam_from_target))
    ),
    "quaternions w first": _poses(
        lambda p, rng: (_w_first(p.base_from_gripper), _w_first(p.cam_from_target))
    ),
    "up to 30 % turned": _knocked(0.03, 0.3, 8.0, 0.0),
    "up to 30 % shifted": _knocked(0.03, 0.3, 0.0, 30.0),
    "up to 30 % both": _knocked(0.03, 0.3, 8.0, 30.0),
    "most turned and shifted": _knocked(0.55, 0.95, 10.0, 60.0),
    "one axis": _simulated(n=20, n_axes=1),
    "turns too small": _simulated(n=20, half_range_deg=3.0),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the numbers of runs and the file to spoil."""
    parser.add_argument("--runs", type=int, default=60, help="simulated arms a row (60)")
    parser.add_argument("--pairs", type=Path, help="pose pairs to spoil (CSV); default: simulated")
    parser.add_argument("--copies", type=int, default=8, help="spoilt copies of each kind (8)")
    parser.add_argument("--json", type=Path, help="file for the figures")


def run(args: argparse.Namespace) -> int:
    """Print both tables; 1 when a spoilt file was solved wrongly.

    Raises
    ------
    ConfigError : numbers below 1. CalibrationError : the file to spoil cannot be used itself.
    """
    if args.runs < 1 or args.copies < 1:
        raise ConfigError("--runs and --copies must be 1 or more")
    sound = read_pairs(args.pairs) if args.pairs else simulate(27, np.random.RandomState(0))
    table = [simulated_row(name, args.runs) for name in SETUPS]
    _print_simulated(table)
    with Progress("kinds", len(SPOILS)) as progress:
        counts = {}
        for name in SPOILS:
            counts[name] = campaign(sound, name, args.copies)
            progress.advance()
    _print_campaign(counts)
    if args.json is not None:
        figures = {"format": "apex-bench-hand-eye", "simulated": table, "spoilt": counts}
        write_whole_text(args.json, json.dumps(figures, indent=1) + "\n")
    return 1 if any(count["wrong"] for count in counts.values()) else 0


def simulated_row(name: str, n_runs: int) -> Dict[str, Any]:
    """Return medians over simulated arms of one set-up: true errors, stated scatter and sd."""
    errors, verdicts, refined = [], [], []
    for seed in range(n_runs):
        result = solve(simulate(rng=np.random.RandomState(seed), **SETUPS[name]))
        verdicts.append(result.verdict.grade)
        found = result.solution
        if found is not None:
            mm, deg = apart(found.gripper_from_cam, HAND)
            sd_mm = float(np.linalg.norm(found.sd_mm))
            errors.append([float(mm), float(deg), found.scatter_mm, found.scatter_deg, sd_mm])
            hands = [s.gripper_from_cam for s in result.methods if s.name == REFINED]
            refined.append([float(value) for value in apart(hands[0], HAND)])
    middle = np.median(errors, axis=0).tolist() if errors else [None] * 5
    return {
        "setup": name,
        "n_runs": n_runs,
        **{grade: verdicts.count(grade) for grade in ("pass", "warn", "refuse")},
        **dict(zip(("error_mm", "error_deg", "scatter_mm", "scatter_deg", "sd_mm"), middle)),
        "refined_error_mm": float(np.median(refined, axis=0)[0]) if refined else None,
    }


def campaign(sound: PosePairs, name: str, n_copies: int) -> Dict[str, Any]:
    """Return how spoilt copies of a sound file ended, and a reason that was given."""
    expected = solve(sound).solution
    if expected is None:
        raise CalibrationError("the pairs to spoil must be usable themselves")
    count: Dict[str, Any] = {"refused": 0, "right": 0, "wrong": 0, "reason": "", "off_mm": 0.0}
    for seed in range(n_copies):
        text = SPOILS[name](sound, np.random.RandomState(seed))
        result, reason = _solve_text(text)
        if result is None or result.solution is None or result.verdict.is_refused:
            count["refused"] += 1
            count["reason"] = reason
            continue
        mm, deg = apart(result.solution.gripper_from_cam, expected.gripper_from_cam)
        is_right = mm <= RIGHT_MM and deg <= RIGHT_DEG
        count["right" if is_right else "wrong"] += 1
        count["off_mm"] = max(count["off_mm"], float(mm))
        if result.rejected and not count["refused"]:
            count["reason"] = "row {}: {}".format(*result.rejected[0])
    return count


def _solve_text(text: str) -> Tuple[Optional[HandEyeResult], str]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pairs.csv"
        path.write_text(text, encoding="utf-8")
        try:
            result = solve(read_pairs(path))
        except CalibrationError as error:
            return None, str(error).replace(f"{path}: ", "")
    return result, "; ".join(result.verdict.reasons)


def _print_simulated(table: List[Dict[str, Any]]) -> None:
    print("simulated arms (0.5 deg 1 mm; camera 0.2 deg 0.5 mm), medians")
    print(
        f"{'':<26} {'error':>16} {'scatter left out':>18} {'sd':>8} {'refined':>10}"
        "  pass warn refuse"
    )
    for row in table:
        figures = " " * 55
        if row["error_mm"] is not None:
            figures = (
                f"{row['error_mm']:7.2f} mm {row['error_deg']:5.2f} d"
                f" {row['scatter_mm']:8.2f} mm {row['scatter_deg']:5.2f} d {row['sd_mm']:5.1f} mm"
                f" {row['refined_error_mm']:7.2f} mm"
            )
        counts = f"{row['pass']:5d} {row['warn']:4d} {row['refuse']:6d}"
        print(f"{row['setup']:<26} {figures} {counts}")


def _print_campaign(counts: Dict[str, Dict[str, Any]]) -> None:
    total = {key: sum(c[key] for c in counts.values()) for key in ("refused", "right", "wrong")}
    n_copies = sum(total.values())
    print(f"\n{n_copies} spoilt copies of a sound file")
    for name, count in counts.items():
        print(
            f"  {name:<31} refused {count['refused']:3d}  right {count['right']:3d}  "
            f"wrong {count['wrong']:3d}  {count['reason'][:90]}"
        )
    print("  in all: " + ", ".join(f"{value} {key}" for key, value in total.items()))
