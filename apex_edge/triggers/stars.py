"""The star around each mover of a frame: nodes and edges for a graph net.

One source for the trainer and the device. Each mover is the centre of a star of its own, with an
edge outward to every object it is paired with, so an object near two movers is a node of both
stars. Node features are in the mover's axes (x along its velocity): how a pair lies on the table
says nothing about contact, and a net need not learn that.
Source: APEX section "Trigger" (edges from the moving object to the others); axes and features ours.
"""

from typing import NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.triggers.approach import Pairs
from apex_edge.types import Array

NODE_NAMES: Tuple[str, ...] = ("is_mover", "x", "y", "vx", "vy", "radius")
"""What ``stars`` knows of a node. ``x``, ``y`` from the mover, ``radius`` of mover and target
together (0 at the mover)."""
NODE_UNITS: Tuple[str, ...] = ("1", "m", "m", "m/s", "m/s", "m")


class Stars(NamedTuple):
    """Stars of m pairs: ``nodes (N, 6)`` by NODE_NAMES, ``edges (2, m)`` mover -> target.

    Edge r is pair r. N is the number of stars plus m: centres come first, then the targets.
    """

    nodes: Array
    edges: Array


def stars(pairs: Pairs, mover: Array, group: Optional[Array] = None) -> Stars:
    """Return one star per mover, in the plane.

    Parameters
    ----------
    pairs : m pairs, d = 2.
    mover : (m,) identity of each pair's mover, whole numbers.
    group : (m,) identity of the frame each pair is from; None = all from one frame.
    """
    star, first = _star_of(mover, group)
    n_stars, n_pairs = len(first), len(mover)
    nodes = np.zeros((len(NODE_NAMES), n_stars + n_pairs))
    targets = nodes[:, n_stars:]
    speed, cos, sin = _heading(pairs.mover_vel_m_s)
    nodes[0, :n_stars] = 1.0
    nodes[3, :n_stars] = speed[first]
    # Places and velocities in one go: x and vx are rows 1 and 3, y and vy rows 2 and 4.
    x = np.array((pairs.offset_m[:, 0], pairs.target_vel_m_s[:, 0]))
    y = np.array((pairs.offset_m[:, 1], pairs.target_vel_m_s[:, 1]))
    targets[1:4:2] = x * cos + y * sin
    targets[2:5:2] = y * cos - x * sin
    targets[5] = pairs.radius_m
    edges = np.empty((2, n_pairs), dtype=np.intp)
    edges[0] = star
    edges[1] = np.arange(n_stars, n_stars + n_pairs)
    return Stars(nodes.T, edges)


def nodes_as(nodes: Array, names: Tuple[str, ...]) -> Array:
    """Return the columns (N, F) of ``Stars.nodes`` that a model reads, in its order."""
    if names == NODE_NAMES:
        return nodes
    columns: Array = nodes[:, [NODE_NAMES.index(name) for name in names]]
    return columns


def _star_of(mover: Array, group: Optional[Array]) -> Tuple[Array, Array]:
    """Return the star (m,) of each pair and the first pair (s,) of each star."""
    key = mover
    if group is not None:
        movers, key = np.unique(mover, return_inverse=True)
        key = key + np.unique(group, return_inverse=True)[1] * len(movers)
    elif len(mover) and (mover == mover[0]).all():
        # One mover at a time is the usual case, and np.unique takes as long as the whole net.
        return np.zeros(len(mover), dtype=np.intp), np.zeros(1, dtype=np.intp)
    _, first, star = np.unique(key, return_index=True, return_inverse=True)
    return star, first


def _heading(velocity: Array) -> Tuple[Array, Array, Array]:
    """Return speed, cosine and sine (m,); a mover at rest looks along the first axis."""
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    moves = speed > 0.0
    safe = np.where(moves, speed, 1.0)
    return speed, np.where(moves, velocity[:, 0], 1.0) / safe, velocity[:, 1] / safe
