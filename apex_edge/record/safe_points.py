"""The simulated interventions from above: which points are safe, and why the others are not."""

from typing import Any, List, Tuple

import cv2
import numpy as np

from apex_edge.record.canvas import BEST, DANGER, INK, PANEL, Bgr, Canvas, name_colour
from apex_edge.record.draw import N_BEST, moving_path
from apex_edge.types import Array, Rollouts, Tracks, TrackStatus

PLAN_PX = (1280, 1000)
LEGEND_PX = 104
X_RANGE_M = (-0.05, 0.45)
PAPER: Bgr = (252, 251, 250)
TABLE: Bgr = (244, 241, 238)
GRID: Bgr = (226, 222, 218)
REACH: Bgr = (200, 170, 130)
TEXT: Bgr = (70, 62, 56)

LATE: Bgr = (60, 165, 240)
USELESS: Bgr = (200, 194, 188)
TOUCHES: Bgr = (190, 120, 190)
SAFE_LOW: Bgr = (170, 205, 150)
SAFE_HIGH: Bgr = (70, 150, 30)
OUTCOMES: Tuple[Tuple[str, Bgr], ...] = (
    ("safe (darker is better)", SAFE_HIGH),
    ("does not stop the object", USELESS),
    ("arm would be too late", LATE),
    ("too near another object", TOUCHES),
)


def outcome_of(rollouts: Rollouts) -> Array:
    """Return for each candidate the index into OUTCOMES, (n,) int64."""
    is_late = ~(np.asarray(rollouts.slack_s) >= 0.0) & np.isfinite(rollouts.slack_s)
    outcome: Array = np.where(
        rollouts.is_safe, 0, np.where(is_late, 2, np.where(rollouts.is_collision, 1, 3))
    ).astype(np.int64)
    return outcome


def draw_safe_points(rollouts: Rollouts, tracks: Tracks, chosen: int = -1) -> Array:
    """Draw candidates, path of the mover, target, arm base and reach, seen from above.

    Parameters
    ----------
    rollouts, tracks : of the same frame.
    chosen : index of the candidate that was acted on, -1 for none.

    Returns
    -------
    (1104, 1280, 3) uint8 BGR; x of the table to the right, y up.
    """
    width, height = PLAN_PX
    picture = np.empty((height + LEGEND_PX, width, 3), dtype=np.uint8)
    picture[:] = PAPER
    plan = _Plan(Canvas(picture[:height]), width, height)
    plan.ground(rollouts.candidates.tip_m)
    plan.points(rollouts)
    plan.objects(rollouts, tracks)
    plan.best(rollouts, chosen)
    _legend(Canvas(picture[height:]), rollouts)
    return picture


class _Plan:
    """A top view with its scale."""

    def __init__(self, canvas: Canvas, width: int, height: int) -> None:
        self.canvas = canvas
        self.px_per_m = (width - 60) / (X_RANGE_M[1] - X_RANGE_M[0])
        self.origin = np.array([30.0 - X_RANGE_M[0] * self.px_per_m, height / 2.0])

    def at(self, points_m: Array) -> Array:
        """Return pixels (n, 2) of table points (n, 2 or 3)."""
        flat = np.atleast_2d(points_m)[:, :2] * np.array([1.0, -1.0])
        result: Array = self.origin + flat * self.px_per_m
        return result

    def ground(self, tip_m: Array) -> None:
        """Draw the grid, the arm's base and the ring it reaches."""
        canvas = self.canvas
        half_m = canvas.height / self.px_per_m / 2.0
        for x in np.arange(0.0, X_RANGE_M[1], 0.05):
            a, b = self.at(np.array([[x, -half_m], [x, half_m]]))
            canvas.line(a, b, GRID, 0.6)
            canvas.text((a[0] + 4, canvas.height - 14), f"{100 * x:.0f} cm", (160, 152, 146), 9.0)
        for y in np.arange(-0.15, 0.151, 0.05):
            a, b = self.at(np.array([[X_RANGE_M[0], y], [X_RANGE_M[1], y]]))
            canvas.line(a, b, GRID, 0.6)
        radius = np.hypot(tip_m[:, 0], tip_m[:, 1])
        yaw = np.arctan2(tip_m[:, 1], tip_m[:, 0])
        for reach in (radius.min(), radius.max()):
            arc = np.linspace(yaw.min(), yaw.max(), 120)
            bow = self.at(reach * np.column_stack([np.cos(arc), np.sin(arc)]))
            curve: Any = [np.rint(bow).astype(np.int32)]
            cv2.polylines(canvas.picture, curve, False, REACH, 2, cv2.LINE_AA)
        base = self.at(np.zeros((1, 3)))[0]
        canvas.disc(base, 14.0, (120, 108, 98))
        canvas.disc(base, 8.0, (90, 80, 72))
        canvas.text((base[0] - 22, base[1] + 44), "arm", TEXT, 11.0)

    def points(self, rollouts: Rollouts) -> None:
        """Draw every candidate in the colour of its outcome."""
        outcome = outcome_of(rollouts)
        pixels = self.at(rollouts.candidates.tip_m)
        inks = np.array([colour for _, colour in OUTCOMES], dtype=np.uint8)[outcome]
        safe = np.argsort(rollouts.score)
        safe = safe[rollouts.is_safe[safe]]
        shade = np.linspace(0.0, 1.0, len(safe))[:, None]
        inks[safe] = ((1 - shade) * np.array(SAFE_LOW) + shade * np.array(SAFE_HIGH)).astype(
            np.uint8
        )
        for i in [*np.flatnonzero(~rollouts.is_safe), *safe]:
            colour = int(inks[i][0]), int(inks[i][1]), int(inks[i][2])
            self.canvas.disc(pixels[i], 2.1 if rollouts.is_safe[i] else 1.7, colour)

    def objects(self, rollouts: Rollouts, tracks: Tracks) -> None:
        """Draw the tracks at their true size, and the path of the mover."""
        canvas = self.canvas
        for i, name in enumerate(tracks.name):
            position = tracks.pos_m[i]
            if tracks.status[i] == TrackStatus.LOST or not np.isfinite(position).all():
                continue
            here = self.at(position)[0]
            colour = name_colour(name)
            if tracks.track_id[i] == rollouts.mover_id:
                horizon_s = min(5.0, float(rollouts.t_free_collision_s) + 0.3)
                acc = np.nan_to_num(tracks.acc_m_s2[i])
                path = self.at(moving_path(position, tracks.vel_m_s[i], acc, horizon_s))
                for a, b in zip([here, *path[:-1]], path):
                    canvas.line(a, b, (110, 100, 92), 1.4)
                for mark in path[4::5]:
                    canvas.disc(mark, 2.6, (110, 100, 92))
                if len(path) > 4:
                    canvas.arrow(here, path[4], colour, 3.0)
            radius = float(np.nan_to_num(tracks.radius_m[i], nan=0.015))
            canvas.disc(here, radius * self.px_per_m / canvas.scale, colour)
            canvas.ring(here, radius * self.px_per_m, TEXT, 1.0)
            if tracks.track_id[i] == rollouts.target_id:
                canvas.ring(here, radius * self.px_per_m + 8.0, DANGER, 2.0)
            canvas.label(here, radius * self.px_per_m + 8.0, name, PANEL)

    def best(self, rollouts: Rollouts, chosen: int) -> None:
        """Number the best candidates and mark the chosen one."""
        canvas = self.canvas
        pixels = self.at(rollouts.candidates.tip_m)
        for rank, i in reversed(list(enumerate(rollouts.best[:N_BEST], start=1))):
            canvas.disc(pixels[i], 6.6, PANEL)
            canvas.disc(pixels[i], 5.6, BEST)
            half = canvas.text_width(str(rank), 10.0) / 2.0
            canvas.text((pixels[i][0] - half, pixels[i][1]), str(rank), PANEL, 10.0)
        if 0 <= chosen < len(pixels):
            canvas.ring(pixels[chosen], 20.0, PANEL, 3.6)
            canvas.ring(pixels[chosen], 20.0, INK, 1.6)


def _legend(canvas: Canvas, rollouts: Rollouts) -> None:
    canvas.scale = 1.9
    outcome = outcome_of(rollouts)
    rows: List[Tuple[str, Bgr]] = [
        (f"{np.count_nonzero(outcome == i)} {words}", colour)
        for i, (words, colour) in enumerate(OUTCOMES)
        if np.any(outcome == i) or i == 0
    ]
    rows.append(("best five, ranked; ring: chosen", BEST))
    left, top = 34.0, 28.0
    canvas.panel((0, 0, canvas.width, canvas.height), TABLE, 1.0, 0.0)
    for words, colour in rows:
        width = canvas.text_width(words, 12.0) + 66.0
        if left + width > canvas.width:
            left, top = 34.0, top + 48.0
        canvas.disc((left, top), 5.0, colour)
        canvas.text((left + 18.0, top), words, TEXT, 12.0)
        left += width
