"""Seeded scenes of six kinds; every scene keeps the promise of its kind, checked by running it.

A scene is drawn at random and then run once with no arm. When it does not do what its kind says
(a collision that never happens, a near miss that touches) another one is drawn from the same
stream. ``RandomState`` is used throughout because its streams are frozen: the same kind and seed
give the same scene on every numpy from 1.19 to 2.x.
"""

import math
import zlib
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np

from apex_edge.errors import InputError
from apex_edge.twin.placing import (
    clutter,
    heading,
    is_clear,
    is_safe_path,
    plain_block,
    polar,
    red_block,
    shifted,
)
from apex_edge.twin.scene import HandMotion, Point, Scenario, SceneObject, straight
from apex_edge.twin.truth import free_run
from apex_edge.twin.world import TwinWorld

BALL_RADIUS_M = 0.015
FLICK_WAY_M = 0.03
NEAR_MISS_GAP_M = (0.008, 0.040)
SHORT_STOP_GAP_M = (0.015, 0.060)
N_TRIES = 400

Draft = Optional[Tuple[SceneObject, Optional[HandMotion]]]


def make(kind: str, seed: int) -> Scenario:
    """Return one scene; the same kind and seed always give the same scene.

    Parameters
    ----------
    kind : one of ``KINDS``. A "collision" can be seen to come for 1.5 s at least, a "late-start" is
        in view at rest and leaves less.
    seed : 0 or more.

    Raises
    ------
    InputError : unknown kind or negative seed.
    """
    if kind not in _MAKERS:
        raise InputError(f"unknown scene kind {kind!r}; known: {', '.join(KINDS)}")
    if seed < 0:
        raise InputError(f"the seed of a scene must be 0 or more, found {seed}")
    rng = np.random.RandomState([zlib.crc32(kind.encode("ascii")), seed])
    maker = _MAKERS[kind]
    for _ in range(N_TRIES):
        scenario = maker(rng, seed)
        if scenario is not None:
            return scenario
    raise InputError(f"no valid scene of kind {kind!r} found for seed {seed}")


def _uniform(rng: np.random.RandomState, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _ball_mover(
    rng: np.random.RandomState, start: Point, aim: Point, t_contact_s: float, wait_s: float
) -> Draft:
    """Roll a ball from ``start`` so that it comes to ``aim`` after ``t_contact_s``."""
    way = math.hypot(aim[0] - start[0], aim[1] - start[1])
    drag = _uniform(rng, 0.004, 0.012)
    speed = way / t_contact_s + 0.5 * drag * t_contact_s
    if not 0.05 <= speed <= 0.15 or speed - drag * t_contact_s < 0.012:
        return None
    angle = heading(start, aim)
    ball = SceneObject("green ball", "green", "ball", BALL_RADIUS_M, start, friction=drag)
    if wait_s <= 0.0:
        rolling = (speed * math.cos(angle), speed * math.sin(angle))
        return SceneObject(
            ball.name, "green", "ball", BALL_RADIUS_M, start, rolling, friction=drag
        ), None
    begin = shifted(start, angle, -FLICK_WAY_M)
    ball = SceneObject(ball.name, "green", "ball", BALL_RADIUS_M, begin, friction=drag)
    return ball, straight(ball.name, "flick", (wait_s, 2.0 * FLICK_WAY_M / speed), begin, start)


def _hand_mover(
    rng: np.random.RandomState, start: Point, aim: Point, t_contact_s: float, wait_s: float
) -> Draft:
    """Push a block along a minimum-jerk move that passes ``aim`` after about ``t_contact_s``."""
    block = plain_block(rng, "green block", "green", start, heading(start, aim))
    beyond = _uniform(rng, 0.03, 0.07)
    way = math.hypot(aim[0] - start[0], aim[1] - start[1])
    share = way / (way + beyond)
    tau = next(k / 200.0 for k in range(201) if _min_jerk(k / 200.0) >= share)
    duration = t_contact_s / tau
    if not 0.05 <= 1.875 * (way + beyond) / duration <= 0.17:
        return None
    end = shifted(aim, heading(start, aim), beyond)
    return block, straight(block.name, "min-jerk", (wait_s, duration), start, end)


def _min_jerk(tau: float) -> float:
    return tau * tau * tau * (10.0 - 15.0 * tau + 6.0 * tau * tau)


def _start_for(rng: np.random.RandomState, red: SceneObject, low: float, high: float) -> Point:
    """Pick where a mover comes from: the outer side of red, 25 to 85 degrees off radial."""
    radial = math.atan2(red.pos_m[1], red.pos_m[0])
    sign = 1.0 if rng.uniform() < 0.5 else -1.0
    angle = radial + sign * math.radians(_uniform(rng, 25.0, 85.0))
    return shifted(red.pos_m, angle, _uniform(rng, low, high))


def _scene(
    kind: str, seed: int, objects: List[SceneObject], hand: Optional[HandMotion], is_collision: bool
) -> Scenario:
    hands = () if hand is None else (hand,)
    mode = "wait_until_deadline" if kind == "implicit" else "reflex_first"
    mover, target = objects[1].name, objects[0].name
    return Scenario(kind, seed, tuple(objects), hands, 8.0, mover, target, is_collision, mode)


def _collision(rng: np.random.RandomState, seed: int, is_late: bool = False) -> Optional[Scenario]:
    red = red_block(rng)
    is_ball = rng.uniform() < 0.6
    start = _start_for(rng, red, *((0.15, 0.18) if is_late else (0.20, 0.35)))
    side = _uniform(rng, -0.008, 0.008)
    aim_angle = heading(start, red.pos_m)
    # The mover's front meets red's face about one radius plus one half side before the centre.
    aim = shifted(red.pos_m, aim_angle, -0.033)
    aim = shifted(aim, aim_angle + 0.5 * math.pi, side)
    t_contact_s = _uniform(rng, 0.9, 1.4) if is_late else _uniform(rng, 2.5, 4.8)
    wait_s = 0.0 if is_ball and not is_late and rng.uniform() < 0.5 else _uniform(rng, 0.3, 0.9)
    if is_late:
        wait_s += 1.2
    draft = (_ball_mover if is_ball else _hand_mover)(rng, start, aim, t_contact_s, wait_s)
    if draft is None:
        return None
    mover, hand = draft
    objects = [red, mover] + clutter(rng, int(rng.randint(0, 3)), [red, mover], mover.pos_m, aim)
    if not is_safe_path(mover, start, aim) or not is_clear(objects):
        return None
    kind = "late-start" if is_late else "collision"
    scenario = _scene(kind, seed, objects, hand, True)
    run = free_run(scenario)
    latest_s = wait_s + (2.6 if is_late else 5.6)
    is_right = 2.0 <= run.t_contact_s <= latest_s and (run.visible_s < 1.5) == is_late
    return scenario if is_right else None


def _late_start(rng: np.random.RandomState, seed: int) -> Optional[Scenario]:
    return _collision(rng, seed, is_late=True)


def _still(rng: np.random.RandomState, seed: int) -> Optional[Scenario]:
    red = red_block(rng)
    at = polar(_uniform(rng, 0.2, 0.36), math.radians(_uniform(rng, -50.0, 50.0)))
    green: SceneObject
    if rng.uniform() < 0.5:
        green = SceneObject("green ball", "green", "ball", BALL_RADIUS_M, at)
    else:
        green = plain_block(rng, "green block", "green", at, _uniform(rng, -0.8, 0.8))
    objects = [red, green] + clutter(rng, int(rng.randint(0, 4)), [red, green], at, at)
    if not is_safe_path(green, at, at) or not is_clear(objects):
        return None
    hand = None
    if rng.uniform() < 0.4:
        # The fingers lie behind the object, as if about to push it towards red.
        angle = heading(at, red.pos_m)
        place = shifted(at, angle, -green.radius_m - _uniform(rng, 0.004, 0.03))
        hand = straight("", "rest", (0.0, 1.0), place, shifted(place, angle, 0.05))
    hands = () if hand is None else (hand,)
    return Scenario("no-moving", seed, tuple(objects), hands, 8.0, "", red.name, False)


def _near_miss(rng: np.random.RandomState, seed: int) -> Optional[Scenario]:
    red = red_block(rng)
    start = _start_for(rng, red, 0.22, 0.35)
    angle = heading(start, red.pos_m)
    way = math.hypot(red.pos_m[0] - start[0], red.pos_m[1] - start[1])
    style = ("pass", "pass", "pass", "short", "turn")[int(rng.randint(0, 5))]
    wait_s = _uniform(rng, 0.2, 0.8)
    t_s = _uniform(rng, 2.5, 4.5)
    gaps = NEAR_MISS_GAP_M
    if style == "short":
        gaps = SHORT_STOP_GAP_M
        stop = shifted(red.pos_m, angle, -_uniform(rng, 0.056, 0.095))
        mover = plain_block(rng, "green block", "green", start, angle)
        hand: Optional[HandMotion]
        hand = straight(mover.name, "min-jerk", (wait_s, t_s), start, stop)
    elif style == "turn":
        mover = plain_block(rng, "green block", "green", start, angle)
        via = shifted(red.pos_m, angle, _uniform(rng, -0.02, 0.07))
        sign = 1.0 if rng.uniform() < 0.5 else -1.0
        end = shifted(via, angle + sign * 0.5 * math.pi, _uniform(rng, 0.12, 0.18))
        hand = HandMotion(mover.name, "min-jerk", wait_s, t_s, start, via, end)
    else:
        sign = 1.0 if rng.uniform() < 0.5 else -1.0
        side = sign * _uniform(rng, 0.045, 0.078)
        aim = shifted(red.pos_m, angle + 0.5 * math.pi, side)
        draft = (_ball_mover if rng.uniform() < 0.6 else _hand_mover)(rng, start, aim, t_s, wait_s)
        if draft is None:
            return None
        mover, hand = draft
    end = hand.end_m if hand is not None and hand.profile != "flick" else start
    if 1.875 * way / t_s > 0.2 or not is_safe_path(mover, start, end):
        return None
    objects = [red, mover] + clutter(rng, int(rng.randint(0, 2)), [red, mover], start, red.pos_m)
    return _checked(_scene("near-miss", seed, objects, hand, False), gaps)


def _checked(scenario: Scenario, gaps: Tuple[float, float]) -> Optional[Scenario]:
    """Let a near miss pass only when nothing at all touches and the gap is as promised."""
    if not is_clear(list(scenario.objects)):
        return None
    if not gaps[0] <= free_run(scenario).min_gap_m <= gaps[1]:
        return None
    world = TwinWorld(scenario)
    world.step(scenario.duration_s)
    return None if world.contacts else scenario


def _implicit(rng: np.random.RandomState, seed: int) -> Optional[Scenario]:
    child = red_block(rng, name="red child", look="child")
    start = _start_for(rng, child, 0.24, 0.34)
    angle = heading(start, child.pos_m)
    car = plain_block(rng, "green car", "green", start, angle, look="car")
    aim = shifted(child.pos_m, angle, -0.034)
    aim = shifted(aim, angle + 0.5 * math.pi, _uniform(rng, -0.006, 0.006))
    way = math.hypot(aim[0] - start[0], aim[1] - start[1])
    beyond = _uniform(rng, 0.04, 0.06)
    speed = way / _uniform(rng, 4.6, 5.2)
    end = shifted(aim, angle, beyond)
    duration = (way + beyond) / speed + 0.4
    hand = straight(car.name, "uniform", (_uniform(rng, 0.3, 0.6), duration), start, end)
    objects = [child, car] + clutter(rng, int(rng.randint(0, 2)), [child, car], start, aim)
    if not is_safe_path(car, start, aim) or not is_clear(objects):
        return None
    scenario = _scene("implicit", seed, objects, hand, True)
    return scenario if 4.5 <= free_run(scenario).t_contact_s <= 6.4 else None


def _many(rng: np.random.RandomState, seed: int) -> Optional[Scenario]:
    is_collision = bool(rng.uniform() < 0.5)
    red = red_block(rng)
    start = _start_for(rng, red, 0.22, 0.32)
    angle = heading(start, red.pos_m)
    side = _uniform(rng, -0.006, 0.006)
    if not is_collision:
        side = (1.0 if rng.uniform() < 0.5 else -1.0) * _uniform(rng, 0.05, 0.078)
    aim = shifted(shifted(red.pos_m, angle, -0.033), angle + 0.5 * math.pi, side)
    draft = _ball_mover(rng, start, aim, _uniform(rng, 2.8, 4.5), _uniform(rng, 0.0, 0.6))
    if draft is None:
        return None
    mover, hand = draft
    rest = clutter(rng, int(rng.randint(4, 11)), [red, mover], mover.pos_m, aim, n_moving=2)
    objects = [red, mover] + rest
    if len(objects) < 6 or not is_safe_path(mover, start, aim) or not is_clear(objects):
        return None
    scenario = _scene("many", seed, objects, hand, is_collision)
    run = free_run(scenario)
    if is_collision:
        return scenario if 2.2 <= run.t_contact_s <= 5.6 and run.visible_s >= 1.5 else None
    return scenario if math.isinf(run.t_contact_s) and run.min_gap_m >= NEAR_MISS_GAP_M[0] else None


_MAKERS: Dict[str, Callable[[np.random.RandomState, int], Optional[Scenario]]] = {
    "collision": _collision,
    "late-start": _late_start,
    "no-moving": _still,
    "near-miss": _near_miss,
    "implicit": _implicit,
    "many": _many,
}
KINDS: Tuple[str, ...] = tuple(_MAKERS)
