"""Pick the threshold with a finite-sample promise of recall, per event and not per frame.

Frames of one approach are correlated, so each approach gives one score: the best that n of m
frames in a row reached, at the latest ``lead_s`` before contact. The threshold is the k-th
smallest such score with the largest k for which P(Beta(k, n + 1 - k) > alpha) <= 1 - confidence:
then at least 1 - alpha of events score above it, with that confidence (order statistics, free of
any distribution, void under domain shift). Source: ours.
"""

import math
from dataclasses import dataclass

import numpy as np

from apex_edge.errors import ApexError
from apex_edge.triggers.base import TriggerConfig
from apex_edge.types import Array
from offline_train.trigger.observe import Observed

# An event counts when its mover was clearly above the moving gate for this long before the lead:
# what has not yet visibly moved, nobody can announce.
VISIBLE_S = 0.5


class TooFewEventsError(ApexError):
    """Refuse a threshold that too few events stand behind."""

    slug = "too-few-events"


@dataclass(frozen=True)
class Promise:
    """Recall to certify: misses at most ``alpha``, with ``confidence``, ``lead_s`` ahead."""

    alpha: float = 0.01
    confidence: float = 0.95
    lead_s: float = 1.0


@dataclass(frozen=True)
class Threshold:
    """A certified threshold: ``logit``, the ``k``-th smallest of ``n_pos`` event scores.

    ``n_contacts`` all contacts watched up to the lead: n_pos / n_contacts is the eligible share.
    """

    logit: float
    k: int
    n_pos: int
    n_contacts: int


def certified_rank(n: int, alpha: float, confidence: float) -> int:
    """Return the largest rank k (1-based, 0 = none) whose promise holds with n events.

    P(Beta(k, n + 1 - k) > alpha) = P(Binomial(n, alpha) <= k - 1), so a binomial sum is enough.
    """
    total, rank = 0.0, 0
    for misses in range(n + 1):
        total += math.exp(_log_binomial(n, misses, alpha))
        if total > 1.0 - confidence:
            break
        rank = misses + 1
    return rank


def smallest_alpha(n: int, n_misses: int, confidence: float) -> float:
    """Return the smallest miss rate, in steps of 0.001, that n events with so many misses prove."""
    for step in range(1, 1000):
        if certified_rank(n, 0.001 * step, confidence) > n_misses:
            return 0.001 * step
    return 1.0


def calibrate(seen: Observed, logit: Array, config: TriggerConfig, promise: Promise) -> Threshold:
    """Choose the threshold on calibration scenes that the fit has not seen.

    Raises
    ------
    TooFewEventsError : the promise cannot be kept with this many events; says what could be.
    """
    scores = event_scores(seen, logit, config, promise.lead_s)
    n = len(scores)
    rank = certified_rank(n, promise.alpha, promise.confidence)
    best = 1.0 - (1.0 - promise.confidence) ** (1.0 / n) if n else 1.0
    if rank == 0:
        raise TooFewEventsError(
            f"{n} events cannot certify a recall of {1 - promise.alpha:.3f} at "
            f"{promise.confidence:.0%} confidence; at best {1 - best:.3f}. Generate more scenes."
        )
    chosen = float(np.sort(scores)[rank - 1])
    if not np.isfinite(chosen):
        n_never = int(np.sum(~np.isfinite(scores)))
        raise TooFewEventsError(
            f"{n_never} of {n} events never pass the moving gate and the vote, more than the "
            f"{rank - 1} that alpha = {promise.alpha} allows; with these scenes alpha = "
            f"{smallest_alpha(n, n_never, promise.confidence):.3f} can be certified"
        )
    return Threshold(chosen, rank, n, int(is_watched(seen, promise.lead_s).sum()))


def voted(seen: Observed, logit: Array, config: TriggerConfig) -> Array:
    """Return per pair and frame (n, f) the highest threshold at which the device would fire.

    -inf where it cannot: the pair fails the gates now, or too few recent frames pass them.
    """
    raw = np.full(seen.is_judged.shape, -np.inf)
    raw[seen.pair, seen.frame] = logit
    n_frames, n_hits = config.persist_frames, config.persist_hits
    padded = np.concatenate([np.full((len(raw), n_frames - 1), -np.inf), raw], axis=1)
    shifted = np.stack([padded[:, i : i + raw.shape[1]] for i in range(n_frames)], axis=2)
    best = np.sort(shifted, axis=2)[:, :, n_frames - n_hits]
    vote: Array = np.where(np.isfinite(raw), best, -np.inf)
    return vote


def is_watched(seen: Observed, lead_s: float) -> Array:
    """Say for which pairs (n,) contact comes no later than the watch plus the lead."""
    n_frames = seen.is_clear.shape[1]
    watched: Array = seen.contact_s - lead_s <= (n_frames - 1) * seen.frame_s
    return watched


def is_eligible(seen: Observed, lead_s: float) -> Array:
    """Say for which pairs (n,) contact comes and the mover was visible long enough before it."""
    time = np.arange(seen.is_clear.shape[1]) * seen.frame_s[:, None]
    in_time = seen.is_clear & (time <= (seen.contact_s - lead_s)[:, None])
    eligible: Array = is_watched(seen, lead_s) & (in_time.sum(axis=1) * seen.frame_s >= VISIBLE_S)
    return eligible


def event_scores(seen: Observed, logit: Array, config: TriggerConfig, lead_s: float) -> Array:
    """Return one score per eligible event (e,): the best vote up to ``lead_s`` before contact."""
    time = np.arange(seen.is_clear.shape[1]) * seen.frame_s[:, None]
    in_time = time <= (seen.contact_s - lead_s)[:, None]
    best = np.where(in_time, voted(seen, logit, config), -np.inf).max(axis=1)
    scores: Array = best[is_eligible(seen, lead_s)]
    return scores


def _log_binomial(n: int, k: int, p: float) -> float:
    choose = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
    return choose + k * math.log(p) + (n - k) * math.log1p(-p)
