"""Teach object colours from labelled discs of a picture, and refuse what cannot be told apart.

Every colour is a robust Gaussian over its disc's pixels. Its acceptance gate is then narrowed
until no more than ``MAX_FALSE`` of the background is taken for it. What is left is measured:
recall on the object, false positives on the background. Source: ours.
"""

import itertools
from dataclasses import asdict, dataclass, replace
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.errors import ColourError
from apex_edge.perception.colour_model import (
    GATE_999,
    LUMA_SD,
    ColourModel,
    distance2,
    features,
    model_from,
    word_features,
)
from apex_edge.perception.lookup import N_WORDS, words
from apex_edge.perception.regions import Region, label_table
from apex_edge.types import Array
from calib.verdict import Limit, Verdict, judge, worst

MIN_RECALL, REFUSED_RECALL = 0.98, 0.90
MAX_FALSE, REFUSED_FALSE = 0.001, 0.01
MAX_FOREIGN, REFUSED_FOREIGN = 0.15, 0.45
MIN_RADIUS_PX = 2.0
ZONE = 4.0  # the object is what hangs together with the disc within this many disc radii
_GATES = (GATE_999, 11.34, 7.81, 6.25)  # 99.9, 99, 95, 90 %
# From tolerant to strict. Motion blur washes a colour out, so the highest floor comes last.
_WIDTHS = tuple(itertools.product((LUMA_SD, 0.3, 0.2), _GATES, (0.5, 0.6, 0.7))) + tuple(
    itertools.product((LUMA_SD, 0.3, 0.2), _GATES, (0.8,))
)
_CORE_SHARE = 0.6  # of a disc's pixels taken as surely the object's while fitting


class _Ground(NamedTuple):
    """A picture's words (h, w) and which of its pixels count as background."""

    words: Array
    is_counted: Array


@dataclass(frozen=True)
class Sample:
    """A disc that shows one colour: centre and radius in pixels."""

    name: str
    x_px: float
    y_px: float
    radius_px: float


@dataclass(frozen=True)
class Quality:
    """How well one colour can be told: shares are of pixels, 0..1.

    ``recall`` of the disc's own pixels, ``false_share`` of the background, ``foreign_share`` of
    the disc that is not of the colour (highlight, edge), ``confused_with`` the other colour that
    takes most of its pixels, ``leak_share`` of the neighbourhood the colour runs out into.
    """

    name: str
    verdict: str
    reasons: Tuple[str, ...]
    recall: float
    false_share: float
    foreign_share: float
    leak_share: float
    confused_with: str
    confused_share: float
    n_pixels: int


@dataclass(frozen=True)
class ColourResult:
    """Models, their figures, and the labels (h, w) found in the picture itself."""

    models: Tuple[Region, ...]
    quality: Tuple[Quality, ...]
    labels: Array

    @property
    def verdict(self) -> Verdict:
        """Return the worst verdict of all colours, with every reason and whose it is."""
        reasons = [f"colour {q.name!r}: {reason}" for q in self.quality for reason in q.reasons]
        return Verdict(worst([quality.verdict for quality in self.quality]), tuple(reasons))

    def colours(self) -> List[Dict[str, Any]]:
        """Return the models as plain mappings for the colour file."""
        return [asdict(model) for model in self.models]

    def figures(self) -> Dict[str, Any]:
        """Return all figures as plain values, for the file and for ``--json``."""
        return {**self.verdict.plain(), "colours": [asdict(each) for each in self.quality]}


def solve(
    picture: Array,
    samples: Sequence[Sample],
    background: Optional[Array] = None,
    given: Optional[Mapping[str, Region]] = None,
) -> ColourResult:
    """Model each sampled colour and judge whether it can be used.

    Parameters
    ----------
    picture : shape (h, w, 3) uint8 BGR, with the objects in view.
    samples : discs inside the picture; several of one name are pooled.
    background : shape (h2, w2, 3) uint8 BGR without any of the objects, if there is one.
    given : colours that are not to be modelled but only judged, by name.

    Raises
    ------
    ColourError : no sample, a disc outside the picture or too small, a colour without hue, or one
        that ``given`` does not hold.
    """
    if not samples:
        raise ColourError("no sample given; name at least one disc as NAME:x,y,r")
    for sample in samples:
        _check(sample, picture.shape)
    names = tuple(dict.fromkeys(sample.name for sample in samples))
    discs = {name: _disc_mask(picture.shape, samples, name) for name in names}
    ring = {name: _disc_mask(picture.shape, samples, name, ZONE) for name in names}
    rest = ~np.logical_or.reduce([ring[name] for name in names])
    grounds = [_Ground(words(picture), rest)]
    if background is not None:
        grounds.append(_Ground(words(background), np.ones(background.shape[:2], dtype=bool)))
    models: List[Region] = []
    own = {}
    for name in names:
        model, own[name], luma_sd = _robust_core(name, features(picture[discs[name]]))
        if given is not None:
            models.append(_given(given, name))
            continue
        models.append(_narrow(model, grounds[0].words[discs[name]][own[name]], luma_sd, grounds))
    table = label_table(models)
    labels: Array = table[grounds[0].words]
    found = np.concatenate([table[ground.words[ground.is_counted]] for ground in grounds])
    quality = tuple(
        _judge(index + 1, names, labels, found, (discs[name], ring[name], own[name]))
        for index, name in enumerate(names)
    )
    return ColourResult(tuple(models), quality, labels)


def _given(given: Mapping[str, Region], name: str) -> Region:
    if name not in given:
        known = ", ".join(sorted(given)) or "none"
        raise ColourError(f"no range is named {name!r}; there are: {known}")
    return given[name]


def _check(sample: Sample, shape: Tuple[int, ...]) -> None:
    height, width = shape[:2]
    where = f"sample {sample.name}:{sample.x_px:g},{sample.y_px:g},{sample.radius_px:g}"
    if not sample.name.strip() or len(sample.name) > 64:
        raise ColourError(f"{where}: a name must have 1 to 64 characters")
    if not sample.radius_px >= MIN_RADIUS_PX:
        raise ColourError(f"{where}: radius must be at least {MIN_RADIUS_PX:g} px")
    is_inside = 0 <= sample.x_px <= width - 1 and 0 <= sample.y_px <= height - 1
    if not is_inside:
        raise ColourError(f"{where}: the centre lies outside the {width}x{height} picture")
    if sample.radius_px > max(width, height):
        raise ColourError(f"{where}: the disc is larger than the {width}x{height} picture")


def _disc_mask(
    shape: Tuple[int, ...], samples: Sequence[Sample], name: str, scale: float = 1.0
) -> Array:
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    mask = np.zeros(shape[:2], dtype=bool)
    for sample in samples:
        if sample.name == name:
            square = (columns - sample.x_px) ** 2 + (rows - sample.y_px) ** 2
            mask |= square <= (scale * sample.radius_px) ** 2
    return mask


def _robust_core(name: str, points: Array) -> Tuple[ColourModel, Array, float]:
    """Return a model, the mask (n,) of the pixels that are of it, and their log brightness sd.

    Starts at the median and keeps refitting to the closest 60 %, so that a highlight or a disc
    drawn a little too large does not shift the colour.
    """
    if len(points) < 9:
        raise ColourError(f"colour {name!r}: {len(points)} pixels in the disc, at least 9 needed")
    centre = np.median(points, axis=0)
    scale = 1.4826 * np.median(np.abs(points - centre), axis=0) + 1e-3
    order = np.argsort((((points - centre) / scale) ** 2).sum(axis=1))
    n_core = max(5, int(_CORE_SHARE * len(points)))
    core = order[:n_core]
    for _ in range(5):
        model = replace(model_from(name, points[core]), floor=0.0)
        core = np.argsort(distance2(model, points)[0], kind="stable")[:n_core]
    model = model_from(name, points[core])
    own = distance2(model, points)[0] <= GATE_999
    if own.sum() >= 3:
        model = model_from(name, points[own])
        own = distance2(model, points)[0] <= GATE_999
    return model, own, float(points[own, 2].std()) if own.any() else 0.0


def _narrow(
    model: ColourModel, own: Array, luma_sd: float, grounds: Sequence[_Ground]
) -> ColourModel:
    """Return the widest model that keeps the background out, or the best compromise there is.

    Widths are tried from the most tolerant on: acceptance gate, saturation floor, and how far
    the brightness may be off.
    """
    n_ground = max(1, sum(int(ground.is_counted.sum()) for ground in grounds))
    own_words = np.bincount(own, minlength=N_WORDS) / float(len(own))
    best, best_loss = model, np.inf
    for extra_sd, gate, floor in _WIDTHS:
        wide = replace(model, log_luma_sd=float(np.hypot(luma_sd, extra_sd)))
        trial = replace(wide, gate=gate, floor=floor)
        accepted = distance2(trial, word_features())[0] <= gate
        missed = 1.0 - float(own_words[accepted].sum())
        counts = np.sum([_false(accepted, ground) for ground in grounds], axis=0)
        false, blobs = counts / n_ground
        loss = 100.0 * max(0.0, false - 0.5 * MAX_FALSE) + max(0.0, missed - 0.01)
        loss += 300.0 * blobs
        if loss < best_loss:
            best, best_loss = trial, loss
        if best_loss <= 0.0:
            break
    return best


def _false(accepted: Array, ground: _Ground) -> Tuple[int, int]:
    """Return how many background pixels are taken, and how many of them hang together."""
    found = accepted[ground.words] & ground.is_counted
    solid = cv2.medianBlur(found.view(np.uint8), 5)
    return int(found.sum()), int(cv2.countNonZero(solid))


def _judge(
    label: int,
    names: Tuple[str, ...],
    labels: Array,
    ground_labels: Array,
    masks: Tuple[Array, Array, Array],
) -> Quality:
    disc, zone, own = masks
    name = names[label - 1]
    in_disc = labels[disc]
    own_labels = in_disc[own]
    n_own = max(1, len(own_labels))
    recall = float(np.mean(own_labels == label)) if len(own_labels) else 0.0
    others = np.bincount(own_labels, minlength=len(names) + 1)
    others[[0, label]] = 0
    rival = int(np.argmax(others))
    confused = float(others[rival]) / n_own
    foreign = 1.0 - float(np.mean(own))
    false = float(np.mean(ground_labels == label)) if len(ground_labels) else 0.0
    leak = _leak(labels == label, disc, zone)
    told = "{:.1%} of its pixels look like " + _braced(names[rival - 1])
    verdict = judge(
        [
            Limit(recall, MIN_RECALL, REFUSED_RECALL, "finds only {:.1%} of its own pixels", True),
            Limit(false, MAX_FALSE, REFUSED_FALSE, "takes {:.2%} of the background for the object"),
            Limit(foreign, MAX_FOREIGN, REFUSED_FOREIGN, "{:.0%} of the disc is not of one colour"),
            Limit(leak, 0.3, 0.6, "runs out into {:.0%} of the object's surroundings"),
            Limit(confused, 0.02, 0.10, told),
        ]
    )
    return Quality(
        name=name,
        verdict=verdict.grade,
        reasons=tuple(verdict.reasons),
        recall=recall,
        false_share=false,
        foreign_share=foreign,
        leak_share=leak,
        confused_with=names[rival - 1] if confused > 0.0 else "",
        confused_share=confused,
        n_pixels=int(disc.sum()),
    )


def _braced(name: str) -> str:
    """Return a name in quotes that can stand in a format."""
    return repr(name).replace("{", "{{").replace("}", "}}")


def _leak(found: Array, disc: Array, zone: Array) -> float:
    """Return the share of the zone's outer rim that the object's own blob reaches.

    A colour that is also the colour of its surroundings floods the zone to its edge.
    """
    inside = (found & zone).astype(np.uint8)
    _, parts = cv2.connectedComponents(inside, connectivity=8)
    own = np.unique(parts[disc & (inside > 0)])
    if not len(own):
        return 0.0
    rim = zone & (cv2.erode(zone.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    return float(np.mean(np.isin(parts[rim], own))) if rim.any() else 0.0
