"""Notice that the light or the white balance has moved away from the taught colours.

Every now and then the median colour of each object's inside is held against its model. Long before
the object is lost its chromaticity uses up most of what the model allows; then the user is told to
calibrate again. Costs about 0.1 ms per look at two objects, one frame in 15. Source: ours.
"""

import logging
import math
from typing import Dict

import numpy as np

from apex_edge.perception.colour import ColourTable
from apex_edge.perception.colour_model import ColourModel, distance2, features
from apex_edge.types import Array, Detections

LOG = logging.getLogger(__name__)

EVERY = 15
LIMIT = 0.6  # of the way from the middle of the colour to the edge of what is accepted
_SHARE = 0.2  # weight of the newest look
_UNCOVERED = 0.5  # of the pixels looked at; else a hand or a highlight is in front
_N_SURE = 5  # looks before anything is said


class DriftWatch:
    """Follow, per colour, how much of its tolerance the objects in view use up.

    A range imported from elsewhere has no middle that an object once had, so it is not watched.
    """

    def __init__(self, table: ColourTable) -> None:
        """Watch the taught colours of a table."""
        self._table = table
        self._models = {r.name: r for r in table.models if isinstance(r, ColourModel)}
        self._used: Dict[str, float] = {}
        self._n_looks: Dict[str, int] = {}
        self._n_frames = 0

    @property
    def used(self) -> Dict[str, float]:
        """Return per colour the share of its tolerance in use: 0 as taught, 1 about to be lost."""
        return {name: used for name, used in self._used.items() if self._n_looks[name] >= _N_SURE}

    @property
    def drifted(self) -> Dict[str, float]:
        """Return the colours that should be taught again, with the share in use."""
        return {name: used for name, used in self.used.items() if used > LIMIT}

    def see(self, bgr: Array, detections: Detections) -> None:
        """Look at one frame in ``EVERY``; warn once when a colour begins to drift away."""
        self._n_frames += 1
        if self._n_frames % EVERY:
            return
        before = set(self.drifted)
        for row, name in enumerate(detections.name):
            if name in self._models and not detections.touches_border[row]:
                self._look(name, _inside(bgr, detections.box_px[row]))
        for name in sorted(set(self.drifted) - before):
            LOG.warning(
                "colour %r has drifted: its objects use %.0f %% of what the colour file allows; "
                "fix the white balance or teach it again with apex calibrate colour",
                name,
                100.0 * self._used[name],
            )

    def _look(self, name: str, pixels: Array) -> None:
        model, label = self._models[name], self._table.names.index(name) + 1
        if np.mean(self._table.classify(pixels[None]) == label) < _UNCOVERED:
            return
        point = np.median(features(pixels), axis=0)[None]
        # brightness is no question of white balance
        point[0, 2] = model.log_luma
        dist2 = float(distance2(model, point)[0][0])
        used = min(1.0, math.sqrt(dist2 / model.gate)) if math.isfinite(dist2) else 1.0
        n_looks = self._n_looks.get(name, 0)
        share = max(_SHARE, 1.0 / (n_looks + 1))
        self._used[name] = (1.0 - share) * self._used.get(name, used) + share * used
        self._n_looks[name] = n_looks + 1


def _inside(bgr: Array, box_px: Array) -> Array:
    """Return some pixels (n, 3) from the middle half of a box, clear of its rim."""
    x, y, w, h = (int(value) for value in box_px)
    inner = bgr[y + h // 4 : y + h - h // 4, x + w // 4 : x + w - w // 4].reshape(-1, 3)
    result: Array = np.ascontiguousarray(inner[:: max(1, len(inner) // 64)])
    return result
