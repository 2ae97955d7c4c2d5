"""Which sighting belongs to which track: gates, then nearest pairs, then pairs untangled.

Source: ours. With up to 50 objects a global assignment solver is not worth a dependency: nearest
first goes wrong where two tracks want each other's sighting, and that is what the swap mends.
"""

from typing import Dict, List, Tuple

import numpy as np

from apex_edge.types import Array


def match(gaps: Array, gates: Array, is_second: Array) -> Dict[int, int]:
    """Return track -> sighting.

    Parameters
    ----------
    gaps : distances (k, m) between k predicted tracks and m sightings; inf forbids a pair.
    gates : largest distance (k,) at which a sighting may be the track's.
    is_second : tracks (k,) that choose after the others, as they were out of sight.
    """
    rows, columns = np.nonzero(gaps <= gates[:, None])
    order = np.lexsort((columns, rows, gaps[rows, columns], is_second[rows]))
    found: Dict[int, int] = {}
    taken = set()
    for row, column in zip(rows[order].tolist(), columns[order].tolist()):
        if row not in found and column not in taken:
            found[row] = column
            taken.add(column)
    return _untangle(found, gaps, gates)


def _untangle(found: Dict[int, int], gaps: Array, gates: Array) -> Dict[int, int]:
    """Exchange the sightings of two tracks wherever both together come nearer by it."""
    pairs: List[Tuple[int, int]] = [
        (a, b) for i, a in enumerate(sorted(found)) for b in sorted(found)[i + 1 :]
    ]
    for a, b in pairs:
        own = gaps[a, found[a]] ** 2 + gaps[b, found[b]] ** 2
        crossed = gaps[a, found[b]] ** 2 + gaps[b, found[a]] ** 2
        fits = gaps[a, found[b]] <= gates[a] and gaps[b, found[a]] <= gates[b]
        if fits and crossed < own:
            found[a], found[b] = found[b], found[a]
    return found
