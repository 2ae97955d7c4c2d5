"""The perception stage: a frame in, detections and tracks at its capture time out."""

import math
from typing import List, Tuple

import numpy as np

from apex_edge.errors import InputError
from apex_edge.perception import blobs, depth
from apex_edge.perception.blobs import Blob, Box
from apex_edge.perception.colour import ColourTable
from apex_edge.perception.drift import DriftWatch
from apex_edge.perception.pieces import drop_far
from apex_edge.perception.settings import PerceptionConfig, ball_radii
from apex_edge.perception.sharing import Outlook, part
from apex_edge.perception.strays import SizeMemory
from apex_edge.perception.tracking import Tracker
from apex_edge.types import Detections, Frame, Tracks

_MAX_WINDOW_SHARE = 0.4  # beyond this much of the picture one look at all of it is cheaper


class Perception:
    """Find and follow coloured objects; ``step`` is to be fed every frame in order.

    Source: APEX section "Perception" (colour segmentation, boxes, depth, five-frame window); the
    estimators are ours.
    """

    def __init__(self, config: PerceptionConfig, colours: ColourTable) -> None:
        """Start with no track.

        Parameters
        ----------
        config : settings of the stage.
        colours : the object colours to look for.
        """
        self._config = config
        self._colours = colours
        self._tracker = Tracker(config)
        self._sizes = SizeMemory(config.min_relative_area)
        self.drift = DriftWatch(colours)
        self._last_t_s = -math.inf
        self._n_until_search = 0

    def reset(self) -> None:
        """Forget all tracks and start anew; track ids are not used again."""
        self._tracker.reset()
        self._sizes.reset()
        self._last_t_s = -math.inf
        self._n_until_search = 0

    def step(self, frame: Frame) -> Tuple[Detections, Tracks]:
        """Return what this frame shows and where everything is at its capture time.

        A repeated frame (flagged, or with the stamp of the one before) shows nothing new: no
        detections, and tracks carried on without it. A clock that runs backwards loses all tracks.

        Raises
        ------
        InputError : no usable picture or depth shape, or a capture time that is not a number.
        """
        _check(frame)
        is_repeated = frame.is_repeated or frame.t_s == self._last_t_s
        if frame.t_s < self._last_t_s:
            self._tracker.drop_all()
            self._n_until_search = 0
            is_repeated = False
        self._last_t_s = frame.t_s
        if is_repeated:
            nothing = _detections(frame, [], self._colours, self._config)
            return nothing, self._tracker.coast(frame.seq, frame.t_s, frame.camera)
        detections = self._look(frame)
        self.drift.see(frame.colour_bgr, detections)
        return detections, self._tracker.update(detections, frame.camera)

    def _look(self, frame: Frame) -> Detections:
        """Look into the predicted windows; search the whole picture when that is not enough."""
        bgr, table, config = frame.colour_bgr, self._colours, self._config
        outlook = self._tracker.outlook(frame.t_s, frame.camera, bgr.shape)
        windows = outlook.box
        area = sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in windows)
        is_small = 0 < area < _MAX_WINDOW_SHARE * bgr.shape[0] * bgr.shape[1]
        if self._n_until_search > 0 and is_small:
            found = blobs.find(bgr, table, blobs.union(windows), config)
            if not any(blob.is_clipped for blob in found):
                detections = self._tell_apart(frame, found, outlook)
                if self._tracker.are_all_in(detections, windows):
                    self._n_until_search -= 1
                    return detections
        self._n_until_search = config.search_every - 1
        boxes: List[Box] = blobs.search(bgr, table, config)
        found = blobs.find(bgr, table, blobs.union(boxes), config)
        return self._tell_apart(frame, found, outlook)

    def _tell_apart(self, frame: Frame, found: List[Blob], outlook: Outlook) -> Detections:
        """Cut blobs that several tracks share, and place what can be told."""
        found = self._sizes.without_strays(found, frame.t_s, outlook, self._colours.names)
        found = drop_far(found, frame.depth_mm)
        told, hidden = part(found, outlook, self._colours.names)
        self._tracker.hide(hidden)
        return _detections(frame, told, self._colours, self._config)


def _check(frame: Frame) -> None:
    bgr, depth_mm = frame.colour_bgr, frame.depth_mm
    where = f"frame {frame.seq}"
    if not math.isfinite(frame.t_s):
        raise InputError(f"{where}: capture time {frame.t_s!r} is not a number")
    is_picture = isinstance(bgr, np.ndarray) and bgr.ndim == 3 and bgr.shape[2] == 3
    if not is_picture or bgr.dtype != np.uint8 or min(bgr.shape[:2]) < 3:
        found = f"{getattr(bgr, 'shape', None)} {getattr(bgr, 'dtype', type(bgr).__name__)}"
        raise InputError(f"{where}: expected a colour picture (h, w, 3) uint8, found {found}")
    if depth_mm is None:
        return
    if not isinstance(depth_mm, np.ndarray) or depth_mm.shape != bgr.shape[:2]:
        found = str(getattr(depth_mm, "shape", None))
        raise InputError(f"{where}: expected depth of shape {bgr.shape[:2]}, found {found}")
    if depth_mm.dtype != np.uint16:
        raise InputError(f"{where}: expected depth as uint16 mm, found {depth_mm.dtype}")


def _detections(
    frame: Frame, found: List[Blob], table: ColourTable, config: PerceptionConfig
) -> Detections:
    placed = [_place(blob, frame, table, config) for blob in found]
    return Detections(
        seq=frame.seq,
        t_s=frame.t_s,
        name=tuple(table.names[blob.label - 1] for blob in found),
        centre_px=np.array([blob.centre_px for blob in found], dtype=np.float64).reshape(-1, 2),
        area_px2=np.array([blob.area_px2 for blob in found], dtype=np.float64),
        box_px=np.array([blob.box_px for blob in found], dtype=np.float64).reshape(-1, 4),
        touches_border=np.array([blob.touches_border for blob in found], dtype=bool),
        spread_px2=np.array([blob.spread_px2 for blob in found], dtype=np.float64).reshape(-1, 3),
        is_part=np.array([blob.is_part for blob in found], dtype=bool),
        pos_m=np.array([p.pos_m for p in placed], dtype=np.float64).reshape(-1, 3),
        pos_sd_m=np.array([p.sd_m for p in placed], dtype=np.float64),
        radius_m=np.array([p.radius_m for p in placed], dtype=np.float64),
    )


def _place(blob: Blob, frame: Frame, table: ColourTable, config: PerceptionConfig) -> depth.Placed:
    if frame.camera is None:
        return depth.NOWHERE
    radius_m = ball_radii(config.ball_radius_m).get(table.names[blob.label - 1], math.nan)
    return depth.place(blob, frame.depth_mm, frame.camera, config, radius_m)
