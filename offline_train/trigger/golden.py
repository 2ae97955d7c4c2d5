"""Golden vectors: raw pairs, stored with what they must give, replayed by every device that loads.

What they give is worked out by the device's own code on the finished model, and 1e-9 is what two
machines may differ by.
"""

from typing import Any, Dict, List, Sequence

import numpy as np

from apex_edge.triggers.weights import build, replay
from offline_train.trigger.estimate import end_covariance

# Each case is one frame: the rows of the table below, and who moves in each.
_CASES = (((0,), (1,)), ((1, 2, 3), (4, 4, 4)), ((0, 4, 5), (7, 2, 7)), ((3,), (2,)))
_OFFSET_M = ((0.3, 0.0), (0.2, 0.1), (-0.15, 0.25), (0.1, -0.3), (0.4, 0.02), (0.06, 0.0))
_MOVER_M_S = ((0.1, 0.0), (0.08, 0.02), (0.08, 0.02), (0.08, 0.02), (0.2, 0.0), (0.1, 0.0))
_TARGET_M_S = ((0.0, 0.0), (0.0, 0.0), (0.02, -0.05), (0.0, 0.0), (0.0, 0.02), (0.0, 0.0))
_DECEL_M_S2 = (0.0, 0.0, 0.0, 0.01, 0.04, 0.0)
_RADIUS_M = (0.03, 0.035, 0.04, 0.05, 0.035, 0.03)
_SD_M = (0.0005, 0.001, 0.002, 0.003, 0.001, 0.0015)
_WINDOW = (20, 10, 5, 7, 15, 12)
_PLANE = [0, 1, 3, 4]
# The shorter the window, the slower the mover: it slows down.
_BEND = 1.0


def with_golden(fields: Dict[str, Any], horizon_s: float) -> Dict[str, Any]:
    """Return the fields with the golden vectors that their model gives now.

    Raises
    ------
    WeightsError : the fields make no model.
    """
    model = build({**fields, "golden": [], "sha256": ""}, "model to export")
    golden = []
    for rows, movers in _CASES:
        case = _raw(rows, _WINDOW)
        case.update(mover=list(movers), horizon_s=horizon_s)
        windows = model.feature_set.windows
        if windows:
            case["windows"] = [_raw(rows, (w,) * len(_WINDOW), _BEND / w) for w in windows]
        came_out = {name: value.tolist() for name, value in replay(model, case).items()}
        golden.append({**case, **came_out})
    return {**fields, "golden": golden}


def _raw(rows: Sequence[int], window: Sequence[int], bend: float = 0.0) -> Dict[str, Any]:
    """Return columns of pairs as windows see them; ``bend`` is what they disagree on."""
    wanted: List[int] = list(rows)
    cov = end_covariance(np.array(_SD_M), np.array(window), np.full(6, 1.0 / 30.0), order=2)
    cov = 2.0 * cov[:, _PLANE][:, :, _PLANE]
    columns = {
        "offset_m": np.array(_OFFSET_M),
        "mover_vel_m_s": (1.0 - bend) * np.array(_MOVER_M_S),
        "target_vel_m_s": np.array(_TARGET_M_S),
        "decel_m_s2": np.array(_DECEL_M_S2),
        "radius_m": np.array(_RADIUS_M),
        "cov": cov,
    }
    return {name: column[wanted].tolist() for name, column in columns.items()}
