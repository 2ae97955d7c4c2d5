"""Settings of the perception stage."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Mapping, Tuple

from apex_edge.config import setting
from apex_edge.errors import ConfigError

MAX_RADIUS_M = 5.0

ADAPTIVE, PAPER = "adaptive", "paper"


@dataclass(frozen=True)
class PerceptionConfig:
    """Section ``[perception]``: how blobs are found, followed and turned into motion."""

    min_area_px2: float = setting(30.0, "smallest blob at full resolution, px^2", 4.0, 1e6)
    max_area_share: float = setting(0.25, "largest blob, share of the picture", 0.001, 1.0)
    min_relative_area: float = setting(
        0.05, "drop a blob smaller than this share of the largest of its colour lately", 0.0, 1.0
    )
    search_width_px: int = setting(320, "width at which the whole picture is searched", 80, 4096)
    search_every: int = setting(3, "search the whole picture every k-th frame", 1, 1000)
    window_margin_px: int = setting(6, "margin around a predicted box, px", 2, 500)
    noise_px: float = setting(0.5, "centroid noise, px", 0.01, 20.0)
    bias_m: float = setting(0.0012, "systematic position error with depth, m", 0.0, 0.1)
    plane_bias_m: float = setting(0.006, "systematic position error without depth, m", 0.0, 0.5)
    object_height_m: float = setting(0.030, "object height assumed without depth, m", 0.0, 1.0)
    ball_radius_m: Tuple[str, ...] = setting(
        (), 'colours that are balls of known radius (m), as "orange=0.020"'
    )
    min_depth_share: float = setting(0.3, "valid share of a blob's depth to trust it", 0.0, 1.0)
    max_radius_m: float = setting(0.12, "largest object radius believed, m", 0.005, 5.0)
    max_miss_s: float = setting(0.25, "a track unseen for longer is lost, s", 0.01, 10.0)
    max_hidden_s: float = setting(
        1.0, "the same for one expected inside a blob that it shares, s", 0.01, 10.0
    )
    motion: str = setting(
        ADAPTIVE,
        "adaptive: gated least squares; paper: means of five frames, two frames late",
        choices=(ADAPTIVE, PAPER),
    )
    window: int = setting(20, "most samples in a motion fit", 4, 200)
    min_samples: int = setting(3, "samples before a speed is given", 2, 20)
    gate_sigma: float = setting(4.0, "innovation gate, predicted standard deviations", 1.0, 20.0)
    stamp_sd_s: float = setting(0.001, "jitter of the capture stamps, s", 0.0, 0.1)
    speed_sd_m_s: float = setting(1.0, "speed expected of a new object, m/s", 0.01, 50.0)
    speed_sd_px_s: float = setting(2000.0, "speed expected of a new object, px/s", 1.0, 1e5)
    acc_sd_m_s2: float = setting(0.5, "unforeseen acceleration while unseen, m/s^2", 0.0, 100.0)
    acc_sd_px_s2: float = setting(600.0, "unforeseen acceleration while unseen, px/s^2", 0.0, 1e6)

    def __post_init__(self) -> None:
        """Refuse radii that cannot be read; the other settings are checked where they are read."""
        ball_radii(self.ball_radius_m)


@lru_cache(maxsize=16)
def ball_radii(pairs: Tuple[str, ...]) -> Mapping[str, float]:
    """Return colour name -> radius (m) of the setting ``ball_radius_m``.

    Raises
    ------
    ConfigError : not NAME=METRES, a radius out of range, or a name given twice.
    """
    radii = {}
    for pair in pairs:
        name, _, text = pair.rpartition("=")
        name = name.strip()
        try:
            radius_m = float(text)
        except ValueError:
            radius_m = math.nan
        # written so that NaN fails as well
        if not name or not 0.0 < radius_m <= MAX_RADIUS_M:
            raise ConfigError(
                f"perception.ball_radius_m: {pair!r} is not NAME=METRES with a radius in "
                f'(0, {MAX_RADIUS_M}], as "orange=0.020"'
            )
        if name in radii:
            raise ConfigError(f"perception.ball_radius_m: {name!r} is given twice")
        radii[name] = radius_m
    return radii
