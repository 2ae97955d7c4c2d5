"""Charts of the report as inline SVG: where the time goes, and what happened when."""

import math
from typing import List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.record.html import esc
from apex_edge.record.summary import SceneResult

WIDTH = 640


class Spread(NamedTuple):
    """Median and 95th percentile of some times in milliseconds."""

    name: str
    median_ms: float
    p95_ms: float
    n: int


def spread_of(name: str, times_s: Sequence[float]) -> Spread:
    """Sum up some times; NaN when there are none."""
    known = np.array([t for t in times_s if math.isfinite(t)], dtype=np.float64) * 1000.0
    if not known.size:
        return Spread(name, math.nan, math.nan, 0)
    median, p95 = np.percentile(known, [50.0, 95.0])
    return Spread(name, float(median), float(p95), int(known.size))


def stage_spreads(timing_s: Mapping[str, Sequence[float]]) -> List[Spread]:
    """Sum up the stages in their order, frames in which a stage had nothing to do left out."""
    idle_s = 2e-5
    spreads = []
    for name, times_s in timing_s.items():
        busy = [t for t in times_s if t > idle_s]
        spreads.append(spread_of(name, busy or times_s))
    return spreads


def latency_chart(spreads: Sequence[Spread], limit_ms: float) -> str:
    """Draw a bar per stage: median solid, 95th percentile pale, ``limit_ms`` as a line."""
    known = [s for s in spreads if s.n]
    if not known:
        return ""
    left, right, row = 262, 40, 28
    top_ms = 1.05 * max([s.p95_ms for s in known] + [limit_ms])
    height = row * len(known) + 34
    scale = (WIDTH - left - right) / top_ms
    parts = [f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="Latency by stage">']
    for i, item in enumerate(known):
        y = 8 + i * row
        median, p95 = max(1.0, item.median_ms * scale), max(1.0, item.p95_ms * scale)
        parts += [
            f'<text x="136" y="{y + 14}" text-anchor="end">{esc(item.name)}</text>',
            f'<rect x="{left}" y="{y + 3}" width="{p95:.1f}" height="14" rx="3" '
            'fill="var(--bar2)"/>',
            f'<rect x="{left}" y="{y + 3}" width="{median:.1f}" height="14" rx="3" '
            'fill="var(--bar)"/>',
            f'<text x="{left - 12}" y="{y + 14}" text-anchor="end">{_ms(item.median_ms)}'
            f'<tspan class="dim"> / {_ms(item.p95_ms)} ms</tspan></text>',
        ]
    x, base = left + limit_ms * scale, row * len(known) + 8
    parts += [
        f'<line x1="{x:.1f}" x2="{x:.1f}" y1="4" y2="{base}" stroke="var(--bad)" '
        'stroke-dasharray="4 3"/>',
        f'<text x="{x:.1f}" y="{base + 15}" text-anchor="middle" class="dim">one frame, '
        f"{limit_ms:.0f} ms</text>",
        f'<line x1="{left}" x2="{left}" y1="4" y2="{base}" stroke="var(--line)"/></svg>',
    ]
    return "".join(parts)


def timeline(scene: SceneResult) -> str:
    """Draw when the scene's events happened, and when the contact would have come."""
    marks: List[Tuple[float, str, str]] = [
        (t_s, words, colour)
        for t_s, words, colour in (
            (scene.t_trigger_s, "hazard seen", "var(--warn)"),
            (scene.t_reflex_s, "reflex ready", "var(--bar)"),
            (scene.t_command_s, "command sent", "var(--accent)"),
            (scene.t_arrived_s, "arm there", "var(--good)"),
            (scene.t_free_contact_s, _contact_words(scene), "var(--bad)"),
        )
        if math.isfinite(t_s)
    ]
    if not marks:
        return ""
    marks.sort(key=lambda mark: mark[0])
    end_s = max(scene.notes.duration_s, marks[-1][0]) * 1.02 + 1e-6
    left, right, row = 14, 14, 19
    base = 18 + row * len(marks)
    scale = (WIDTH - left - right) / end_s
    parts = [
        f'<svg viewBox="0 0 {WIDTH} {base + 30}" role="img" aria-label="Timeline">',
        f'<line x1="{left}" x2="{WIDTH - right}" y1="{base}" y2="{base}" stroke="var(--dim)"/>',
    ]
    parts += [_band(scene, left, base, scale)]
    for tick in range(int(end_s) + 1):
        x = left + tick * scale
        parts.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{base}" y2="{base + 5}" stroke="var(--dim)"/>'
            f'<text x="{x:.1f}" y="{base + 20}" text-anchor="middle" class="dim">{tick} s</text>'
        )
    for i, (t_s, words, colour) in enumerate(marks):
        x, y = left + t_s * scale, 16 + i * row
        is_left = x > WIDTH * 0.6
        anchor, shift = ("end", -8) if is_left else ("start", 8)
        parts.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{y - 4}" y2="{base}" stroke="{colour}" '
            'stroke-width="1.5"/>'
            f'<circle cx="{x:.1f}" cy="{y - 4}" r="4.5" fill="{colour}"/>'
            f'<text x="{x + shift:.1f}" y="{y}" text-anchor="{anchor}">{esc(words)}'
            f'<tspan class="dim"> {t_s:.2f} s</tspan></text>'
        )
    return "".join(parts) + "</svg>"


def _contact_words(scene: SceneResult) -> str:
    return "contact" if scene.is_collision else "contact, had nobody acted"


def _band(scene: SceneResult, left: float, base: float, scale: float) -> str:
    """Draw the time in which the mover was visibly in motion before the contact."""
    if not (math.isfinite(scene.visible_s) and scene.would_collide):
        return ""
    start_s = max(0.0, scene.t_free_contact_s - scene.visible_s)
    width = (scene.t_free_contact_s - start_s) * scale
    return (
        f'<rect x="{left + start_s * scale:.1f}" y="{base - 7}" width="{width:.1f}" height="7" '
        'fill="var(--warn-bg)"><title>object visibly in motion</title></rect>'
    )


def _ms(value: float) -> str:
    return f"{value:.1f}" if value >= 1.0 else f"{value:.2f}"
