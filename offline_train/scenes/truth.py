"""What really moves: the paths of the bodies of many scenes, and when they touch.

A scene is a star: one centre body (the protected object, or simply the target) and k others.
Each scenario is a module with ``NAME``, ``VERSION``, ``KINDS`` and
``draw(rng, frame_s, n_frames) -> Truth``, published under the entry-point group
``apex_edge.scenarios``. Source: APEX appendix "Graph Models" (star graphs); the form is ours.
"""

from dataclasses import dataclass
from typing import Any, Callable, Tuple

import numpy as np

from apex_edge import plugins
from apex_edge.types import Array

# How far beyond the last frame contacts are looked for: the longest horizon a trigger is asked for.
LOOK_AHEAD_S = 5.0
_STEP_S = 0.01
_CHUNK = 100


@dataclass(frozen=True)
class Truth:
    """s scenes of f frames: a centre body and k others each, in the table plane.

    ``centre_m (s, f, 2)``, ``other_m (s, k, f, 2)``; ``contact_s (s, k)`` time of the first contact
    of that pair, inf if none until ``LOOK_AHEAD_S`` after the last frame; ``radius_m (s, k)`` of
    both together; ``kind (s, k)`` index into the scenario's ``KINDS``; ``frame_s (s,)``.
    """

    centre_m: Array
    other_m: Array
    contact_s: Array
    radius_m: Array
    kind: Array
    frame_s: Array


def scenario(name: str) -> Any:
    """Return the scenario module of a name.

    Raises
    ------
    PluginError : no such scenario, or a package it needs is missing.
    """
    return plugins.load("scenarios", name)


def first_contact(
    place: Callable[[Array], Tuple[Array, Array]], radius_m: Array, until_s: float
) -> Array:
    """Return the first time (n,) at which two bodies touch, inf when never; see ``passing``."""
    return passing(place, radius_m, until_s)[0]


def passing(
    place: Callable[[Array], Tuple[Array, Array]], radius_m: Array, until_s: float
) -> Tuple[Array, Array]:
    """Follow pairs of bodies in steps of 10 ms.

    Parameters
    ----------
    place : maps times (n, c) to the positions of both bodies, (n, c, 2) each.
    radius_m : (n,) of both together.

    Returns
    -------
    The first time (n,) at which they touch, inf when never, and the smallest distance (n,) between
    their centres in metres.
    """
    times = np.arange(0.0, until_s + _STEP_S, _STEP_S)
    found, nearest = np.full(len(radius_m), np.inf), np.full(len(radius_m), np.inf)
    for first in range(0, len(times), _CHUNK):
        span = times[first : first + _CHUNK]
        one, other = place(np.broadcast_to(span, (len(found), len(span))))
        gap = np.linalg.norm(one - other, axis=2)
        is_in = gap <= radius_m[:, None]
        hit = np.where(is_in.any(axis=1), span[np.argmax(is_in, axis=1)], np.inf)
        found = np.minimum(found, hit)
        nearest = np.minimum(nearest, gap.min(axis=1))
    return found, nearest
