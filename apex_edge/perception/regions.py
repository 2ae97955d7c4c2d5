"""Regions of colour, taught or imported, and the 64 Ki tables they fill."""

from typing import Sequence, Union

import numpy as np

from apex_edge.perception.colour_model import ColourModel, word_features
from apex_edge.perception.lab_range import LabRange
from apex_edge.perception.lookup import N_WORDS
from apex_edge.types import Array

Region = Union[ColourModel, LabRange]


def label_table(regions: Sequence[Region]) -> Array:
    """Return the label, uint8 (65536,), of each BGR565 word: 0 background, i + 1 for regions[i].

    Where two colours claim a word the likelier one gets it.
    """
    table = np.zeros(N_WORDS, dtype=np.uint8)
    best = np.full(N_WORDS, -np.inf)
    for label, region in enumerate(regions, start=1):
        is_claimed, density = region.claim()
        wins = is_claimed & (density > best)
        table[wins] = label
        best[wins] = density[wins]
    return table


def coverage_table(region: Region) -> Array:
    """Return how much of a pixel of each BGR565 word is of the colour, uint8 (65536,), 255 = all.

    A pixel on an outline mixes object and surroundings; its saturation along the object's hue
    tells the share, where the surroundings are not of that hue.
    """
    chroma = np.asarray(region.chroma)
    share = word_features()[:, :2] @ chroma / float(chroma @ chroma)
    result: Array = np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)
    return result
