"""One frame as a person wants to see it: what was seen, foreseen, simulated and decided."""

import math
from typing import Dict, Optional, Tuple

import cv2
import numpy as np

from apex_edge.geometry import project
from apex_edge.record.canvas import (
    AMBER,
    ARM,
    BEST,
    DANGER,
    DIM,
    INK,
    PANEL,
    SAFE,
    UNSAFE,
    Bgr,
    Canvas,
    name_colour,
)
from apex_edge.types import Array, CameraModel, HazardScores, Step, Tracks, TrackStatus

N_BEST = 5
"""The paper shows its top five safe points."""
SAFE_LOW: Bgr = (110, 140, 80)
MOVING_M_S = 0.02
ARROW_S = 0.4
"""A velocity arrow reaches where the object will be after this long."""
PATH_S = 2.0
PATH_STEP_S = 0.1

ACTIONS: Dict[str, Tuple[str, Bgr]] = {
    "none": ("CLEAR", (96, 90, 84)),
    "watch": ("WATCH", (20, 120, 200)),
    "intervene": ("INTERVENE", (50, 50, 215)),
    "redirect": ("REDIRECT", (50, 50, 215)),
    "hold": ("HOLD", (170, 100, 30)),
    "return": ("RETURN", (150, 120, 30)),
}


def annotate(step: Step, t_zero_s: float = 0.0) -> Array:
    """Draw all that one step holds over its colour picture.

    Parameters
    ----------
    step : without a camera model only what is known in pixels is drawn.
    t_zero_s : capture time at which the clock in the banner shows zero.

    Returns
    -------
    a new picture (h, w, 3) uint8 BGR of the frame's size.
    """
    canvas = Canvas(step.frame.colour_bgr.copy())
    canvas.reserve((0, 0, canvas.width, 30.0 * canvas.scale))
    camera = step.frame.camera
    hazard = _top_hazard(step.hazards)
    if camera is not None:
        _draw_candidates(canvas, step, camera)
    _draw_rings(canvas, step.tracks)
    if hazard is not None:
        _draw_hazard(canvas, step, hazard)
    if camera is not None:
        _draw_paths(canvas, step.tracks, camera)
        _draw_arm(canvas, step, camera)
    # words last, when it is known what they must not cover
    if hazard is not None:
        _label_hazard(canvas, step, hazard)
    _label_tracks(canvas, step.tracks)
    _draw_banner(canvas, step, t_zero_s)
    return canvas.picture


def moving_path(pos_m: Array, vel_m_s: Array, acc_m_s2: Array, horizon_s: float) -> Array:
    """Return where a track will be, (k, 3) every PATH_STEP_S, until it comes to rest."""
    speed = float(np.linalg.norm(vel_m_s))
    brake = -float(np.dot(vel_m_s, acc_m_s2)) / speed if speed > 0 else 0.0
    until_s = min(horizon_s, speed / brake) if brake > 1e-9 else horizon_s
    t = np.arange(PATH_STEP_S, until_s + 1e-9, PATH_STEP_S)[:, None]
    path: Array = pos_m + vel_m_s * t + 0.5 * acc_m_s2 * t * t
    return path


def _top_hazard(hazards: Optional[HazardScores]) -> Optional[int]:
    if hazards is None or not np.any(hazards.is_fired):
        return None
    return int(np.argmax(np.where(hazards.is_fired, hazards.probability, -1.0)))


def _index_of(tracks: Tracks, track_id: int) -> Optional[int]:
    found = np.flatnonzero(tracks.track_id == track_id)
    return int(found[0]) if len(found) else None


def _draw_candidates(canvas: Canvas, step: Step, camera: CameraModel) -> None:
    rollouts = step.rollouts
    if rollouts is None:
        return
    pixels, _ = project(camera, rollouts.candidates.tip_m)
    under = canvas.picture.copy()
    unsafe, safe = ~rollouts.is_safe, np.argsort(rollouts.score)
    safe = safe[rollouts.is_safe[safe]]
    canvas.dots(
        pixels[unsafe], 0.9, np.tile(np.array(UNSAFE, dtype=np.uint8), (int(unsafe.sum()), 1))
    )
    shade = np.linspace(0.0, 1.0, len(safe))[:, None]
    inks = (1.0 - shade) * np.array(SAFE_LOW) + shade * np.array(SAFE)
    canvas.dots(pixels[safe], 1.6, inks.astype(np.uint8))
    cv2.addWeighted(canvas.picture, 0.75, under, 0.25, 0.0, dst=canvas.picture)
    for i in rollouts.best[:N_BEST]:
        canvas.disc(pixels[i], 3.0, BEST)
        canvas.ring(pixels[i], 4.5 * canvas.scale, PANEL, 1.0)


def _draw_paths(canvas: Canvas, tracks: Tracks, camera: CameraModel) -> None:
    for i in range(len(tracks.name)):
        # written so that an unknown (NaN) velocity draws nothing
        if not float(np.linalg.norm(tracks.vel_m_s[i])) > MOVING_M_S:
            continue
        acc = np.nan_to_num(tracks.acc_m_s2[i])
        path = moving_path(tracks.pos_m[i], tracks.vel_m_s[i], acc, PATH_S)
        if not len(path):
            continue
        pixels, _ = project(camera, path)
        colour = name_colour(tracks.name[i])
        for share, at in zip(np.linspace(0.0, 1.0, len(pixels)), pixels):
            canvas.disc(at, 2.6 - 1.6 * float(share), colour)
        tip, _ = project(camera, tracks.pos_m[i] + ARROW_S * tracks.vel_m_s[i])
        canvas.arrow(tracks.centre_px[i], tip[0], colour)
        if np.isfinite(tip[0]).all():
            half = 9.0 * canvas.scale
            canvas.reserve((tip[0, 0] - half, tip[0, 1] - half, *_square(canvas)))


def _hazard_pair(step: Step, i: int) -> Optional[Tuple[int, int]]:
    assert step.hazards is not None
    mover = _index_of(step.tracks, int(step.hazards.mover_id[i]))
    target = _index_of(step.tracks, int(step.hazards.target_id[i]))
    return None if mover is None or target is None else (mover, target)


def _draw_hazard(canvas: Canvas, step: Step, i: int) -> None:
    pair = _hazard_pair(step, i)
    if pair is not None:
        mover, target = pair
        there = step.tracks.centre_px[target]
        canvas.dashes(step.tracks.centre_px[mover], there, DANGER, 1.4)
        canvas.ring(there, _radius_px(step.tracks, target) + 6.0 * canvas.scale, DANGER, 2.2)


def _label_hazard(canvas: Canvas, step: Step, i: int) -> None:
    pair, hazards = _hazard_pair(step, i), step.hazards
    if pair is None or hazards is None:
        return
    words = f"misses by {100.0 * hazards.dca_m[i]:.1f} cm in {hazards.tca_s[i]:.1f} s"
    if math.isfinite(hazards.ttc_s[i]):
        words = f"contact in {hazards.ttc_s[i]:.1f} s  DCA {100.0 * hazards.dca_m[i]:.1f} cm"
    mover, target = pair
    middle = 0.5 * (step.tracks.centre_px[mover] + step.tracks.centre_px[target])
    canvas.label(middle, 14.0 * canvas.scale, words, DANGER)


def _is_shown(tracks: Tracks, i: int) -> bool:
    is_lost = tracks.status[i] == TrackStatus.LOST
    return bool(np.isfinite(tracks.centre_px[i]).all() and not is_lost)


def _draw_rings(canvas: Canvas, tracks: Tracks) -> None:
    for i, name in enumerate(tracks.name):
        if not _is_shown(tracks, i):
            continue
        at, colour = tracks.centre_px[i], name_colour(name)
        radius = _radius_px(tracks, i) + 1.5 * canvas.scale
        is_seen = tracks.status[i] == TrackStatus.SEEN
        canvas.ring(at, radius, PANEL, 3.4)
        canvas.ring(at, radius, colour, 2.0 if is_seen else 1.0)
        canvas.disc(at, 1.5, colour)
        canvas.reserve((at[0] - radius, at[1] - radius, 2.0 * radius, 2.0 * radius))


def _label_tracks(canvas: Canvas, tracks: Tracks) -> None:
    for i, name in enumerate(tracks.name):
        if not _is_shown(tracks, i):
            continue
        words = f"{name} #{int(tracks.track_id[i])}"
        words += "" if tracks.status[i] == TrackStatus.SEEN else " (predicted)"
        speed = float(np.linalg.norm(tracks.vel_m_s[i]))
        if speed > MOVING_M_S:
            words += f"  {100.0 * speed:.0f} cm/s"
        canvas.label(tracks.centre_px[i], _radius_px(tracks, i) + 2.0 * canvas.scale, words, PANEL)


def _radius_px(tracks: Tracks, i: int) -> float:
    return math.sqrt(max(float(np.nan_to_num(tracks.area_px2[i])), 1.0) / math.pi)


def _draw_arm(canvas: Canvas, step: Step, camera: CameraModel) -> None:
    target = step.decision.target_m
    aim = project(camera, np.array(target))[0][0] if target is not None else None
    if step.arm is not None and np.isfinite(step.arm.tip_m).all():
        foot = step.arm.tip_m * np.array([1.0, 1.0, 0.0])
        (tip, ground), _ = project(camera, np.stack([step.arm.tip_m, foot]))
        canvas.line(tip, ground, ARM, 1.2)
        if aim is not None:
            canvas.dashes(tip, aim, ARM, 1.2)
        canvas.disc(tip, 5.0, PANEL)
        canvas.disc(tip, 3.8, ARM)
        canvas.reserve((tip[0] - 7 * canvas.scale, tip[1] - 7 * canvas.scale, *_square(canvas)))
    if aim is not None:
        reach = 9.0 * canvas.scale
        for dx, dy in ((reach, 0.0), (0.0, reach)):
            canvas.line((aim[0] - dx, aim[1] - dy), (aim[0] + dx, aim[1] + dy), INK, 1.4)
        canvas.ring(aim, 6.0 * canvas.scale, INK, 1.6)
        canvas.reserve((aim[0] - reach, aim[1] - reach, *_square(canvas)))


def _square(canvas: Canvas) -> Tuple[float, float]:
    return 18.0 * canvas.scale, 18.0 * canvas.scale


def _draw_banner(canvas: Canvas, step: Step, t_zero_s: float) -> None:
    unit, decision = canvas.scale, step.decision
    height = 27.0 * unit
    canvas.panel((0, 0, canvas.width, height), PANEL, 0.74, 0.0)
    word, fill = ACTIONS.get(decision.action, (decision.action.upper(), PANEL))
    left, middle = 6.0 * unit, height / 2
    left += canvas.pill((left, middle), word, fill, INK, 14.0) + 7.0 * unit
    clock = f"{step.frame.t_s - t_zero_s:7.2f} s"
    right = canvas.width - canvas.text_width(clock, 14.0) - 8.0 * unit
    canvas.text((right, middle), clock, INK, 14.0)
    words = decision.reason or decision.summary
    if decision.source not in ("", "none"):
        words = f"{decision.source}: {words}"
    canvas.text((left, middle), canvas.fitted(words, right - left - 8.0 * unit), DIM)
    if step.rollouts is not None:
        _draw_counts(canvas, step)


def _draw_counts(canvas: Canvas, step: Step) -> None:
    rollouts, unit = step.rollouts, canvas.scale
    assert rollouts is not None
    n_safe = int(np.count_nonzero(rollouts.is_safe))
    words = f"{len(rollouts.is_safe)} interventions simulated, {n_safe} safe"
    ink = SAFE if n_safe else AMBER
    canvas.pill((6.0 * unit, canvas.height - 15.0 * unit), words, PANEL, ink, 12.0)
