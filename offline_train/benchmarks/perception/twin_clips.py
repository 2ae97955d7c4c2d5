"""Labelled clips made from the twin, in the very files that users label by hand.

Short videos of balls that roll, cross, leave and share a colour; the truth is the world's own. A
label is left out where a ball is cut off by the picture's border or hides behind another.
"""

import json
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Tuple

import cv2
import numpy as np

from apex_edge import geometry
from apex_edge.cameras.twin import TwinCamera, TwinConfig
from apex_edge.errors import InputError
from apex_edge.twin.scene import Point, Scenario, SceneObject
from apex_edge.twin.world import TwinWorld
from apex_edge.types import Array
from offline_train.benchmarks.perception.truth import FILE

FPS = 30.0
DURATION_S = 2.5
EVERY = 4
TOLERANCE_PX = 4.0
RADIUS_M = 0.015
APART = 1.3  # diameters between two balls' centres that count as not hidden
RUN = (40, 60)
MIN_SPEED_TOLERANCE_PX_S = 3.0
QUALITY = 95


class _Moment(NamedTuple):
    """One frame's truth: pixels (n, 2), radii (n,) px, pixel velocities (n, 2)."""

    pixels: Array
    radii_px: Array
    speeds_px_s: Array


def _ball(name: str, colour: str, at: Point, speed: Point = (0.0, 0.0)) -> SceneObject:
    return SceneObject(name, colour, "ball", RADIUS_M, at, speed, friction=0.004)


def scenes() -> Dict[str, Tuple[SceneObject, ...]]:
    """Return the balls of each scene by the name of its clip."""
    grid = [(0.10 + 0.09 * (i % 4), -0.18 + 0.12 * (i // 4)) for i in range(16)]
    turns = np.linspace(0.0, 2.0 * np.pi, 12)[:-1]
    crowd = [
        _ball(
            f"{('purple', 'yellow')[i % 2]} {i}",
            ("purple", "yellow")[i % 2],
            grid[i],
            (0.015 * float(np.cos(turn)), 0.015 * float(np.sin(turn))),
        )
        for i, turn in enumerate(turns)
    ]
    return {
        "two_colours": (
            _ball("red", "red", (0.20, 0.05)),
            _ball("green", "green", (0.34, -0.20), (-0.02, 0.14)),
        ),
        "three_of_one": (
            _ball("a", "blue", (0.12, -0.16), (0.06, 0.09)),
            _ball("b", "blue", (0.34, -0.10), (-0.02, 0.08)),
            _ball("c", "blue", (0.28, 0.16), (-0.06, -0.01)),
        ),
        # they pass each other one ball's width apart: in the picture they touch
        "crossing": (
            _ball("left", "green", (0.215, -0.16), (0.0, 0.13)),
            _ball("right", "green", (0.250, 0.16), (0.0, -0.13)),
        ),
        "leaving": (
            _ball("orange", "orange", (0.30, 0.10), (0.16, 0.13)),
            _ball("red", "red", (0.15, -0.08), (0.03, 0.0)),
        ),
        "eleven": tuple(crowd),
    }


def write_all(folder: Path) -> List[Path]:
    """Write every clip into a folder of its own; return their truth files.

    Raises
    ------
    InputError : a file cannot be written.
    """
    return [_write(folder / name, balls) for name, balls in scenes().items()]


def _write(folder: Path, balls: Tuple[SceneObject, ...]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    scenario = Scenario(folder.name, 1, balls, (), DURATION_S, "", "", False)
    config = TwinConfig(fps=FPS, jitter_s=0.0, delay_s=0.0, drop_rate=0.0, repeat_rate=0.0)
    camera = TwinCamera(config, TwinWorld(scenario))
    size = (config.width_px, config.height_px)
    video = cv2.VideoWriter(str(folder / "clip.avi"), cv2.VideoWriter_fourcc(*"MJPG"), FPS, size)
    if not video.isOpened():
        raise InputError(f"{folder / 'clip.avi'}: cannot write a video")
    video.set(cv2.VIDEOWRITER_PROP_QUALITY, QUALITY)
    moments: List[_Moment] = []
    try:
        for frame in iter(camera.advance, None):
            video.write(frame.colour_bgr)
            moments.append(_moment(camera))
    finally:
        video.release()
    path = folder / FILE
    text = json.dumps(_truth(balls, size, moments), indent=1)
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error}") from error
    return path


def _moment(camera: TwinCamera) -> _Moment:
    objects, model = camera.world.objects, camera.camera
    pixels, depth = geometry.project(model, objects.pos_m)
    ahead, _ = geometry.project(model, objects.pos_m + 0.01 * objects.vel_m_s)
    return _Moment(pixels, objects.radius_m * model.fx_px / depth, (ahead - pixels) / 0.01)


def _truth(
    balls: Tuple[SceneObject, ...], size: Tuple[int, int], moments: List[_Moment]
) -> Dict[str, Any]:
    centres: List[Dict[str, Any]] = []
    absent: List[Dict[str, Any]] = []
    for number in range(0, len(moments), EVERY):
        moment = moments[number]
        centres += [
            _label(ball, number, moment, i)
            for i, ball in enumerate(balls)
            if _is_clear(balls, moment, i, size)
        ]
        gone = _absent(balls, moment, size)
        if gone:
            absent.append({"frame": number, "names": gone})
    runs = [_run(ball, moments, i) for i, ball in enumerate(balls) if _is_steady(ball, moments, i)]
    return {
        "video": "clip.avi",
        "size_px": list(size),
        "n_frames": len(moments),
        "nominal_fps": FPS,
        "frame_index": "0-based, order of decoding",
        "tolerance_px": TOLERANCE_PX,
        "centres": centres,
        "absent": absent,
        "straight_runs": [run for run in runs if _is_labelled(run, centres)],
        "notes": "made from the twin",
    }


def _label(ball: SceneObject, number: int, moment: _Moment, i: int) -> Dict[str, Any]:
    return {
        "frame": number,
        "name": ball.colour,
        "object": ball.name,
        "x_px": round(float(moment.pixels[i, 0]), 2),
        "y_px": round(float(moment.pixels[i, 1]), 2),
        "area_px2": round(float(np.pi * moment.radii_px[i] ** 2), 1),
    }


def _is_clear(
    balls: Tuple[SceneObject, ...], moment: _Moment, i: int, size: Tuple[int, int]
) -> bool:
    """Say whether a ball is wholly in view and no other covers it or melts into it."""
    margin = moment.radii_px[i] + 2.0
    if np.any(moment.pixels[i] < margin) or np.any(moment.pixels[i] > np.array(size) - 1 - margin):
        return False
    gaps = np.hypot(*(moment.pixels - moment.pixels[i]).T)
    gaps[i] = np.inf
    return bool(np.min(gaps) > APART * 2.0 * moment.radii_px[i]) or len(balls) == 1


def _absent(balls: Tuple[SceneObject, ...], moment: _Moment, size: Tuple[int, int]) -> List[str]:
    """Return the colours of which no ball shows as much as a pixel."""
    low = moment.pixels + moment.radii_px[:, None] + 2.0
    high = moment.pixels - moment.radii_px[:, None] - 2.0
    is_out = np.any(low < 0.0, axis=1) | np.any(high > np.array(size) - 1.0, axis=1)
    colours = sorted({ball.colour for ball in balls})
    return [c for c in colours if all(o for ball, o in zip(balls, is_out) if ball.colour == c)]


def _is_steady(ball: SceneObject, moments: List[_Moment], i: int) -> bool:
    return ball.vel_m_s != (0.0, 0.0) and bool(
        np.hypot(*(moments[RUN[1]].speeds_px_s[i] - moments[RUN[0]].speeds_px_s[i])) < 20.0
    )


def _run(ball: SceneObject, moments: List[_Moment], i: int) -> Dict[str, Any]:
    """Return a run with the speed at its end; perspective bends it a little on the way."""
    first, last = RUN
    speed = moments[last].speeds_px_s[i]
    change = float(np.hypot(*(speed - moments[first].speeds_px_s[i])))
    return {
        "name": ball.colour,
        "object": ball.name,
        "first": first,
        "last": last,
        "vx_px_s": round(float(speed[0]), 2),
        "vy_px_s": round(float(speed[1]), 2),
        "tolerance_px_s": round(max(MIN_SPEED_TOLERANCE_PX_S, change), 2),
    }


def _is_labelled(run: Dict[str, Any], centres: List[Dict[str, Any]]) -> bool:
    """Say whether the object is in sight all along its run."""
    wanted = [n for n in range(0, run["last"] + 1, EVERY) if n >= run["first"]]
    have = {c["frame"] for c in centres if c["object"] == run["object"]}
    return all(number in have for number in wanted)
