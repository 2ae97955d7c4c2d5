"""Judge what perception says of a damaged input: typed refusal, nothing, or something true.

A made-up position is a defect, however odd the input. What counts as made up:

- a SEEN track where the picture holds no pixels of that colour. A hue rule of our own judges that,
  not the table under test; damage may well move or tear a ball, and then that is what is there;
- a number that is not finite in a track that is SEEN or PREDICTED with a camera, any finite state
  in one that is LOST, any metric state without a camera;
- a metric position off the viewing ray of its own sighting, or, where there is no valid depth, one
  that does not stem from the table plane with the deviation stated for that.
"""

import math
from typing import Dict, Optional

import cv2
import numpy as np

from apex_edge import geometry
from apex_edge.perception import PerceptionConfig
from apex_edge.twin.palette import PALETTE
from apex_edge.types import Array, Detections, Frame, Tracks, TrackStatus

HUE_STEPS = 22.0  # of OpenCV's 180
LEAST_SATURATION, LEAST_VALUE = 40, 16
LEAST_SHARE = 0.25  # of the area that is claimed; of a covered ball the least region will do
RAY_PX = 3.0


class MadeUp(Exception):  # noqa: N818 - a finding, not an error of this program
    """Report that perception claimed something that is not so."""


def _hue(bgr: Array) -> float:
    one = np.array(bgr, dtype=np.float64).reshape(1, 1, 3).astype(np.uint8)
    return float(cv2.cvtColor(one, cv2.COLOR_BGR2HSV)[0, 0, 0])


_HUES: Dict[str, float] = {name: _hue(np.array(bgr)) for name, bgr in PALETTE.items()}


def n_coloured(bgr: Array, name: str) -> int:
    """Return how many pixels (h, w, 3) are roughly of a palette colour, by hue."""
    hsv = cv2.cvtColor(np.ascontiguousarray(bgr), cv2.COLOR_BGR2HSV)
    off = np.abs(hsv[..., 0].astype(np.float64) - _HUES[name])
    off = np.minimum(off, 180.0 - off)
    strong = (hsv[..., 1] >= LEAST_SATURATION) & (hsv[..., 2] >= LEAST_VALUE)
    return int(np.count_nonzero((off <= HUE_STEPS) & strong))


def check(frame: Frame, detections: Detections, tracks: Tracks, config: PerceptionConfig) -> int:
    """Return how many tracks are SEEN, all of them truly.

    Raises
    ------
    MadeUp : something claimed is not so.
    """
    _expect(tracks.t_s == frame.t_s and tracks.seq == frame.seq, "tracks of another frame")
    _expect(len(set(tracks.track_id.tolist())) == len(tracks.track_id), "a track id twice")
    n_seen = 0
    for i, status in enumerate(tracks.status.tolist()):
        _check_state(frame, tracks, i, status)
        if status == TrackStatus.SEEN and not frame.is_repeated:
            n_seen += 1
            _check_colour(frame, detections, tracks, i, config.min_area_px2)
    if frame.camera is not None:
        _check_places(frame, detections, config)
    return n_seen


def _expect(is_so: bool, otherwise: str) -> None:
    if not is_so:
        raise MadeUp(otherwise)


def _check_state(frame: Frame, tracks: Tracks, i: int, status: int) -> None:
    state = np.concatenate([tracks.pos_m[i], tracks.vel_m_s[i], tracks.cov[i].ravel()])
    label = f"track {int(tracks.track_id[i])} ({TrackStatus(status).name})"
    if status == TrackStatus.LOST:
        _expect(not np.isfinite(state).any(), f"{label} still has a state")
        _expect(not np.isfinite(tracks.centre_px[i]).any(), f"{label} still has a centre")
        return
    if frame.camera is None:
        _expect(not np.isfinite(state).any(), f"{label} has metres without a camera")
    else:
        _expect(bool(np.isfinite(state).all()), f"{label} has a state that is not finite")
        _expect(bool((np.diag(tracks.cov[i]) >= 0.0).all()), f"{label} has a negative variance")
    if status == TrackStatus.SEEN:
        height, width = frame.colour_bgr.shape[:2]
        x, y = tracks.centre_px[i]
        _expect(-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5, f"{label} out of picture")


def _row(detections: Detections, tracks: Tracks, i: int) -> Optional[int]:
    """Return the sighting of a SEEN track in this frame."""
    for row, name in enumerate(detections.name):
        is_it = np.array_equal(detections.centre_px[row], tracks.centre_px[i])
        if name == tracks.name[i] and is_it:
            return row
    return None


def _check_colour(
    frame: Frame, detections: Detections, tracks: Tracks, i: int, least_px2: float
) -> None:
    row = _row(detections, tracks, i)
    if row is None:
        # the frame repeats the capture time of the one before: nothing new was looked at
        _expect(not detections.name, f"track {int(tracks.track_id[i])} is SEEN without a sighting")
        return
    x, y, w, h = (int(v) for v in detections.box_px[row])
    crop = frame.colour_bgr[max(0, y) : y + h, max(0, x) : x + w]
    n_true = n_coloured(crop, tracks.name[i]) if crop.size else 0
    _expect(
        n_true >= min(LEAST_SHARE * float(detections.area_px2[row]), least_px2),
        f"{tracks.name[i]} of {detections.area_px2[row]:.0f} px^2 seen at {x},{y} {w}x{h}, "
        f"where {n_true} pixels have that hue",
    )


def _check_places(frame: Frame, detections: Detections, config: PerceptionConfig) -> None:
    assert frame.camera is not None
    for row, name in enumerate(detections.name):
        pos, sd_m = detections.pos_m[row], float(detections.pos_sd_m[row])
        if not np.isfinite(pos).all():
            _expect(not math.isfinite(sd_m), f"{name}: a deviation without a position")
            continue
        _expect(sd_m > 0.0 and math.isfinite(sd_m), f"{name}: a position with deviation {sd_m}")
        pixel, _ = geometry.project(frame.camera, pos)
        gap = float(np.linalg.norm(pixel[0] - detections.centre_px[row]))
        _expect(gap <= RAY_PX, f"{name}: position {gap:.1f} px off its own viewing ray")
        if not _has_depth(frame, detections.box_px[row]):
            is_plane = abs(pos[2] - 0.5 * config.object_height_m) < 1e-6
            _expect(
                is_plane and sd_m >= config.plane_bias_m,
                f"{name}: a position without valid depth that is not from the table plane",
            )


def _has_depth(frame: Frame, box_px: Array) -> bool:
    if frame.depth_mm is None:
        return False
    x, y, w, h = (int(v) for v in box_px)
    crop = frame.depth_mm[max(0, y) : y + h, max(0, x) : x + w]
    return bool(((crop > 0) & (crop < 65535)).any())
