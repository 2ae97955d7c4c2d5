"""Tell in plain lines what a run does, one line at each change of state."""

import math
from typing import Callable, List, Mapping

from apex_edge.planners.base import PlannerConfig
from apex_edge.planners.endpoint import with_environment
from apex_edge.types import Step

SAID_AS = {
    "reflex": "the reflex",
    "llm": "the language model",
    "none": "nobody",
}


def planner_line(config: PlannerConfig, env: Mapping[str, str]) -> str:
    """Say in one line who is asked besides the reflex; holds no secret."""
    resolved = with_environment(config, env)
    if resolved.type == "none" or not resolved.base_url:
        return "no language model is set (APEX_LLM_BASE_URL): the reflex acts alone"
    return f"language model: {resolved.model or 'the default of'} at {resolved.base_url}"


class Narrator:
    """Turn steps into lines for a person.

    Parameters
    ----------
    say : takes one line without its end; the verb prints it.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._action = "none"
        self._is_alarmed = False

    def see(self, step: Step) -> None:
        """Say what changed with this step, if anything did."""
        for line in self._lines(step):
            self._say(f"  {step.frame.t_s:6.2f} s  {line}")
        self._action = step.decision.action

    def _lines(self, step: Step) -> List[str]:
        lines = []
        is_alarmed = math.isfinite(step.decision.ttc_s) or step.decision.action == "watch"
        if is_alarmed and not self._is_alarmed:
            lines.append(f"hazard: {step.decision.summary}")
            lines += self._simulated(step)
        self._is_alarmed = is_alarmed
        if step.decision.verdict:
            lines.append(f"language model's answer: {step.decision.verdict}")
        if step.decision.action in ("intervene", "redirect"):
            lines.append(self._move(step))
        elif step.decision.action != self._action and step.decision.reason:
            lines.append(f"{step.decision.action}: {step.decision.reason}")
        return lines

    def _simulated(self, step: Step) -> List[str]:
        if step.rollouts is None:
            return []
        n_all, n_safe = len(step.rollouts.is_safe), int(step.rollouts.is_safe.sum())
        took_ms = 1000.0 * step.timing_s["simulate"]
        return [f"simulated {n_all} interventions in {took_ms:.1f} ms, of which safe: {n_safe}"]

    def _move(self, step: Step) -> str:
        decision, ack = step.decision, step.ack
        who = SAID_AS.get(decision.source, decision.source)
        if ack is not None and not ack.is_accepted:
            return f"{who} wanted to move the arm, refused: {ack.reason}"
        assert decision.target_m is not None
        x_cm, y_cm = 100.0 * decision.target_m[0], 100.0 * decision.target_m[1]
        what = "sends the arm" if decision.action == "intervene" else "redirects the arm"
        return f"{who} {what} to ({x_cm:.1f}, {y_cm:.1f}) cm"
