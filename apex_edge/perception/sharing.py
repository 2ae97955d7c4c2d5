"""Blobs that are not the whole of one object: find the objects by what outline is left of them.

Where two balls touch or overlap their blobs melt together, and the middle of the whole is the
place of neither; where a hand covers a part, the middle of the rest is off by up to half a radius.
Each object's size is known from before, so its centre follows from the arc of the outline that is
still its own: a circle of known radius, fitted by least squares. Where no arc is left, or two are
expected in one place, nothing is reported: the tracks are carried on by their motion instead of
exchanging their names. Source: ours.
"""

from dataclasses import replace
from typing import Dict, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from apex_edge.perception.blobs import Blob, Box
from apex_edge.types import Array

_N_ROUNDS = 6
# Of a radius: outline points farther off belong to nothing expected. Narrowing, so that the edge of
# what covers an object lets go of the circle.
_REACH, _LAST_REACH = 0.4, 0.2
_COVERED = 0.85  # of its usual area; below, something hides a part of the object
# A block never was round: a covered ball's outline is off its own circle by more, and the arc that
# is left on the known circle by less (of a radius).
_OWN_MISFIT, _ARC_MISFIT, _LEAST_ARC = 0.12, 0.06, 0.4
_MIN_ARC = 0.2  # of a circle's outline
_MIN_SPREAD = 0.05  # least eigenvalue of the arc's directions; 0.09 is an arc of 60 degrees
_MAX_RESIDUAL = 0.15  # of a radius; a square's outline is 0.11 off its circle
# Of the outline may belong to nothing expected: of several objects little, of one that is covered
# the whole edge of what covers it.
_MAX_STRAY, _MAX_COVERED = 0.25, 0.5
_SAME_PLACE = 0.5  # of a radius: two expected this near cannot be told apart
_CHAIN = 5.66  # outline pixels of a circle, per radius
STEP_S = 0.25
_WHOLE = 1.35  # a blob of up to this many times an object's area may be that object alone


class Outlook(NamedTuple):
    """Where n tracks are expected in the picture.

    ``name``, ``centre_px (n, 2)``, ``step_px (n, 2)`` what each moves within ``STEP_S``,
    ``radius_px (n,)``, ``is_there (n,)`` seen or hidden in the frame before: of a track missed for
    longer nobody knows that it is not the very object found now; the window ``box`` to look in.
    ``is_scaled`` says that the sizes are true at any distance: without a calibration a ball that is
    smeared and farther away looks like one that is covered.
    """

    name: Tuple[str, ...]
    centre_px: Array
    step_px: Array
    radius_px: Array
    is_there: Array
    box: Tuple[Box, ...]
    is_scaled: bool


def part(
    blobs: Sequence[Blob], outlook: Outlook, names: Sequence[str]
) -> Tuple[List[Blob], Set[int]]:
    """Cut blobs that several tracks share.

    Parameters
    ----------
    blobs : what was found.
    outlook : what was expected.
    names : colour of each label, ``names[label - 1]``.

    Returns
    -------
    blobs, with shared ones replaced by what can be told apart in them; the rows of ``outlook``
    that are hidden in a blob.
    """
    shares = _shares(blobs, outlook, names)
    kept: List[Blob] = []
    hidden: Set[int] = set()
    for index, blob in enumerate(blobs):
        rows = shares.get(index, [])
        if len(rows) < 2:
            kept.append(_completed(blob, outlook, rows))
            continue
        pieces = _cut(blob, outlook.centre_px[rows], outlook.radius_px[rows])
        if not any(pieces) and _is_one_object(blob, outlook, rows):
            kept.append(blob)
            continue
        kept.extend(piece for piece in pieces if piece is not None)
        hidden.update(row for row, piece in zip(rows, pieces) if piece is None)
    return kept, hidden


def _shares(blobs: Sequence[Blob], outlook: Outlook, names: Sequence[str]) -> Dict[int, List[int]]:
    """Return blob -> the rows expected in it; a row goes to the nearest blob of its colour."""
    shares: Dict[int, List[int]] = {}
    for row, name in enumerate(outlook.name):
        if not outlook.is_there[row]:
            continue
        centre, radius = outlook.centre_px[row], float(outlook.radius_px[row])
        best, best_gap = -1, radius
        for index, blob in enumerate(blobs):
            if names[blob.label - 1] != name:
                continue
            gap = _gap(blob, centre)
            if gap < best_gap:
                best, best_gap = index, gap
        if best >= 0:
            shares.setdefault(best, []).append(row)
    return shares


def _gap(blob: Blob, centre: Array) -> float:
    """Return how far a point lies outside a blob's box (0 inside)."""
    x, y, w, h = blob.box_px
    dx = max(x - centre[0], 0.0, centre[0] - (x + w))
    dy = max(y - centre[1], 0.0, centre[1] - (y + h))
    return float(np.hypot(dx, dy))


def _completed(blob: Blob, outlook: Outlook, rows: List[int]) -> Blob:
    """Return the whole object of a blob that shows less of it than usual; else the blob."""
    radii = outlook.radius_px[rows]
    is_one = outlook.is_scaled and len(rows) == 1
    is_covered = is_one and blob.area_px2 < _COVERED * np.pi * float(radii[0]) ** 2
    if not is_covered or blob.touches_border:
        return blob
    outline, radius = blob.outline_px().astype(np.float64), float(radii[0])
    own = np.linalg.norm(outline - np.array(blob.centre_px), axis=1)
    if float(own.std()) < _OWN_MISFIT * float(own.mean()):
        return blob
    fitted, owner, is_visible = _fit(outline, outlook.centre_px[rows], radii)
    arc = outline[owner == 0]
    is_arc = is_visible[0] and len(arc) >= _LEAST_ARC * _CHAIN * radius
    if not is_arc or np.mean(owner < 0) > _MAX_COVERED:
        return blob
    miss = np.linalg.norm(arc - fitted[0], axis=1) - radius
    if float(np.sqrt(np.mean(miss * miss))) > _ARC_MISFIT * radius + 0.5:
        return blob
    return _piece(blob, fitted, radii, 0, arc)


def _is_one_object(blob: Blob, outlook: Outlook, rows: List[int]) -> bool:
    """Say whether tracks that share a blob were pieces of one object, cut in two for a while.

    They do not move against each other, and the blob is no larger than the largest of them could
    be whole; objects that cross do move.
    """
    steps, radii = outlook.step_px[rows], outlook.radius_px[rows]
    apart = np.linalg.norm(steps[:, None] - steps[None], axis=2).max()
    return bool(
        apart < _SAME_PLACE * radii.max() and blob.area_px2 <= _WHOLE * np.pi * np.sum(radii**2)
    )


def _cut(blob: Blob, centres: Array, radii: Array) -> List[Optional[Blob]]:
    """Return the piece of each expected object, None where it cannot be told."""
    nothing: List[Optional[Blob]] = [None] * len(radii)
    if _are_in_one_place(centres, radii):
        return nothing
    outline = blob.outline_px().astype(np.float64)
    fitted, own, is_visible = _fit(outline, centres, radii)
    if np.mean(own < 0) > _MAX_STRAY or not is_visible.any():
        return nothing
    if _are_in_one_place(fitted, radii):
        return nothing
    return [
        _piece(blob, fitted, radii, row, outline[own == row]) if is_visible[row] else None
        for row in range(len(radii))
    ]


def _are_in_one_place(centres: Array, radii: Array) -> bool:
    gaps = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    gaps[np.diag_indices(len(gaps))] = np.inf
    return bool((gaps < _SAME_PLACE * radii[:, None]).any())


def _fit(outline: Array, centres: Array, radii: Array) -> Tuple[Array, Array, Array]:
    """Fit circles of known radii (m,) to outline points (k, 2), starting at ``centres`` (m, 2).

    Returns
    -------
    centres (m, 2), the circle each point belongs to (k,) (-1 none), and which circles (m,) show
    enough of themselves to be believed.
    """
    fitted = centres.copy()
    own = np.full(len(outline), -1)
    is_visible = np.zeros(len(radii), dtype=bool)
    for reach_share in np.linspace(_REACH, _LAST_REACH, _N_ROUNDS):
        away = outline[:, None] - fitted[None]
        reach = np.linalg.norm(away, axis=2)
        miss = reach - radii
        own = np.argmin(np.abs(miss), axis=1)
        own[np.abs(miss).min(axis=1) > reach_share * radii[own]] = -1
        for row, radius in enumerate(radii):
            mine = own == row
            n = int(mine.sum())
            is_visible[row] = n >= _MIN_ARC * _CHAIN * radius
            if not is_visible[row]:
                continue
            toward = away[mine, row] / np.maximum(reach[mine, row], 1e-9)[:, None]
            normal = toward.T @ toward
            is_visible[row] = np.linalg.eigvalsh(normal)[0] >= _MIN_SPREAD * n
            if is_visible[row]:
                fitted[row] += np.linalg.solve(normal, toward.T @ miss[mine, row])
            rms = float(np.sqrt(np.mean(miss[mine, row] ** 2)))
            is_visible[row] &= rms <= max(1.0, _MAX_RESIDUAL * radius)
    return fitted, own, is_visible


def _piece(blob: Blob, centres: Array, radii: Array, row: int, outline: Array) -> Blob:
    """Return one object of a shared blob, with the part of the body that is nearest to it."""
    rows, columns = np.nonzero(blob.body)
    points = np.column_stack([columns, rows]) + np.array(blob.origin_px, dtype=np.float64)
    share = np.linalg.norm(points[:, None] - centres[None], axis=2) / radii
    mine = np.argmin(share, axis=1) == row
    body = np.zeros_like(blob.body)
    body[rows[mine], columns[mine]] = blob.body[rows[mine], columns[mine]]
    (x, y), radius = centres[row].tolist(), float(radii[row])
    low, high = np.floor([x - radius, y - radius]), np.ceil([x + radius, y + radius])
    contour = outline.astype(np.int32)[:, None] - np.array(blob.window_px, dtype=np.int32)
    return replace(
        blob,
        centre_px=(x, y),
        area_px2=float(np.pi * radius**2),
        box_px=(int(low[0]), int(low[1]), int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1),
        body=body,
        spread_px2=(0.25 * radius**2, 0.0, 0.25 * radius**2),
        contours=(contour,),
        is_part=True,
    )
