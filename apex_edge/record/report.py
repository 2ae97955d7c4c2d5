"""report.html: one file that shows a run to somebody who was not there."""

import math
import os
from pathlib import Path
from typing import Dict, List, Sequence, Tuple, Union

from apex_edge.record import charts
from apex_edge.record.html import (
    esc,
    figure,
    image,
    page,
    seconds,
    table,
    tag,
    tiles,
    video,
)
from apex_edge.record.summary import Event, RunSummary, SceneResult
from apex_edge.record.whole import write_whole_text

FRAME_MS = 1000.0 / 30.0
MAX_SCENES_SHOWN = 24
VERDICT_KIND: Dict[str, str] = {
    "prevented": "good",
    "left alone": "good",
    "collision": "bad",
    "false alarm": "warn",
}
ACTION_KIND: Dict[str, str] = {"intervene": "bad", "redirect": "bad", "watch": "warn"}


def write_report(path: Union[str, Path], run: RunSummary) -> None:
    """Write the report of a run as one self-contained HTML file.

    Parameters
    ----------
    path : where to; videos of the scenes are linked relative to it.
    run : what happened; of many scenes the first 24 are shown at length, all in the table.

    Raises
    ------
    RecordingError : the file cannot be written, or a video it shows cannot be read.
    """
    folder = Path(path).resolve().parent
    parts = [_head(run), _tiles(run), _scene_table(run), _latency(run)]
    parts += [_scene(scene, folder, run.is_judged) for scene in run.scenes[:MAX_SCENES_SHOWN]]
    parts.append(_about(run))
    write_whole_text(path, page(run.title, "\n".join(part for part in parts if part)))


def _head(run: RunSummary) -> str:
    command = f"<p><code>{esc(run.command)}</code></p>" if run.command else ""
    created = f'<p class="dim">{esc(run.created)}</p>' if run.created else ""
    return f"<h1>{esc(run.title)}</h1>{created}{command}"


def _tiles(run: RunSummary) -> str:
    items: List[Tuple[str, str]] = []
    scenes = run.scenes
    if run.is_judged:
        threatened = [s for s in scenes if s.would_collide]
        calm = [s for s in scenes if not s.would_collide]
        prevented = sum(not s.is_collision for s in threatened)
        items.append((f"{prevented} of {len(threatened)}", "collisions prevented"))
        false = sum(s.is_intervention for s in calm)
        items.append((f"{false} of {len(calm)}", "false interventions"))
    else:
        items.append((str(sum(s.notes.n_frames for s in scenes)), "frames"))
        items.append((str(sum(s.is_intervention for s in scenes)), "interventions"))
    sent = charts.spread_of("", [t for s in scenes for t in s.notes.frame_to_command_s])
    if sent.n:
        items.append((f"{sent.median_ms:.1f} ms", "frame to command sent, median"))
    margins = sorted(s.margin_s for s in scenes if math.isfinite(s.margin_s))
    if margins:
        items.append((f"{margins[0]:.2f} s", "least time to spare, arm there before contact"))
    return tiles(items)


def _scene_table(run: RunSummary) -> str:
    if not run.is_judged:
        return ""
    head = ["scene", "outcome", "moved by", "hazard seen", "reflex ready", "command sent"]
    head += ["arm there", "contact if left alone", "to spare"]
    rows = [
        [
            esc(_name(s)),
            tag(s.verdict, VERDICT_KIND.get(s.verdict, "")),
            esc(s.source if s.is_intervention else ""),
            seconds(s.t_trigger_s),
            seconds(s.t_reflex_s),
            seconds(s.t_command_s, 3),
            seconds(s.t_arrived_s),
            seconds(s.t_free_contact_s),
            seconds(s.margin_s),
        ]
        for s in run.scenes
    ]
    note = '<p class="dim">Times in seconds on the clock of each scene.</p>'
    return f'<h2>What happened</h2><div class="card">{table(head, rows, 3)}{note}</div>'


def _latency(run: RunSummary) -> str:
    timing_s: Dict[str, List[float]] = {}
    for scene in run.scenes:
        for stage, times_s in scene.notes.timing_s.items():
            timing_s.setdefault(stage, []).extend(times_s)
    spreads = charts.stage_spreads(timing_s)
    sent_s = [t for scene in run.scenes for t in scene.notes.frame_to_command_s]
    sent = charts.spread_of("capture to command", sent_s)
    chart = charts.latency_chart([*spreads, sent], FRAME_MS)
    if not chart:
        return ""
    words = "Median and 95th percentile of the frames in which a stage had work"
    words += f", and of the {sent.n} commands." if sent.n else "."
    return f'<h2>Where the time goes</h2><div class="card">{figure(_wide(chart), words)}</div>'


def _scene(scene: SceneResult, folder: Path, is_judged: bool) -> str:
    notes = scene.notes
    verdict = tag(scene.verdict, VERDICT_KIND.get(scene.verdict, "")) if is_judged else ""
    parts = [f'<div class="head"><h2>{esc(_name(scene))}</h2>{verdict}</div>']
    if notes.montage is not None:
        caption = "Key moments, in order; the time on the clock of the scene."
        parts.append(figure(image(notes.montage, "key moments of the scene"), caption))
    line = charts.timeline(scene)
    if line:
        parts.append(figure(_wide(line), "What happened when."))
    columns = []
    if notes.safe_points is not None:
        words = "All simulated interventions from above."
        columns.append(
            figure(image(notes.safe_points, "safe intervention points", is_flat=True), words)
        )
    if scene.video is not None:
        link = os.path.relpath(str(Path(scene.video).resolve()), str(folder)).replace(os.sep, "/")
        columns.append(video(Path(scene.video), link))
    if columns:
        is_pair = len(columns) > 1
        content = "".join(f"<div>{column}</div>" for column in columns)
        parts.append(f'<div class="two">{content}</div>' if is_pair else content)
    parts.append(_events(notes.events))
    parts.append(_calls(scene))
    parts.append(_counters(scene))
    return f'<section class="card">{"".join(parts)}</section>'


def _wide(drawing: str) -> str:
    return f'<div class="wide">{drawing}</div>'


def _events(events: Sequence[Event]) -> str:
    if not events:
        return ""
    rows = [
        [
            f"{event.t_s:.2f}",
            tag(event.action.replace("none", "clear"), ACTION_KIND.get(event.action, "")),
            esc("" if event.source == "none" else event.source),
            esc(event.text),
        ]
        for event in events
    ]
    return f"<h3>Decisions</h3>{table(['s', 'action', 'by', 'why'], rows, 4)}"


def _calls(scene: SceneResult) -> str:
    if not scene.notes.calls:
        return ""
    rows = [
        [
            f"{call.t_s:.2f}",
            esc(call.source),
            esc(call.kind + (f" {call.candidate}" if call.candidate >= 0 else "")),
            tag(call.verdict or "none", "good" if call.verdict == "accepted" else ""),
            esc(call.detail),
            f"{call.latency_s:.2f}",
        ]
        for call in scene.notes.calls
    ]
    head = ["s", "planner", "answer", "verdict", "detail", "took, s"]
    return f"<h3>Planner's answers</h3>{table(head, rows, 5)}"


def _counters(scene: SceneResult) -> str:
    counters = {"frames": scene.notes.n_frames, **scene.counters}
    words = ", ".join(f"{value} {esc(name)}" for name, value in counters.items())
    return f'<p class="dim">Camera: {words}</p>'


def _about(run: RunSummary) -> str:
    if not run.about:
        return ""
    items = "".join(f"<dt>{esc(key)}</dt><dd>{esc(value)}</dd>" for key, value in run.about.items())
    return f'<h2>About this run</h2><div class="card"><dl>{items}</dl></div>'


def _name(scene: SceneResult) -> str:
    return scene.kind if scene.seed is None else f"{scene.kind}, seed {scene.seed}"
