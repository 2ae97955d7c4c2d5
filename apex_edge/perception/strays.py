"""Patches of an object colour that are far too small to be one of its objects.

How large a colour's objects are is learnt from what was seen of it in the last seconds, so that the
reflection or the scrap that is left when the object has gone is not taken for it. A patch in which
a track is expected is never one: a small object beside a large one keeps what it has. Source: ours.
"""

import math
from typing import Dict, List, Sequence

from apex_edge.perception.blobs import Blob
from apex_edge.perception.sharing import Outlook

_MEMORY_S = 5.0


class SizeMemory:
    """Remembers the largest area seen of each colour, fading.

    Parameters
    ----------
    share : a patch smaller than this share of the largest one is a stray.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self._largest: Dict[int, float] = {}
        self._t_s = 0.0

    def reset(self) -> None:
        """Forget all sizes."""
        self._largest = {}

    def without_strays(
        self, blobs: Sequence[Blob], t_s: float, outlook: Outlook, names: Sequence[str]
    ) -> List[Blob]:
        """Return the blobs of a frame at ``t_s`` that are large enough, or expected."""
        fade = math.exp(-max(t_s - self._t_s, 0.0) / _MEMORY_S)
        self._t_s = t_s
        self._largest = {label: fade * area for label, area in self._largest.items()}
        for blob in blobs:
            self._largest[blob.label] = max(self._largest.get(blob.label, 0.0), blob.area_px2)
        return [
            blob
            for blob in blobs
            if blob.area_px2 >= self._share * self._largest[blob.label]
            or _is_expected(blob, outlook, names[blob.label - 1])
        ]


def _is_expected(blob: Blob, outlook: Outlook, name: str) -> bool:
    x, y, w, h = blob.box_px
    return any(
        other == name and x <= centre[0] <= x + w and y <= centre[1] <= y + h
        for other, centre in zip(outlook.name, outlook.centre_px)
    )
