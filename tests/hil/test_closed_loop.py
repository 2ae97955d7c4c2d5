"""The whole loop on the twin: rendered frames in, servo bytes out through a pseudo-terminal."""

from dataclasses import replace
from typing import List, Mapping, Optional

import pytest

from apex_edge.assemble import ApexConfig, Kit
from apex_edge.closed_loop import SceneOutcome, ScenePlayer
from apex_edge.planners.fake_server import FakeServer, answering, failing
from apex_edge.record.decision_log import to_json_line
from apex_edge.twin.scenarios import make
from apex_edge.types import Step


def play(
    kit: Kit,
    kind: str,
    seed: int,
    steps: Optional[List[Step]] = None,
    env: Optional[Mapping[str, str]] = None,
) -> SceneOutcome:
    kept: List[Step] = steps if steps is not None else []
    return ScenePlayer(kit, env or {}).play(make(kind, seed), kept.append, is_real_time=False)


@pytest.fixture(scope="module")
def kit() -> Kit:
    return Kit.from_config(ApexConfig())


@pytest.mark.parametrize("seed", [1, 2])
def test_a_collision_is_prevented_and_the_protected_block_left_alone(kit: Kit, seed: int) -> None:
    outcome = play(kit, "collision", seed)
    assert outcome.is_eligible
    assert outcome.is_intervention
    assert not outcome.is_collision
    assert not outcome.is_target_touched
    times = outcome.times
    assert times.trigger_s <= times.reflex_s <= times.command_s < times.arrived_s
    assert times.arrived_s < outcome.free.t_contact_s


def test_nothing_happens_when_nothing_moves(kit: Kit) -> None:
    steps: List[Step] = []
    outcome = play(kit, "no-moving", 1, steps)
    assert not outcome.is_intervention
    assert {step.decision.action for step in steps} == {"none"}
    assert all(step.command is None for step in steps)


def test_an_implicit_hazard_waits_until_the_deadline_and_is_still_prevented(kit: Kit) -> None:
    steps: List[Step] = []
    outcome = play(kit, "implicit", 1, steps)
    assert not outcome.is_collision
    actions = [step.decision.action for step in steps]
    first = actions.index("intervene")
    assert "watch" in actions[:first]
    waited = [s.decision.deadline_s for s in steps[:first] if s.decision.action == "watch"]
    assert outcome.times.command_s <= max(waited) + 0.05


def test_the_same_scene_gives_the_same_decisions_byte_for_byte(kit: Kit) -> None:
    runs = []
    for _ in range(2):
        steps: List[Step] = []
        play(kit, "collision", 3, steps)
        runs.append([to_json_line(step) for step in steps])
    assert len(runs[0]) > 60
    assert runs[0] == runs[1]


def test_without_arm_bytes_the_same_scene_ends_in_a_collision(kit: Kit) -> None:
    scene = make("collision", 1)
    deaf = Kit(
        replace(kit.config, agent=replace(kit.config.agent, protected=("nobody",))),
        kit.arm,
        kit.candidates,
        kit.colours,
    )
    outcome = ScenePlayer(deaf, {}).play(scene, lambda _: None, is_real_time=False)
    assert outcome.is_collision
    assert not outcome.is_intervention


@pytest.mark.parametrize("answer", ["worst", "no_action", "prose"])
def test_no_answer_of_a_language_model_makes_an_implicit_scene_worse(kit: Kit, answer: str) -> None:
    with FakeServer(answering(answer, 0.05, 1)) as server:
        env = {"APEX_LLM_BASE_URL": server.url, "APEX_LLM_MODEL": "scripted"}
        steps: List[Step] = []
        outcome = play(kit, "implicit", 2, steps, env)
    assert not outcome.is_collision
    assert outcome.is_intervention
    proposals = [step.proposal for step in steps if step.proposal is not None]
    assert proposals, "the server was never asked"
    verdicts = [step.decision.verdict for step in steps if step.proposal is not None]
    assert all(verdicts)


def test_a_useful_answer_in_time_is_what_moves_the_arm(kit: Kit) -> None:
    with FakeServer(answering("first", 0.05, 1)) as server:
        env = {"APEX_LLM_BASE_URL": server.url, "APEX_LLM_MODEL": "scripted"}
        sources = {play(kit, "implicit", seed, env=env).source for seed in (1, 4)}
    assert "llm" in sources


@pytest.mark.parametrize("fault", ["hang", "garbage"])
def test_a_broken_endpoint_leaves_the_reflex_in_charge(kit: Kit, fault: str) -> None:
    with FakeServer(failing(fault)) as server:
        env = {"APEX_LLM_BASE_URL": server.url, "APEX_LLM_MODEL": "scripted"}
        outcome = play(kit, "implicit", 2, env=env)
    assert outcome.source == "reflex"
    assert not outcome.is_collision
