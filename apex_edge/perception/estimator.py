"""What every motion estimator offers: sightings in, state at any time out."""

from abc import ABC, abstractmethod
from typing import NamedTuple

from apex_edge.types import Array

PAPER_WINDOW = 5


class Motion(NamedTuple):
    """State at one time: ``x``, ``v``, ``a (d,)``, covariance (2d, 2d) of x and v."""

    x: Array
    v: Array
    a: Array
    cov: Array


class MotionRules(NamedTuple):
    """What an estimator takes for granted, in the unit of the positions (m or px).

    ``acc_sd`` of what may begin at any time, ``curve_sd`` of what may bend a path from its start.
    """

    speed_sd: float
    acc_sd: float
    stamp_sd_s: float
    curve_sd: float = 0.0
    window: int = 20
    min_samples: int = 3
    gate_sigma: float = 4.0
    max_gap_s: float = 0.25


class Estimator(ABC):
    """Follow one object; feed sightings in time order with ``add``, ask with ``predict``."""

    @property
    @abstractmethod
    def n_samples(self) -> int:
        """Return the number of sightings behind the present estimate."""

    @property
    @abstractmethod
    def is_manoeuvre(self) -> bool:
        """Say whether the motion just changed and the estimate is still young or in doubt."""

    @abstractmethod
    def add(self, t_s: float, x: Array, sd: float) -> None:
        """Take a sighting (d,) at capture time ``t_s``; one not newer than the last is ignored."""

    @abstractmethod
    def predict(self, t_s: float) -> Motion:
        """Return the state at ``t_s``, its covariance growing since the last sighting.

        Raises
        ------
        ValueError : nothing was seen yet.
        """

    @abstractmethod
    def smooth(self) -> Array:
        """Return the mean (d,) of the last five sightings. Source: APEX, five-frame window."""
