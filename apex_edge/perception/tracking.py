"""Objects over time: which sighting belongs to whom, and who is out of sight.

A track is SEEN in the frame that shows it, PREDICTED while unseen for up to ``max_miss_s`` with a
growing covariance, and reported LOST once, with NaN for every state, before it is dropped. So a
consumer that forgets to look at the status cannot act on something stale.

With a camera calibration tracks live in metres on the table; without one in pixels.
"""

from typing import Dict, List, Optional, Sequence, Set, Tuple

import numpy as np

from apex_edge import geometry
from apex_edge.perception.blobs import Box
from apex_edge.perception.estimator import Estimator, Motion, MotionRules
from apex_edge.perception.matching import match
from apex_edge.perception.motion import MotionEstimator
from apex_edge.perception.paper_motion import PaperMotion
from apex_edge.perception.settings import PAPER, PerceptionConfig
from apex_edge.perception.sharing import STEP_S, Outlook
from apex_edge.perception.track import Sighting, Track
from apex_edge.types import Array, CameraModel, Detections, Tracks, TrackStatus

# Two whole objects of one size are at least two radii apart, and the middle of a piece is less
# well known than that of a whole object.
_FRAGMENT_RADII = 2.5
_GATE_RADII = 1.0  # two sightings within one object radius may always be the same object
_FALL_RADII_S2 = 300.0  # free fall of a tennis ball
_SIZES = (0.4, 2.2)  # radius of a sighting over that of its track


class Tracker:
    """Keep the tracks of one camera; ``update`` with each frame's detections, in time order."""

    def __init__(self, config: PerceptionConfig) -> None:
        """Start with no track."""
        self._config = config
        self._tracks: List[Track] = []
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

    def outlook(self, t_s: float, camera: Optional[CameraModel], shape: Tuple[int, ...]) -> Outlook:
        """Return where each live track is expected at ``t_s`` and which window to look into.

        The box it had, moved along, plus three standard deviations and room for a bounce.
        """
        self._begin(t_s, camera)
        size = np.array([shape[1], shape[0]])
        middles, steps, boxes = [], [], []
        tracks = self._alive()
        for track in tracks:
            state = track.motion.predict(t_s)
            middle, scale = self._in_picture(state, camera)
            dim = len(state.x)
            sd = scale * float(np.sqrt(state.cov.diagonal()[:dim].max()))
            swing = 2.0 * scale * float(np.linalg.norm(state.v)) * (t_s - track.last.t_s)
            half = (
                0.5 * track.last.box_px[2:]
                + self._config.window_margin_px
                + min(3.0 * sd + swing, 0.25 * shape[1])
            )
            is_ahead = bool(np.all(np.isfinite(middle)))
            low = np.floor(np.clip(middle - half, 0, size)) if is_ahead else np.zeros(2)
            high = np.ceil(np.clip(middle + half + 1, 0, size)) if is_ahead else np.zeros(2)
            boxes.append((int(low[0]), int(low[1]), int(high[0]), int(high[1])))
            middles.append(middle)
            moved = state._replace(x=state.x + STEP_S * state.v)
            steps.append(self._in_picture(moved, camera)[0] - middle)
        return Outlook(
            name=tuple(track.name for track in tracks),
            centre_px=np.array(middles).reshape(-1, 2),
            step_px=np.array(steps).reshape(-1, 2),
            radius_px=np.array([track.radius_px for track in tracks]),
            is_there=np.array([track.is_there for track in tracks], dtype=bool),
            box=tuple(boxes),
            is_scaled=camera is not None,
        )

    def hide(self, rows: Set[int]) -> None:
        """Note which tracks (rows of the outlook) are hidden in a blob they share."""
        for row, track in enumerate(self._alive()):
            track.is_hidden = row in rows

    def are_all_in(self, detections: Detections, windows: Sequence[Box]) -> bool:
        """Say whether each live track's window holds a sighting of its colour."""
        tracks = self._alive()
        if len(tracks) != len(windows):
            return False
        for track, (x0, y0, x1, y1) in zip(tracks, windows):
            if not any(
                name == track.name and x0 <= x < x1 and y0 <= y < y1
                for name, (x, y) in zip(detections.name, detections.centre_px)
            ):
                return False
        return True

    def update(self, detections: Detections, camera: Optional[CameraModel]) -> Tracks:
        """Take the sightings of one frame and return every track at its capture time."""
        self._begin(detections.t_s, camera)
        sightings = self._sightings(detections, camera)
        found = self._associate(detections, sightings)
        for index, track in enumerate(self._tracks):
            if index in found:
                track.see(sightings[found[index]])
            else:
                self._miss(track, detections.t_s)
        taken = set(found.values())
        for row, sighting in enumerate(sightings):
            is_free = row not in taken and bool(np.all(np.isfinite(sighting.where)))
            if is_free and not self._is_fragment(detections.name[row], sighting):
                self._start(detections.name[row], sighting)
        return self._report(detections.seq, detections.t_s, camera)

    def coast(self, seq: int, t_s: float, camera: Optional[CameraModel]) -> Tracks:
        """Return every track at ``t_s`` without a new picture: nothing is SEEN in it."""
        self._begin(t_s, camera)
        for track in self._alive():
            if t_s > track.last.t_s:
                self._miss(track, t_s)
        return self._report(seq, t_s, camera)

    def _begin(self, t_s: float, camera: Optional[CameraModel]) -> None:
        """Give up what was seen too long ago for anything to be said of it at ``t_s``."""
        dim = 2 if camera is None else 3
        if dim != self._dim:
            self._dim = dim
            self._tracks = []
        for track in self._tracks:
            if not 0.0 <= t_s - track.last.t_s <= self._patience_s(track):
                track.status = TrackStatus.LOST

    def _alive(self) -> List[Track]:
        return [track for track in self._tracks if track.status != TrackStatus.LOST]

    def _patience_s(self, track: Track) -> float:
        return self._config.max_hidden_s if track.is_hidden else self._config.max_miss_s

    def _miss(self, track: Track, t_s: float) -> None:
        """Carry on a track that this frame does not show, or give it up."""
        if t_s - track.last.t_s > self._patience_s(track):
            track.status = TrackStatus.LOST
        elif track.status != TrackStatus.LOST:
            track.status = TrackStatus.PREDICTED

    def _associate(self, detections: Detections, sightings: Sequence[Sighting]) -> Dict[int, int]:
        """Return track index -> detection row, colour by colour, within gates.

        A track that was out of sight chooses after those that were not: it may be elsewhere.
        """
        found: Dict[int, int] = {}
        alive = [i for i, track in enumerate(self._tracks) if track.status != TrackStatus.LOST]
        for name in sorted(set(detections.name)):
            rows = [r for r, other in enumerate(detections.name) if other == name]
            tracks = [i for i in alive if self._tracks[i].name == name]
            if not tracks:
                continue
            where = np.array([sightings[r].where for r in rows])
            ahead = [self._tracks[i].motion.predict(detections.t_s) for i in tracks]
            gates = np.array([self._gate(i, s, detections.t_s) for i, s in zip(tracks, ahead)])
            gaps = np.linalg.norm(np.array([s.x for s in ahead])[:, None] - where[None], axis=2)
            sizes = np.array([sightings[r].size for r in rows])
            usual = np.array([self._tracks[i].size for i in tracks])[:, None]
            is_whole = ~np.array([sightings[r].touches_border for r in rows])
            is_odd = ((sizes < _SIZES[0] * usual) & is_whole) | (sizes > _SIZES[1] * usual)
            # without a position, or of quite another size
            gaps = np.where(is_odd | ~np.isfinite(gaps), np.inf, gaps)
            was_missed = [self._tracks[i].status != TrackStatus.SEEN for i in tracks]
            pairs = match(gaps, gates, np.array(was_missed))
            found.update({tracks[i]: rows[j] for i, j in pairs.items()})
        return found

    def _gate(self, index: int, state: Motion, t_s: float) -> float:
        """Return how far from its predicted place a track may be sighted."""
        track = self._tracks[index]
        sd = float(np.sqrt(state.cov.diagonal()[: len(state.x)].max()))
        swing = 2.0 * float(np.linalg.norm(state.v)) * (t_s - track.last.t_s)
        return 4.0 * float(np.hypot(sd, track.pos_sd)) + swing + _GATE_RADII * track.size

    def _is_fragment(self, name: str, sighting: Sighting) -> bool:
        """Say whether a sighting lies inside an object that is already followed.

        Something in front can cut an object in two; two whole objects cannot be that near.
        """
        for track in self._tracks:
            if track.name != name or track.status == TrackStatus.LOST:
                continue
            centre = track.motion.predict(sighting.t_s).x
            gap = float(np.linalg.norm(sighting.where - centre))
            if gap < _FRAGMENT_RADII * max(track.size, 0.5 * (track.size + sighting.size)):
                return True
        return False

    def _start(self, name: str, sighting: Sighting) -> None:
        rules = self._rules(sighting)
        motion: Estimator = MotionEstimator(rules)
        if self._config.motion == PAPER:
            motion = PaperMotion(rules)
        self._tracks.append(Track(self._next_id, name, motion, sighting, self._config.noise_px))
        self._next_id += 1

    def _sightings(self, detections: Detections, camera: Optional[CameraModel]) -> List[Sighting]:
        """Return the detections in the unit the tracks live in."""
        where = detections.pos_m if camera is not None else detections.centre_px
        result = []
        for row in range(len(detections.name)):
            unit, pos_sd = 1.0, self._config.noise_px
            size = float(np.sqrt(detections.area_px2[row] / np.pi))
            if camera is not None:
                reach = float(np.linalg.norm(where[row] - camera.table_from_cam[:3, 3]))
                unit, pos_sd = reach / camera.fx_px, float(detections.pos_sd_m[row])
                size = float(detections.radius_m[row])
            result.append(
                Sighting(
                    t_s=detections.t_s,
                    where=where[row],
                    unit=unit,
                    size=size,
                    pos_sd=pos_sd,
                    centre_px=detections.centre_px[row],
                    box_px=detections.box_px[row],
                    area_px2=float(detections.area_px2[row]),
                    spread_px2=detections.spread_px2[row],
                    touches_border=bool(detections.touches_border[row]),
                    is_part=bool(detections.is_part[row]),
                )
            )
        return result

    def _rules(self, first: Sighting) -> MotionRules:
        config, is_metric = self._config, self._dim == 3
        return MotionRules(
            speed_sd=config.speed_sd_m_s if is_metric else config.speed_sd_px_s,
            acc_sd=config.acc_sd_m_s2 if is_metric else config.acc_sd_px_s2,
            stamp_sd_s=config.stamp_sd_s,
            # pixels say nothing of metres, so an object's own size has to: it may well be falling
            curve_sd=0.0 if is_metric else _FALL_RADII_S2 * first.size,
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
        pos, vel, acc, smooth, seen = (np.full((n, 3), np.nan) for _ in range(5))
        cov = np.full((n, 6, 6), np.nan)
        centre, radius, seen_sd = np.full((n, 2), np.nan), np.full(n, np.nan), np.full(n, np.nan)
        for i, track in enumerate(tracks):
            if track.status == TrackStatus.LOST:
                continue
            state = track.motion.predict(t_s)
            is_seen = track.status == TrackStatus.SEEN
            centre[i] = track.last.centre_px if is_seen else self._in_picture(state, camera)[0]
            if camera is None:
                continue
            pos[i], vel[i], acc[i] = state.x, state.v, state.a
            cov[i] = state.cov
            cov[i, :3, :3] += np.eye(3) * track.pos_sd**2
            smooth[i], radius[i] = track.motion.smooth(), track.size
            if is_seen:
                seen[i], seen_sd[i] = track.last.where, track.seen_sd
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
            age_s=np.array([t_s - track.last.t_s for track in tracks], dtype=np.float64),
            centre_px=centre,
            area_px2=np.array([track.last.area_px2 for track in tracks], dtype=np.float64),
            is_manoeuvre=np.array([track.motion.is_manoeuvre for track in tracks], dtype=bool),
            is_blurred=np.array([track.is_blurred for track in tracks], dtype=bool),
            smooth_m=smooth,
            seen_m=seen,
            seen_sd_m=seen_sd,
        )
        self._tracks = [track for track in tracks if track.status != TrackStatus.LOST]
        return result
