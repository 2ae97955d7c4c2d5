"""One followed object: its motion, its usual size and shape, and how far a sighting is believed.

A sighting that is cut off, smeared or smaller than usual is off by more than its noise: what hides
a part of an object pulls the centre towards the rest. Its stated noise grows accordingly.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Deque, NamedTuple, Tuple

import numpy as np

from apex_edge.perception.estimator import Estimator
from apex_edge.types import Array, TrackStatus

_MEMORY = 15
_BORDER_NOISE = 4.0  # times the usual noise: what is cut off pulls the centre inwards
_PART_NOISE = 3.0
_BLUR_NOISE = 2.0
_USUAL = (0.85, 1.4)  # shares of the usual area that nothing needs to be said about
_PULL = 0.85  # of a radius is the centre off for the whole area missing; 0.42 for a half disc
_MAX_ODD = 300  # after so many odd sizes in a row (10 s at 30 Hz) that is the size
_SMEARED = 1.3  # times the usual elongation
_ALONG = 0.94  # cosine between long axis and motion, 20 degrees
_SWEEP = 0.3  # of a radius between two frames is the least motion that can smear


class Sighting(NamedTuple):
    """One detection as a track takes it.

    ``where (d,)`` in px or m, ``unit`` that is one pixel there, ``size`` its radius and ``pos_sd``
    its systematic error in the same unit; the rest as in ``Detections``.
    """

    t_s: float
    where: Array
    unit: float
    size: float
    pos_sd: float
    centre_px: Array
    box_px: Array
    area_px2: float
    spread_px2: Array
    touches_border: bool
    is_part: bool


@dataclass
class Track:
    """What is known of one object; fed by ``see``."""

    track_id: int
    name: str
    motion: Estimator
    first: Sighting
    noise_px: float
    status: TrackStatus = TrackStatus.SEEN
    is_hidden: bool = False
    is_blurred: bool = False
    last: Sighting = field(init=False)
    pos_sd: float = field(init=False)
    seen_sd: float = field(init=False)
    _sizes: Deque[float] = field(default_factory=lambda: deque(maxlen=_MEMORY))
    _areas: Deque[float] = field(default_factory=lambda: deque(maxlen=_MEMORY))
    _shapes: Deque[float] = field(default_factory=lambda: deque(maxlen=_MEMORY))
    _n_odd: int = 0

    def __post_init__(self) -> None:
        """Take the sighting that started it."""
        self.last = self.first
        self.see(self.first)

    @property
    def size(self) -> float:
        """Return the radius, px or m: the median of the last sightings."""
        return float(median(self._sizes))

    @property
    def radius_px(self) -> float:
        """Return the radius in the picture that its usual area has where it was last seen."""
        return math.sqrt(median(self._areas) / math.pi) / self.last.unit

    @property
    def is_there(self) -> bool:
        """Say whether the newest frame showed it, or a blob it was hidden in."""
        return self.status == TrackStatus.SEEN or self.is_hidden

    def see(self, sighting: Sighting) -> None:
        """Take a sighting into motion, size and shape."""
        elongation, along = _shape(sighting.spread_px2)
        step = sighting.centre_px - self.last.centre_px
        sweep = float(np.hypot(step[0], step[1]))
        self.is_blurred = (
            bool(self._shapes)
            and elongation > _SMEARED * median(self._shapes)
            and sweep > _SWEEP * math.sqrt(sighting.area_px2 / math.pi)
            and abs(float(step @ along)) > _ALONG * sweep
        )
        noise, pull = self.noise_px * sighting.unit * self._doubt(sighting), self._pull(sighting)
        self.seen_sd = math.hypot(noise, pull)
        self.motion.add(sighting.t_s, sighting.where, self.seen_sd)
        self.pos_sd = math.hypot(sighting.pos_sd, pull)
        self._remember(sighting, elongation)
        self.last, self.status = sighting, TrackStatus.SEEN

    def _doubt(self, sighting: Sighting) -> float:
        """Return by how much a sighting is noisier than a plain one."""
        if sighting.touches_border:
            return _BORDER_NOISE
        if sighting.is_part:
            return _PART_NOISE
        return _BLUR_NOISE if self.is_blurred else 1.0

    def _share(self, sighting: Sighting) -> float:
        """Return the area of a sighting as a share of the usual one."""
        return sighting.area_px2 * sighting.unit**2 / median(self._areas) if self._areas else 1.0

    def _pull(self, sighting: Sighting) -> float:
        """Return how far the centre may be off because a part is hidden, or more than it shows."""
        share = self._share(sighting)
        if _USUAL[0] <= share <= _USUAL[1] or sighting.is_part or self.is_blurred:
            return 0.0
        missing = 1.0 - min(share, 1.0 / share)
        return _PULL * missing * self.radius_px * sighting.unit

    def _remember(self, sighting: Sighting, elongation: float) -> None:
        """Keep size and shape, unless they say only what hides the object just now."""
        if sighting.is_part:
            return
        is_odd = not _USUAL[0] <= self._share(sighting) <= _USUAL[1]
        self._n_odd = self._n_odd + 1 if is_odd else 0
        is_believed = len(self._areas) < 3 or not (is_odd or sighting.touches_border)
        if self._n_odd > _MAX_ODD:
            self._areas.clear()
            is_believed = True
        self._sizes.append(sighting.size)
        if is_believed:
            self._areas.append(sighting.area_px2 * sighting.unit**2)
        if is_believed and not self.is_blurred:
            self._shapes.append(elongation)


def _shape(spread_px2: Array) -> Tuple[float, Array]:
    """Return length over width of a blob, by its second moments, and its long axis (2,)."""
    xx, xy, yy = (float(value) for value in spread_px2)
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    least = max(middle - half, 1e-3)
    return math.sqrt((middle + half) / least), np.array([math.cos(angle), math.sin(angle)])
