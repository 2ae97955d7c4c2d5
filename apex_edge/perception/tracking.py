"""Objects over time: which sighting belongs to whom, and who is out of sight.

A track is SEEN in the frame that shows it, PREDICTED while unseen for up to ``max_miss_s`` with a
growing covariance, and reported LOST once, with NaN for every state, before it is dropped. So a
consumer that forgets to look at the status cannot act on something stale.

With a camera calibration tracks live in metres on the table; without one in pixels.
"""

from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import Deque, Dict, List, Optional, Sequence, Tuple

import numpy as np

from apex_edge import geometry
from apex_edge.perception.blobs import Box
from apex_edge.perception.motion import Motion, MotionEstimator, MotionRules
from apex_edge.perception.settings import PerceptionConfig
from apex_edge.types import Array, CameraModel, Detections, Tracks, TrackStatus

_SIZE_MEMORY = 15
# Two whole objects of one size are at least two radii apart, and the middle of a piece is less
# well known than that of a whole object.
_FRAGMENT_RADII = 2.5
_GATE_RADII = 1.0  # two sightings within one object radius may always be the same object


@dataclass
class _Track:
    track_id: int
    name: str
    motion: MotionEstimator
    sizes: Deque[float]
    last_seen_s: float
    status: TrackStatus
    centre_px: Array
    box_px: Array
    area_px2: float
    pos_sd: float

    @property
    def size(self) -> float:
        return float(median(self.sizes))


class Tracker:
    """Keep the tracks of one camera; ``update`` with each frame's detections, in time order."""

    def __init__(self, config: PerceptionConfig) -> None:
        """Start with no track."""
        self._config = config
        self._tracks: List[_Track] = []
        self._next_id = 1
        self._dim = 0

    def __len__(self) -> int:
        """Return how many tracks are alive (seen or predicted)."""
        return sum(track.status != TrackStatus.LOST for track in self._tracks)

    def reset(self) -> None:
        """Forget every track; identities are not used again."""
        self._tracks = []

    def drop_all(self) -> None:
        """Declare every track lost, for instance because the clock stepped back."""
        for track in self._tracks:
            track.status = TrackStatus.LOST

    def windows(
        self, t_s: float, camera: Optional[CameraModel], shape: Tuple[int, ...]
    ) -> List[Box]:
        """Return where to look for each live track at ``t_s``, clipped to the picture.

        The box it had, moved along, plus three standard deviations and room for a bounce.
        """
        boxes = []
        for track in self._tracks:
            if track.status == TrackStatus.LOST:
                continue
            state = track.motion.predict(t_s)
            middle, scale = self._in_picture(state, camera)
            if not np.all(np.isfinite(middle)):
                continue
            dim = len(state.x)
            sd = scale * float(np.sqrt(state.cov.diagonal()[:dim].max()))
            swing = 2.0 * scale * float(np.linalg.norm(state.v)) * (t_s - track.last_seen_s)
            half = (
                0.5 * track.box_px[2:]
                + self._config.window_margin_px
                + min(3.0 * sd + swing, 0.25 * shape[1])
            )
            low = np.floor(np.clip(middle - half, 0, [shape[1], shape[0]])).astype(int)
            high = np.ceil(np.clip(middle + half + 1, 0, [shape[1], shape[0]])).astype(int)
            boxes.append((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
        return boxes

    def are_all_in(self, detections: Detections, windows: Sequence[Box]) -> bool:
        """Say whether each live track's window holds a sighting of its colour."""
        live = [track for track in self._tracks if track.status != TrackStatus.LOST]
        if len(live) != len(windows):
            return False
        for track, (x0, y0, x1, y1) in zip(live, windows):
            if not any(
                name == track.name and x0 <= x < x1 and y0 <= y < y1
                for name, (x, y) in zip(detections.name, detections.centre_px)
            ):
                return False
        return True

    def update(self, detections: Detections, camera: Optional[CameraModel]) -> Tracks:
        """Take the sightings of one frame and return every track at its capture time."""
        self._begin(camera)
        where = detections.pos_m if camera is not None else detections.centre_px
        found = self._associate(detections, where)
        for index, track in enumerate(self._tracks):
            if index in found:
                self._see(track, detections, where, found[index], camera)
            elif detections.t_s - track.last_seen_s > self._config.max_miss_s:
                track.status = TrackStatus.LOST
            elif track.status != TrackStatus.LOST:
                track.status = TrackStatus.PREDICTED
        taken = set(found.values())
        for row in range(len(detections.name)):
            is_free = row not in taken and bool(np.all(np.isfinite(where[row])))
            if is_free and not self._is_fragment(detections, where, row):
                self._start(detections, where, row, camera)
        return self._report(detections.seq, detections.t_s, camera)

    def coast(self, seq: int, t_s: float, camera: Optional[CameraModel]) -> Tracks:
        """Return every track at ``t_s`` without a new picture: nothing is SEEN in it."""
        self._begin(camera)
        for track in self._tracks:
            if t_s - track.last_seen_s > self._config.max_miss_s:
                track.status = TrackStatus.LOST
            elif track.status == TrackStatus.SEEN and t_s > track.last_seen_s:
                track.status = TrackStatus.PREDICTED
        return self._report(seq, t_s, camera)

    def _begin(self, camera: Optional[CameraModel]) -> None:
        dim = 2 if camera is None else 3
        if dim != self._dim:
            self._dim = dim
            self._tracks = []

    def _associate(self, detections: Detections, where: Array) -> Dict[int, int]:
        """Return track index -> detection row, nearest pairs of one colour first, within gates.

        A track that was out of sight chooses after those that were not: it may be elsewhere.
        """
        pairs = []
        for index, track in enumerate(self._tracks):
            if track.status == TrackStatus.LOST:
                continue
            rows = [r for r, name in enumerate(detections.name) if name == track.name]
            if not rows:
                continue
            state = track.motion.predict(detections.t_s)
            sd = float(np.sqrt(state.cov.diagonal()[: len(state.x)].max()))
            dt = detections.t_s - track.last_seen_s
            swing = 2.0 * float(np.linalg.norm(state.v)) * dt
            gate = 4.0 * (sd + track.pos_sd) + swing + _GATE_RADII * track.size
            gaps = np.linalg.norm(where[rows] - state.x, axis=1)
            was_missed = track.status != TrackStatus.SEEN
            pairs += [
                (was_missed, float(gap), index, row) for gap, row in zip(gaps, rows) if gap <= gate
            ]
        found: Dict[int, int] = {}
        taken = set()
        for _, _, index, row in sorted(pairs):
            if index not in found and row not in taken:
                found[index] = row
                taken.add(row)
        return found

    def _is_fragment(self, detections: Detections, where: Array, row: int) -> bool:
        """Say whether a sighting lies inside an object that is already followed.

        Something in front can cut an object in two; two whole objects cannot be that near.
        """
        for track in self._tracks:
            if track.name != detections.name[row] or track.status == TrackStatus.LOST:
                continue
            centre = track.motion.predict(detections.t_s).x
            if float(np.linalg.norm(where[row] - centre)) < _FRAGMENT_RADII * track.size:
                return True
        return False

    def _start(
        self, detections: Detections, where: Array, row: int, camera: Optional[CameraModel]
    ) -> None:
        track = _Track(
            track_id=self._next_id,
            name=detections.name[row],
            motion=MotionEstimator(self._rules()),
            sizes=deque(maxlen=_SIZE_MEMORY),
            last_seen_s=detections.t_s,
            status=TrackStatus.SEEN,
            centre_px=detections.centre_px[row],
            box_px=detections.box_px[row],
            area_px2=0.0,
            pos_sd=0.0,
        )
        self._next_id += 1
        self._tracks.append(track)
        self._see(track, detections, where, row, camera)

    def _see(
        self,
        track: _Track,
        detections: Detections,
        where: Array,
        row: int,
        camera: Optional[CameraModel],
    ) -> None:
        noise, size = self._config.noise_px, float(np.sqrt(detections.area_px2[row] / np.pi))
        track.pos_sd = noise
        if camera is not None:
            reach = float(np.linalg.norm(where[row] - camera.table_from_cam[:3, 3]))
            noise *= reach / camera.fx_px
            size = float(detections.radius_m[row])
            track.pos_sd = float(detections.pos_sd_m[row])
        if detections.touches_border[row]:
            noise *= 4.0  # what is cut off pulls the centre inwards
        track.motion.add(detections.t_s, where[row], noise)
        track.sizes.append(size)
        track.last_seen_s, track.status = detections.t_s, TrackStatus.SEEN
        track.centre_px = detections.centre_px[row]
        track.box_px = detections.box_px[row]
        track.area_px2 = float(detections.area_px2[row])

    def _rules(self) -> MotionRules:
        config, is_metric = self._config, self._dim == 3
        return MotionRules(
            speed_sd=config.speed_sd_m_s if is_metric else config.speed_sd_px_s,
            acc_sd=config.acc_sd_m_s2 if is_metric else config.acc_sd_px_s2,
            stamp_sd_s=config.stamp_sd_s,
            window=config.window,
            min_samples=config.min_samples,
            gate_sigma=config.gate_sigma,
            max_gap_s=config.max_miss_s,
        )

    @staticmethod
    def _in_picture(state: Motion, camera: Optional[CameraModel]) -> Tuple[Array, float]:
        """Return the pixel of a predicted state and how many pixels one of its units is there."""
        if camera is None:
            return state.x, 1.0
        pixels, depth = geometry.project(camera, state.x)
        return pixels[0], camera.fx_px / max(float(depth[0]), 1e-3)

    def _report(self, seq: int, t_s: float, camera: Optional[CameraModel]) -> Tracks:
        """Return the struct of arrays, and drop what it says is lost."""
        tracks, n = self._tracks, len(self._tracks)
        pos, vel, acc, smooth = (np.full((n, 3), np.nan) for _ in range(4))
        cov = np.full((n, 6, 6), np.nan)
        centre, radius = np.full((n, 2), np.nan), np.full(n, np.nan)
        for i, track in enumerate(tracks):
            if track.status == TrackStatus.LOST:
                continue
            state = track.motion.predict(t_s)
            is_seen = track.status == TrackStatus.SEEN
            centre[i] = track.centre_px if is_seen else self._in_picture(state, camera)[0]
            if camera is None:
                continue
            pos[i], vel[i], acc[i] = state.x, state.v, state.a
            cov[i] = state.cov
            cov[i, :3, :3] += np.eye(3) * track.pos_sd**2
            smooth[i], radius[i] = track.motion.smooth(), track.size
        result = Tracks(
            seq=seq,
            t_s=t_s,
            name=tuple(track.name for track in tracks),
            track_id=np.array([track.track_id for track in tracks], dtype=np.int64),
            pos_m=pos,
            vel_m_s=vel,
            acc_m_s2=acc,
            cov=cov,
            radius_m=radius,
            n_samples=np.array([track.motion.n_samples for track in tracks], dtype=np.int64),
            status=np.array([int(track.status) for track in tracks], dtype=np.int64),
            age_s=np.array([t_s - track.last_seen_s for track in tracks], dtype=np.float64),
            centre_px=centre,
            area_px2=np.array([track.area_px2 for track in tracks], dtype=np.float64),
            is_manoeuvre=np.array([track.motion.is_manoeuvre for track in tracks], dtype=bool),
            smooth_m=smooth,
        )
        self._tracks = [track for track in tracks if track.status != TrackStatus.LOST]
        return result
