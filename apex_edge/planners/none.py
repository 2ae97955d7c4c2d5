"""No planner: the reflex acts alone."""

from typing import Mapping, Optional

from apex_edge.planners.base import Clock, Planner, PlannerConfig, PlanRequest
from apex_edge.types import Proposal


class NoPlanner(Planner):
    """Never propose anything."""

    def __init__(
        self, config: PlannerConfig, env: Mapping[str, str], clock: Clock, seed: int
    ) -> None:
        pass

    def ask(self, request: PlanRequest) -> None:
        """Ignore the request."""

    def poll(self, now_s: float) -> Optional[Proposal]:
        """Return None, always."""
        return None

    def wait(self, timeout_s: float) -> Optional[Proposal]:
        """Return None at once."""
        return None

    def cancel(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    @property
    def is_pending(self) -> bool:
        """Return False, always."""
        return False
