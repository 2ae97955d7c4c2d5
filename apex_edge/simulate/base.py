"""The interface of a physics back end: state and candidate interventions in, outcomes out.

Source: APEX section "Simulate", ``s_{t+1}^(i) = PhysicsSim(s_t, a_i)``, algorithm 1 lines 6-9.
"""

from abc import ABC, abstractmethod

import numpy as np

from apex_edge.errors import InputError
from apex_edge.simulate.problem import (
    CandidatesConfig,
    Outcomes,
    RolloutProblem,
    SimulateConfig,
    check_array,
    problem_from,
)
from apex_edge.simulate.score import judge
from apex_edge.types import Array, Candidates, Rollouts

__all__ = [
    "CandidatesConfig",
    "Outcomes",
    "PhysicsSim",
    "RolloutProblem",
    "SimulateConfig",
    "problem_from",
]


class PhysicsSim(ABC):
    """Simulate what each candidate intervention leads to.

    A back end implements ``outcomes`` only; what counts as safe and what is better is judged in
    one place for all of them (``apex_edge.simulate.score``).
    """

    @abstractmethod
    def outcomes(self, problem: RolloutProblem, tip_xy_m: Array, arrival_s: Array) -> Outcomes:
        """Roll out one path against n blockers, each alone.

        Parameters
        ----------
        problem : the state to start from.
        tip_xy_m : shape (n, 2), where each blocker stands, metres.
        arrival_s : shape (n,), when it stands there, seconds from now; inf for never.

        A blocker stops the mover at the first step, at or after its arrival, at which they touch.
        Mover and target collide at the first step at which they touch, which ends that roll-out;
        when both happen in the same step it is a collision.
        """

    def rollout(
        self, problem: RolloutProblem, candidates: Candidates, arrival_s: Array
    ) -> Rollouts:
        """Simulate every candidate, each with its own arm arrival time (n,), inf for never.

        Raises
        ------
        InputError : wrong shapes, a tip that is not finite, an arrival that is NaN or negative.
        """
        tips = np.asarray(candidates.tip_m, dtype=np.float64)
        arrival = np.asarray(arrival_s, dtype=np.float64)
        check_array("tip_m", tips, (len(tips), 3))
        if arrival.shape != (len(tips),):
            raise InputError(
                f"roll-out: arrival_s has shape {arrival.shape}, expected {(len(tips),)}"
            )
        if not (arrival >= 0.0).all():  # NaN fails as well
            raise InputError("roll-out: arrival_s holds a negative value or NaN, expected s >= 0")
        return judge(self.outcomes, problem, candidates, arrival)
