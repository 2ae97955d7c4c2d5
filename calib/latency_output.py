"""What a latency calibration leaves: a signed file, the line for the settings, a picture."""

from typing import Any, Dict, List, Mapping, Sequence, Tuple

import numpy as np

from apex_edge import documents
from apex_edge.types import Array
from calib import plot
from calib.latency import LatencyResult

FORMAT = "apex-latency"
VERSION = 1


def latency_document(
    result: LatencyResult, includes: Sequence[str], made: Mapping[str, Any]
) -> Dict[str, Any]:
    """Return the document; ``includes`` names what else is in the figure, e.g. a display."""
    content = {
        "latency_s": round(max(result.latency_s, 0.0), 6),
        "sd_s": result.sd_s,
        "includes": list(includes),
    }
    return documents.compose(FORMAT, VERSION, content, made)


def settings_lines(result: LatencyResult) -> List[str]:
    """Return the lines for the settings file."""
    return ["[camera]", f"latency_s = {max(result.latency_s, 0.0):.4f}"]


def draw(
    result: LatencyResult, signal: Tuple[Array, Array], response: Tuple[Array, Array]
) -> Array:
    """Return a picture: the first seconds of signal and response, and how well each lag fits."""
    title = (
        f"latency: {result.verdict.grade}, {1e3 * result.latency_s:.1f} ms +- "
        f"{1e3 * result.sd_s:.1f} (sd), explains {result.explained:.0%}"
    )
    picture = plot.sheet(960, 560, title)
    start_s = max(signal[0][0], response[0][0])
    window = (0.0, min(8.0, response[0][-1] - start_s))
    chart = plot.Chart(
        picture,
        (60, 60, 880, 200),
        window,
        (-0.1, 1.1),
        "blue: signal, moved by the latency; orange: what the frames show; both scaled, over s",
    )
    chart.line(*_shown(signal, result.latency_s - start_s, window), plot.BLUE)
    times, values = _shown(response, -start_s, window, is_held=False)
    chart.dots(times, values, plot.ORANGE)
    lags = 1e3 * result.curve[:, 0]
    chart = plot.Chart(
        picture,
        (60, 320, 880, 200),
        (float(lags[0]), float(lags[-1])),
        (0.0, 1.05),
        "share of the response explained, over the lag in ms",
    )
    chart.line(lags, result.curve[:, 1], plot.GREEN)
    chart.dots([1e3 * result.latency_s], [result.explained], plot.RED)
    return picture


def _shown(
    series: Tuple[Array, Array], shift_s: float, window: Tuple[float, float], is_held: bool = True
) -> Tuple[Array, Array]:
    """Return the part of a series inside a window, scaled to 0..1; a blinker with its steps."""
    times, values = series[0] + shift_s, series[1]
    if is_held and len(np.unique(values)) <= 2:
        times = np.repeat(times, 2)[1:]
        values = np.repeat(values, 2)[:-1]
    inside = (times >= window[0]) & (times <= window[1])
    low, high = values.min(), values.max()
    return times[inside], (values[inside] - low) / max(high - low, 1e-12)
