"""The picture of a servo calibration: angle over ticks, and what the line leaves."""

from typing import Sequence

import numpy as np

from apex_edge.types import Array
from calib import plot
from calib.servo import GOOD_DEG, ServoFit, ServoSamples, overall


def draw(samples: ServoSamples, fits: Sequence[ServoFit]) -> Array:
    """Return a picture: angle over ticks, and what is left of it, one row of charts a servo."""
    height = 250
    picture = plot.sheet(height * len(fits))
    for index, fit in enumerate(fits):
        own = samples.pick(samples.servo_id == fit.servo_id)
        left = own.angle_deg - np.degrees((own.ticks - fit.zero_ticks) / fit.ticks_per_rad)
        top = 34 + height * index
        ticks, reach = plot.span(own.ticks), max(1.2 * float(np.abs(left).max()), GOOD_DEG)
        title = f"servo {fit.servo_id}: {fit.verdict}; angle (deg) over ticks"
        line = plot.Chart(picture, (60, top, 400, 180), ticks, plot.span(own.angle_deg), title)
        ends = np.array(ticks)
        line.line(ends, np.degrees((ends - fit.zero_ticks) / fit.ticks_per_rad), plot.GREEN)
        title = f"off the line (deg), backlash {fit.backlash_deg:.2f} deg"
        rest = plot.Chart(picture, (530, top, 400, 180), ticks, (-reach, reach), title)
        for way, colour in ((own.is_up, plot.BLUE), (~own.is_up, plot.ORANGE)):
            line.dots(own.ticks[way], own.angle_deg[way], colour)
            rest.dots(own.ticks[way], left[way], colour)
        for sign in (-1.0, 1.0):
            rest.level(
                0.5 * sign * fit.backlash_deg if np.isfinite(fit.backlash_deg) else 0.0, plot.GREEN
            )
    facts = ["angles in deg over ticks; blue: approached upwards, orange: downwards"]
    headline = "; ".join(
        f"servo {fit.servo_id}: zero {fit.zero_ticks:.1f}, {fit.ticks_per_rad:.1f} ticks per rad"
        for fit in fits
    )
    return plot.with_panel(picture, overall(fits), headline, facts)
