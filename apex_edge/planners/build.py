"""Choose the planner from the settings and the environment."""

import logging
from typing import Mapping

from apex_edge import plugins
from apex_edge.planners.base import Clock, Planner, PlannerConfig
from apex_edge.planners.endpoint import with_environment

logger = logging.getLogger(__name__)


def build_planner(
    config: PlannerConfig, env: Mapping[str, str], clock: Clock, seed: int
) -> Planner:
    """Build the planner that ``config.type`` names; "llm" without an endpoint becomes "none".

    Parameters
    ----------
    config : section [planner] of the settings.
    env : environment to look up APEX_LLM_* in, e.g. ``os.environ``.
    clock : seconds on the scene's clock.
    seed : seed of the order in which candidates are shown.

    Raises
    ------
    PlannerError : an endpoint that can never work (bad URL, key file others can read).
    PluginError : no planner of that name.
    """
    resolved = with_environment(config, env)
    kind = resolved.type
    if kind == "llm" and not resolved.base_url:
        logger.info(
            "no LLM endpoint is set (APEX_LLM_BASE_URL or base_url in [planner]): "
            "the reflex acts alone"
        )
        kind = "none"
    planner: Planner = plugins.load("planners", kind)(resolved, env, clock, seed)
    return planner
