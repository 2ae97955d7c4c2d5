"""Malformed input of the calibration commands, of those that are installed."""

import json
from pathlib import Path
from typing import Callable, Dict, List, Tuple

import cv2
import numpy as np

from apex_edge import plugins
from apex_edge.types import Array
from offline_train.benchmarks.perception import damage, judge
from offline_train.benchmarks.perception.bad_files import USABLE, command

N_POSES = 18
MAX_OFF_M = 0.02
_PARTS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
HEADER = ",".join(f"{side}_{part}" for side in ("gripper", "target") for part in _PARTS)
CAM_M = (0.03, -0.02, 0.06)
_ODD = ("nan", "inf", "", "x", "1e308", "0", "-1", "1,2", '"', "0.3.4", "1e-320", "5")

Case = Callable[[np.random.RandomState, Path], str]


def hand_eye(rng: np.random.RandomState, folder: Path) -> str:
    """Solve pose pairs with wrong cells, lost or mixed-up rows, or damaged bytes.

    Raises
    ------
    judge.MadeUp : a result was written that is off by more than 2 cm.
    """
    rows = [[f"{value:.9g}" for value in row] for row in _pairs(rng)]
    kind = int(rng.randint(0, 5))
    if kind == 0:
        for _ in range(int(rng.randint(1, 4))):
            cell = int(rng.randint(0, len(rows))), int(rng.randint(0, 14))
            rows[cell[0]][cell[1]] = _ODD[int(rng.randint(0, len(_ODD)))]
    elif kind == 1:
        rows = rows[: int(rng.randint(0, 5))]
    elif kind == 2:
        order = rng.permutation(len(rows))
        rows = [a[:7] + rows[k][7:] for a, k in zip(rows, order)]
    elif kind == 3:
        rows = [rows[0]] * len(rows)
    text = "\n".join([HEADER, *(",".join(row) for row in rows)]).encode("utf-8")
    pairs, out = folder / "pairs.csv", folder / "out.json"
    pairs.write_bytes(damage.broken(rng, text) if kind == 4 else text)
    result = command(
        ["calibrate", "hand-eye", "--pairs", str(pairs), "--out", str(out), "--json"], out
    )
    if result == USABLE:
        found = np.array(json.loads(out.read_text(encoding="utf-8"))["gripper_from_cam"])
        off_m = float(np.linalg.norm(found[:3, 3] - CAM_M))
        if not off_m <= MAX_OFF_M:
            raise judge.MadeUp(f"hand-eye {1000.0 * off_m:.0f} mm off from damaged pairs")
    return result


def _pairs(rng: np.random.RandomState) -> Array:
    """Return rows (n, 14) of consistent pose pairs with a little noise."""
    gripper_from_cam = _pose(cv2.Rodrigues(np.array([0.1, -0.2, 1.5]))[0], CAM_M)
    base_from_target = _pose(cv2.Rodrigues(np.array([3.0, 0.1, 0.2]))[0], (0.3, 0.1, 0.0))
    rows = []
    for _ in range(N_POSES):
        turn = cv2.Rodrigues(rng.uniform(-0.6, 0.6, 3))[0]
        base_from_gripper = _pose(turn, rng.uniform([0.1, -0.1, 0.3], [0.3, 0.1, 0.5]))
        seen = np.linalg.inv(base_from_gripper @ gripper_from_cam) @ base_from_target
        seen[:3, 3] += rng.normal(0.0, 0.0003, 3)
        rows.append(np.concatenate([_flat(base_from_gripper), _flat(seen)]))
    return np.array(rows)


def _pose(turn: Array, place_m: Tuple[float, ...]) -> Array:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, place_m
    return pose


def _flat(pose: Array) -> Array:
    """Return x, y, z and the unit quaternion x, y, z, w."""
    vector = cv2.Rodrigues(pose[:3, :3])[0].ravel()
    angle = float(np.linalg.norm(vector))
    half = np.sin(0.5 * angle) / max(angle, 1e-12)
    result: Array = np.concatenate([pose[:3, 3], vector * half, [np.cos(0.5 * angle)]])
    return result


def lens(rng: np.random.RandomState, folder: Path) -> str:
    """Calibrate a lens from pictures that are damaged or show no board.

    Raises
    ------
    judge.MadeUp : a lens was written, though no picture shows a board.
    """
    for i in range(3):
        picture = damage.noise(rng) if rng.uniform() < 0.5 else damage.balls(rng, 1)[0]
        data = cv2.imencode(".png", picture)[1].tobytes()
        (folder / f"{i}.png").write_bytes(damage.broken(rng, data) if rng.uniform() < 0.5 else data)
    out = folder / "out.json"
    arguments = ["calibrate", "intrinsics", "--images", str(folder / "*.png"), "--board", "9x6"]
    result = command([*arguments, "--square-mm", "25", "--out", str(out), "--json"], out)
    if result == USABLE:
        raise judge.MadeUp("a lens from pictures without a board")
    return result


def installed() -> Dict[str, Case]:
    """Return the cases of the calibrations that are there."""
    cases: List[Tuple[str, Case]] = [("hand-eye", hand_eye), ("intrinsics", lens)]
    there = plugins.names("calibrations")
    return {f"command: calibrate {name}": case for name, case in cases if name in there}
