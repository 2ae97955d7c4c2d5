"""The picture of a latency calibration: signal and response, and how well each lag fits."""

from typing import Tuple

import numpy as np

from apex_edge.types import Array
from calib import plot
from calib.latency import LatencyResult


def draw(
    result: LatencyResult, signal: Tuple[Array, Array], response: Tuple[Array, Array]
) -> Array:
    """Return a picture: the first seconds of signal and response, and how well each lag fits."""
    picture = plot.sheet(520)
    start_s = max(signal[0][0], response[0][0])
    window = (0.0, min(8.0, response[0][-1] - start_s))
    chart = plot.Chart(
        picture,
        (60, 34, 880, 190),
        window,
        (-0.1, 1.1),
        "the first seconds: signal and response over time (s)",
    )
    chart.line(*_shown(signal, result.latency_s - start_s, window), plot.BLUE)
    times, values = _shown(response, -start_s, window, is_held=False)
    chart.dots(times, values, plot.ORANGE)
    lags = 1e3 * result.curve[:, 0]
    chart = plot.Chart(
        picture,
        (60, 294, 880, 190),
        (float(lags[0]), float(lags[-1])),
        (0.0, 1.05),
        "share of the response explained, over the lag (ms)",
    )
    chart.line(lags, result.curve[:, 1], plot.GREEN)
    chart.dots([1e3 * result.latency_s], [result.explained], plot.RED)
    headline = (
        f"{1e3 * result.latency_s:.1f} ms +- {1e3 * result.sd_s:.1f} (sd), explains "
        f"{result.explained:.0%} of what {result.n_frames} frames show"
    )
    facts = ["blue: signal, moved by the latency; orange: what the frames show; both scaled"]
    return plot.with_panel(picture, result.verdict, headline, facts)


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
