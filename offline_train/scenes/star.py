"""Star graphs of one master and its targets: the paper's generator, and one that does not leak.

The paper's set gives itself away: a planted target moves at distance / 3 s, all others at 0.5 to
1, so "faster than 1" alone finds 98.9 % of them without a false alarm. In the hard set all targets
share one distribution of speed and half of them are aimed, most of those to pass by.
Lengths are in units of the paper's box, not metres; the master moves too.
Source: APEX appendix "Training of DG-Motion Attention"; the hard set is ours.
"""

from dataclasses import dataclass
from typing import Tuple

import numpy as np

from apex_edge.triggers.approach import Pairs, closest, first_contact
from apex_edge.triggers.features import edge_features
from apex_edge.types import Array
from offline_train.trigger.metrics import sigmoid
from offline_train.trigger.seeds import rng

N_NODES = 6
DT_S = 0.01
INTERCEPT_S = 3.0
HORIZON_S = 5.0
RADIUS = 1.0
RISK_TAU = 0.75
_BOX = 10.0
_SLOW = (0.5, 1.0)
_HARD_SPEED = (0.5, 6.0)
_HARD_MISS = (0.0, 4.0)
_WEIGHTS = (0.34, 0.33, 0.33)
NODE_NAMES: Tuple[str, ...] = ("is_master", "x", "y", "z", "vx", "vy", "vz")
EDGE_NAMES: Tuple[str, ...] = ("inverse_distance", "cos", "speed")


@dataclass(frozen=True)
class StarSet:
    """g star graphs of n nodes, the master first; lengths in units, speeds in units per second.

    ``node_t``, ``node_dt (g, n, 7)`` as ``NODE_NAMES``, now and ``DT_S`` later; per edge
    (g, n - 1): ``designed`` planted to meet (hard set: aimed), ``truth`` contact within
    ``HORIZON_S`` at constant velocity, ``risk`` the score as the released code computes it (cosine
    of moving away, displacement over ``DT_S`` as speed, the master ``INTERCEPT_S`` later as
    reference; it never reaches ``RISK_TAU``), ``risk_fixed`` with these three put right.
    """

    node_t: Array
    node_dt: Array
    designed: Array
    truth: Array
    risk: Array
    risk_fixed: Array

    def take(self, graphs: Array) -> "StarSet":
        """Return the graphs chosen by a mask, a slice or indices."""
        return StarSet(*(column[graphs] for column in vars(self).values()))


def paper_stars(purpose: str, seed: int, n_graphs: int, n_nodes: int = N_NODES) -> StarSet:
    """Draw the paper's stars of a purpose and a seed; see ``draw_paper_stars``."""
    return draw_paper_stars(rng(purpose, seed), n_graphs, n_nodes)


def draw_paper_stars(random: np.random.Generator, n_graphs: int, n_nodes: int = N_NODES) -> StarSet:
    """Draw the paper's stars; every second one, from the second on, has a planted target.

    Source: APEX appendix "Training data generation".
    """
    place = random.uniform(-_BOX, _BOX, (n_graphs, n_nodes, 3))
    speed = random.uniform(_SLOW[0], _SLOW[1], (n_graphs, n_nodes, 1))
    velocity = speed * _directions(random, (n_graphs, n_nodes))
    chosen = random.integers(1, n_nodes, n_graphs)
    hit = np.arange(1, n_graphs, 2)
    meet = place[hit, 0] + INTERCEPT_S * velocity[hit, 0]
    velocity[hit, chosen[hit]] = (meet - place[hit, chosen[hit]]) / INTERCEPT_S
    designed = np.zeros((n_graphs, n_nodes - 1), dtype=bool)
    designed[hit, chosen[hit] - 1] = True
    return _complete(place, velocity, designed)


def hard_stars(purpose: str, seed: int, n_graphs: int, n_nodes: int = N_NODES) -> StarSet:
    """Draw the leak-free stars of a purpose and a seed; see ``draw_hard_stars``."""
    return draw_hard_stars(rng(purpose, seed), n_graphs, n_nodes)


def draw_hard_stars(random: np.random.Generator, n_graphs: int, n_nodes: int = N_NODES) -> StarSet:
    """Draw the leak-free stars: one distribution of speed, half the targets aimed with a miss.

    An aimed target heads for where the master will be when it gets there, shifted by the miss in
    a random direction; the part of it along the way does not count. 11.5 % truly touch.
    Source: ours.
    """
    shape = (n_graphs, n_nodes - 1)
    place = random.uniform(-_BOX, _BOX, (n_graphs, n_nodes, 3))
    velocity = np.empty_like(place)
    slow = random.uniform(_SLOW[0], _SLOW[1], (n_graphs, 1))
    velocity[:, 0] = slow * _directions(random, (n_graphs,))
    speed = random.uniform(_HARD_SPEED[0], _HARD_SPEED[1], (*shape, 1))
    is_aimed = random.random(shape) < 0.5
    miss = random.uniform(_HARD_MISS[0], _HARD_MISS[1], (*shape, 1))
    free = _directions(random, shape)
    aside = _directions(random, shape)
    to_master = place[:, :1] - place[:, 1:]
    lead_s = _meeting_time(to_master, velocity[:, :1], speed[..., 0])
    aimed = _unit(to_master + lead_s[..., None] * velocity[:, :1] + miss * aside)
    velocity[:, 1:] = speed * np.where(is_aimed[..., None], aimed, free)
    return _complete(place, velocity, is_aimed)


def star_pairs(stars: StarSet) -> Pairs:
    """Return the g * (n - 1) edges as exact pairs in 3-D, the master as the target."""
    master, target = stars.node_t[:, :1], stars.node_t[:, 1:]
    shape = target.shape[:2] + (3,)
    n_edges = shape[0] * shape[1]
    return Pairs(
        offset_m=(master - target)[..., 1:4].reshape(n_edges, 3),
        mover_vel_m_s=target[..., 4:].reshape(n_edges, 3),
        target_vel_m_s=np.broadcast_to(master[..., 4:], shape).reshape(n_edges, 3),
        decel_m_s2=np.zeros(n_edges),
        radius_m=np.full(n_edges, RADIUS),
        cov=np.zeros((n_edges, 6, 6)),
    )


def pair_features(stars: StarSet) -> Array:
    """Return the device's pair features (g * (n - 1), k) of the edges, in three dimensions.

    The states are exact (zero covariance), so z and reach are as good as signs: the answer itself.
    """
    pairs = star_pairs(stars)
    return edge_features(pairs, closest(pairs, HORIZON_S), HORIZON_S)


def paper_edges(stars: StarSet, is_raw_displacement: bool = False) -> Array:
    """Return the paper's edge features (g, n - 1, 3) as ``EDGE_NAMES``.

    1 / distance, the cosine between the way to the master and the motion, and the speed: in units
    per second, or as the displacement over ``DT_S`` that the released code feeds in.
    Source: APEX appendix "DiffGraphormer".
    """
    moved = (stars.node_dt - stars.node_t)[:, 1:, 1:4]
    to_master = (stars.node_dt[:, :1] - stars.node_dt[:, 1:])[..., 1:4]
    distance, step = _norm(to_master), _norm(moved)
    cosine = _dot(_unit(to_master), _unit(moved))
    speed = step if is_raw_displacement else step / DT_S
    return np.stack([1.0 / (distance + 1e-6), cosine, speed], axis=-1)


def _complete(place: Array, velocity: Array, designed: Array) -> StarSet:
    is_master = np.zeros(place.shape[:2] + (1,))
    is_master[:, 0] = 1.0
    later = place + DT_S * velocity
    node_t = np.concatenate([is_master, place, velocity], axis=-1)
    node_dt = np.concatenate([is_master, later, velocity], axis=-1)
    blank = np.zeros(designed.shape)
    stars = StarSet(node_t, node_dt, designed, designed, blank, blank)
    pairs = star_pairs(stars)
    contact_s = first_contact(pairs, closest(pairs, HORIZON_S), HORIZON_S)
    meet = place[:, :1] + INTERCEPT_S * velocity[:, :1]
    to_meet, to_master = meet - later[:, 1:], later[:, :1] - later[:, 1:]
    heading, speed = _unit(velocity[:, 1:]), _norm(velocity[:, 1:])
    return StarSet(
        node_t=node_t,
        node_dt=node_dt,
        designed=designed,
        truth=np.isfinite(contact_s).reshape(designed.shape),
        risk=risk_score(_norm(to_meet), -_dot(_unit(to_meet), heading), DT_S * speed),
        risk_fixed=risk_score(_norm(to_master), _dot(_unit(to_master), heading), speed),
    )


def risk_score(distance: Array, cosine: Array, speed: Array) -> Array:
    """Return the paper's risk of targets: near, heading for the master, and fast.

    Source: APEX appendix "Training of DG-Motion Attention"; the constants are the released code's.
    """
    near = sigmoid(1.0 / (distance + 1e-6))
    fast = sigmoid(1.5 * (speed - 2.5))
    score: Array = _WEIGHTS[0] * near + _WEIGHTS[1] * (cosine + 1.0) / 2.0 + _WEIGHTS[2] * fast
    return score


def _meeting_time(to_master: Array, master_velocity: Array, speed: Array) -> Array:
    """Return when a target (g, n - 1) of this speed first meets the master; if never, 0."""
    quad = _dot(master_velocity, master_velocity) - speed * speed
    half = _dot(to_master, np.broadcast_to(master_velocity, to_master.shape))
    gap_sq = _dot(to_master, to_master)
    disc = half * half - quad * gap_sq
    root = np.sqrt(np.maximum(disc, 0.0))
    # with quad < 0 (the target is faster) exactly one of the two times lies ahead
    both = np.stack([(-half - root) / quad, (-half + root) / quad])
    both = np.where((both > 0.0) & (disc >= 0.0), both, np.inf)
    first = both.min(axis=0)
    when: Array = np.where(np.isfinite(first), first, 0.0)
    return when


def _directions(random: np.random.Generator, shape: Tuple[int, ...]) -> Array:
    return _unit(random.normal(size=(*shape, 3)))


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.sum(a * b, axis=-1)
    return product


def _norm(vectors: Array) -> Array:
    length: Array = np.sqrt(_dot(vectors, vectors))
    return length


def _unit(vectors: Array) -> Array:
    length = _norm(vectors)[..., None]
    unit: Array = vectors / np.where(length > 0.0, length, 1.0)
    return unit
