"""The narrator: one line at a change of state, silence in between."""

from dataclasses import replace
from typing import List

from record_steps import run as make_run

from apex_edge.narrate import Narrator, planner_line
from apex_edge.planners.base import PlannerConfig


def test_a_run_is_told_in_a_few_lines() -> None:
    lines: List[str] = []
    narrator = Narrator(lines.append)
    steps = make_run(45)
    for step in steps:
        narrator.see(replace(step, timing_s={**step.timing_s, "simulate": 0.003}))
    told = "\n".join(lines)
    assert "hazard: green ball will pass within 0.8 cm of the red block" in told
    assert "the reflex sends the arm to" in told
    assert len(lines) < len(steps) / 4


def test_a_quiet_run_says_nothing() -> None:
    lines: List[str] = []
    narrator = Narrator(lines.append)
    for step in make_run(9):
        narrator.see(step)
    assert lines == []


def test_the_line_about_the_model_says_who_is_asked_and_no_secret() -> None:
    config = PlannerConfig()
    assert "the reflex acts alone" in planner_line(config, {})
    env = {
        "APEX_LLM_BASE_URL": "http://127.0.0.1:9/v1",
        "APEX_LLM_MODEL": "small",
        "APEX_LLM_API_KEY": "canary-key",
    }
    line = planner_line(config, env)
    assert "small" in line
    assert "127.0.0.1:9" in line
    assert "canary" not in line
    assert "the reflex acts alone" in planner_line(replace(config, type="none"), env)
