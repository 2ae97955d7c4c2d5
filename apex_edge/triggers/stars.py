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
    key = mover
    if group is not None:
        movers, key = np.unique(mover, return_inverse=True)
        key = key + np.unique(group, return_inverse=True)[1] * len(movers)
    _, first, star = np.unique(key, return_index=True, return_inverse=True)
    n_stars, n_pairs = len(first), len(mover)
    heading = _heading(pairs.mover_vel_m_s)
    nodes = np.zeros((n_stars + n_pairs, len(NODE_NAMES)))
    nodes[:n_stars, 0] = 1.0
    nodes[:n_stars, 3:5] = _turned(pairs.mover_vel_m_s, heading)[first]
    nodes[n_stars:, 1:3] = _turned(pairs.offset_m, heading)
    nodes[n_stars:, 3:5] = _turned(pairs.target_vel_m_s, heading)
    nodes[n_stars:, 5] = pairs.radius_m
    return Stars(nodes, np.stack([star, n_stars + np.arange(n_pairs)]))


def _heading(velocity: Array) -> Array:
    """Return unit vectors (m, 2); a resting mover looks along the first axis."""
    speed = np.sqrt(np.einsum("md,md->m", velocity, velocity))
    is_still = speed == 0.0
    heading: Array = velocity / np.where(is_still, 1.0, speed)[:, None]
    heading[is_still, 0] = 1.0
    return heading


def _turned(vectors: Array, heading: Array) -> Array:
    """Return vectors (m, 2) along and across the heading."""
    along = vectors[:, 0] * heading[:, 0] + vectors[:, 1] * heading[:, 1]
    across = vectors[:, 1] * heading[:, 0] - vectors[:, 0] * heading[:, 1]
    return np.stack([along, across], axis=1)
