"""The picture of a travel calibration: every step as recorded, and as the fit tells it."""

from typing import Sequence

import numpy as np

from apex_edge.types import Array
from calib import plot
from calib.travel import TravelFit, TravelSamples, overall, steps_of


def draw(samples: TravelSamples, fits: Sequence[TravelFit]) -> Array:
    """Return a picture: angle over time of all steps of a servo, one chart a servo."""
    height = 250
    picture = plot.sheet(height * len(fits))
    for index, each in enumerate(fits):
        steps = steps_of(samples, each.servo_id)
        t_s = np.concatenate([step.t_s for step in steps])
        way_deg = np.degrees(np.concatenate([step.way_rad for step in steps]))
        title = (
            f"servo {each.servo_id}: {each.verdict}; angle turned (deg) over time since the "
            f"command (s); residual {each.residual_deg:.2f} deg"
        )
        place = (60, 34 + height * index, 860, 180)
        chart = plot.Chart(picture, place, plot.span(t_s), plot.span(way_deg), title)
        chart.dots(t_s, way_deg, plot.BLUE)
        line_s = np.linspace(float(t_s.min()), float(t_s.max()), 300)
        for step in steps:
            told = each.travel.way_rad(line_s, np.full(300, step.turn_rad))
            chart.line(line_s, np.degrees(told), plot.GREEN)
    headline = "; ".join(f"servo {each.servo_id}: {each.rate_rad_s:.2f} rad/s" for each in fits)
    facts = ["blue: recorded; green: dead time, rate and lag or acceleration as fitted"]
    return plot.with_panel(picture, overall(fits), headline, facts)
