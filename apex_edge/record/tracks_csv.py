"""tracks.csv: one row per track and frame, in pixels and, where calibrated, in metres."""

import csv
import io
import math
from pathlib import Path
from typing import List, Union

import numpy as np

from apex_edge.record.whole import WholeText
from apex_edge.types import Step, Tracks, TrackStatus

PIXEL_COLUMNS = ("frame", "t_s", "name", "track_id", "x_px", "y_px", "area_px2", "status")
METRIC_COLUMNS = ("x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s")
DEVIATION_COLUMNS = ("x_sd_m", "y_sd_m", "z_sd_m", "vx_sd_m_s", "vy_sd_m_s", "vz_sd_m_s")


class TracksCsv(WholeText):
    """Write tracks.csv; the file appears when closed.

    Parameters
    ----------
    path : where to.
    is_calibrated : add position and velocity in the table frame with their standard deviations.

    Raises
    ------
    RecordingError : the folder is missing or not writable.
    """

    def __init__(self, path: Union[str, Path], is_calibrated: bool) -> None:
        """Open the file and write the header."""
        super().__init__(path)
        self._is_calibrated = is_calibrated
        metric = METRIC_COLUMNS + DEVIATION_COLUMNS if is_calibrated else ()
        self._write_row([*PIXEL_COLUMNS, *metric])

    def write(self, step: Step) -> None:
        """Append the tracks of one frame; a value that is not known is left empty."""
        for i in range(len(step.tracks.name)):
            self._write_row(self._row(step.tracks, i))

    def _row(self, tracks: Tracks, i: int) -> List[str]:
        row = [
            str(int(tracks.seq)),
            _text(tracks.t_s, 6),
            tracks.name[i],
            str(int(tracks.track_id[i])),
            _text(tracks.centre_px[i, 0], 3),
            _text(tracks.centre_px[i, 1], 3),
            _text(tracks.area_px2[i], 1),
            TrackStatus(int(tracks.status[i])).name.lower(),
        ]
        if self._is_calibrated:
            # a diagonal a hair below zero is rounding, not a negative variance
            deviation = np.sqrt(np.maximum(np.diag(tracks.cov[i]), 0.0))
            metric = np.concatenate([tracks.pos_m[i], tracks.vel_m_s[i], deviation])
            row += [_text(value, 6) for value in metric]
        return row

    def _write_row(self, row: List[str]) -> None:
        line = io.StringIO()
        csv.writer(line, lineterminator="\n").writerow(row)
        self.write_text(line.getvalue())


def _text(value: float, decimals: int) -> str:
    return f"{float(value):.{decimals}f}" if math.isfinite(value) else ""
