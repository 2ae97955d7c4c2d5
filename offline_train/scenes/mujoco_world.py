"""A table in MuJoCo: free, flicked, pushed and driven bodies, and when each first touches another.

Balls roll with rolling friction, blocks slide with Coulomb friction, a flat finger on a spring
pushes a block along a minimum-jerk line (a pointed one lets it slip off), a hand is a block held
just over the table and moved the same way. Source: APEX section "Simulate" (MuJoCo as the physics);
the table is ours.
"""

import math
from dataclasses import dataclass
from typing import Any, List, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.types import Array
from offline_train.extras import module

GRAVITY_M_S2 = 9.81
# Sliding distance comes out within 2 % up to this step, within 5 % at twice of it.
STEP_S = 0.004
# MuJoCo's friction is soft; at its default ratio a ball below 0.1 m/s rolls on for twice as long as
# its rolling friction allows (measured: deceleration 0.29 to 0.93 of the wanted one at 10, right
# within 1 % at 100).
_FRICTION_RATIO = 100
# The engine takes no rolling coefficient below 1e-5 m: about 0.005 m/s^2 for a ball of 15 mm.
LEAST_ROLLING_M_S2 = 0.006
FLICK_S = 0.12
FINGER_M = 0.008
_FINGER_GAP_M = 0.002
_HAND_GAP_M = 0.001
_GRIP = 0.5
# Stiffer than the default 0.02 s: a ball sinks in by 0.1 mm instead of 0.4 mm.
_CONTACT_S = 0.01
# A hand follows its plan as a critically damped spring of this rate: 3 mm late at 0.1 m/s.
_FOLLOW_RAD_S = 60.0
_BALL_KG, _BLOCK_KG, _HAND_KG = 0.02, 0.03, 0.3
FLICKED, PUSHED, DRIVEN = 0, 1, 2


class Body(NamedTuple):
    """One body and what moves it.

    ``is_ball``; ``mode`` FLICKED (thrown once, then left alone), PUSHED by a finger or DRIVEN;
    ``x_m``, ``y_m`` the start; ``heading_rad`` of the motion, which a block also faces;
    ``half_m`` ball radius or half side; ``friction`` the rolling deceleration in m/s^2 of a ball,
    mu of a block; ``speed_m_s`` after the flick, or mean of the driven move; ``start_s`` of the
    motion, 0 = already moving; ``length_m`` of the driven move; ``side_m`` by which the finger is
    off the middle.
    """

    is_ball: bool
    mode: int
    x_m: float
    y_m: float
    heading_rad: float
    half_m: float
    friction: float
    speed_m_s: float = 0.0
    start_s: float = 0.0
    length_m: float = 0.0
    side_m: float = 0.0


@dataclass(frozen=True)
class Run:
    """What b bodies did: ``t_s (n,)``, ``pos_m``, ``vel_m_s (b, n, 3)``, ``touch (b - 1, n)``.

    ``touch`` says when the bodies after the first one lie against the first one; ``contact_s``
    (b - 1,) is the first such time, inf if none.
    """

    t_s: Array
    pos_m: Array
    vel_m_s: Array
    touch: Array

    @property
    def contact_s(self) -> Array:
        """Return the first time (b - 1,) at which each other body touches the first one."""
        first = self.t_s[np.argmax(self.touch, axis=1)]
        contact: Array = np.where(self.touch.any(axis=1), first, np.inf)
        return contact


def run(bodies: Sequence[Body], until_s: float, step_s: float = STEP_S) -> Run:
    """Simulate a table from time 0 to ``until_s``; the first body is the one that is watched.

    Raises
    ------
    MissingExtraError : MuJoCo is not installed.
    """
    mujoco, rollout = module("mujoco"), module("mujoco.rollout")
    model = mujoco.MjModel.from_xml_string(_xml(bodies, step_s))
    data = mujoco.MjData(model)
    for number, body in enumerate(bodies):
        _throw(model, data, number, body)
    n_steps = int(math.ceil(until_s / step_s))
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    start = np.zeros(size)
    mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    spec = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_XFRC_APPLIED
    plan = _controls(model, bodies, n_steps, step_s)
    states, sensed = rollout.rollout(
        model, data, start[None], plan[None], control_spec=int(spec), nstep=n_steps
    )
    # the state after a step, and what was sensed before it
    states = np.concatenate([start[None], states[0]])
    touch = np.concatenate([sensed[0], sensed[0][-1:]]).T > 0.0
    places = [_motion(model, number, body, states) for number, body in enumerate(bodies)]
    return Run(
        t_s=np.arange(n_steps + 1) * step_s,
        pos_m=np.stack([place for place, _ in places]),
        vel_m_s=np.stack([velocity for _, velocity in places]),
        touch=touch,
    )


def min_jerk(share: Array) -> Array:
    """Return the share of the way done at a share of the time, both 0 to 1."""
    done: Array = share**3 * (10.0 - 15.0 * share + 6.0 * share * share)
    return done


def _xml(bodies: Sequence[Body], step_s: float) -> str:
    world: List[str] = []
    motors: List[str] = []
    for number, body in enumerate(bodies):
        world.append(_body_xml(number, body))
        if body.mode == DRIVEN:
            motors += _motor_xml(f"b{number}", _HAND_KG)
        if body.mode == PUSHED:
            world.append(_finger_xml(number, body))
            motors += _motor_xml(f"f{number}", _HAND_KG)
    sensors = [f'<contact geom1="b0" geom2="b{i}" data="found"/>' for i in range(1, len(bodies))]
    return (
        f'<mujoco><option timestep="{step_s}" integrator="implicitfast" cone="elliptic" '
        f'impratio="{_FRICTION_RATIO}"/><worldbody><geom type="plane" size="0 0 1"/>'
        f"{''.join(world)}</worldbody>"
        f"<actuator>{''.join(motors)}</actuator><sensor>{''.join(sensors)}</sensor></mujoco>"
    )


def _body_xml(number: int, body: Body) -> str:
    turn = f'euler="0 0 {math.degrees(body.heading_rad)}"'
    # A finger touches its own block and nothing else: their masks share one bit.
    masks = f'contype="1" conaffinity="{1 | (2 << number)}"'
    if body.mode == DRIVEN:
        height, joints, mass = body.half_m + _HAND_GAP_M, _slides(f"b{number}"), _HAND_KG
    else:
        height, joints = body.half_m, f'<freejoint name="b{number}"/>'
        mass = _BALL_KG if body.is_ball else _BLOCK_KG
    if body.is_ball:
        # rolling resistance c in metres: deceleration c g / (1.4 r)
        roll_m = 1.4 * body.half_m * body.friction / GRAVITY_M_S2
        shape = f'type="sphere" size="{body.half_m}" condim="6" friction="{_GRIP} 1e-4 {roll_m}"'
    else:
        half = body.half_m
        shape = f'type="box" size="{half} {half} {half}" friction="{body.friction} 1e-4 1e-5"'
    return (
        f'<body name="b{number}" pos="{body.x_m} {body.y_m} {height}">{joints}'
        f'<geom name="b{number}" {shape} {turn} mass="{mass}" priority="1" '
        f'solref="{_CONTACT_S} 1" {masks}/></body>'
    )


def _finger_xml(number: int, body: Body) -> str:
    back = body.half_m + FINGER_M + _FINGER_GAP_M
    cos, sin = math.cos(body.heading_rad), math.sin(body.heading_rad)
    x = body.x_m - back * cos - body.side_m * sin
    y = body.y_m - back * sin + body.side_m * cos
    return (
        f'<body name="f{number}" pos="{x} {y} {body.half_m}">{_slides(f"f{number}")}<geom '
        f'type="box" size="{FINGER_M} {0.8 * body.half_m} {FINGER_M}" mass="{_HAND_KG}" '
        f'contype="{2 << number}" conaffinity="0" euler="0 0 {math.degrees(body.heading_rad)}"/>'
        "</body>"
    )


def _slides(name: str) -> str:
    return "".join(
        f'<joint name="{name}{axis}" type="slide" axis="{direction}"/>'
        for axis, direction in (("x", "1 0 0"), ("y", "0 1 0"))
    )


def _motor_xml(name: str, mass_kg: float) -> List[str]:
    stiffness = mass_kg * _FOLLOW_RAD_S**2
    damping = 2.0 * mass_kg * _FOLLOW_RAD_S
    return [
        f'<position name="{name}{axis}" joint="{name}{axis}" kp="{stiffness}" kv="{damping}"/>'
        for axis in "xy"
    ]


def _throw(model: Any, data: Any, number: int, body: Body) -> None:
    """Give a body that moves from the start its speed; a ball rolls without slipping."""
    if body.mode != FLICKED or body.start_s > 0.0 or body.speed_m_s == 0.0:
        return
    first = int(model.joint(f"b{number}").dofadr[0])
    vx = body.speed_m_s * math.cos(body.heading_rad)
    vy = body.speed_m_s * math.sin(body.heading_rad)
    data.qvel[first : first + 2] = vx, vy
    if body.is_ball:
        data.qvel[first + 3 : first + 5] = -vy / body.half_m, vx / body.half_m


def _controls(model: Any, bodies: Sequence[Body], n_steps: int, step_s: float) -> Array:
    """Return per step the planned way of each motor and the force and torque on each body."""
    time = np.arange(n_steps) * step_s
    ways = np.zeros((n_steps, model.nu))
    forces = np.zeros((n_steps, model.nbody, 6))
    for number, body in enumerate(bodies):
        heading = np.array([math.cos(body.heading_rad), math.sin(body.heading_rad)])
        if body.mode == FLICKED and body.start_s > 0.0:
            is_on = (time >= body.start_s) & (time < body.start_s + FLICK_S)
            push = _flick_n(body) * is_on[:, None] * heading
            forces[:, model.body(f"b{number}").id, :2] = push
        elif body.mode != FLICKED and body.speed_m_s > 0.0:
            name = f"{'b' if body.mode == DRIVEN else 'f'}{number}x"
            share = (time - body.start_s) * body.speed_m_s / body.length_m
            way = body.length_m * min_jerk(np.clip(share, 0.0, 1.0))
            motor = int(model.actuator(name).id)
            ways[:, motor : motor + 2] = way[:, None] * heading
    return np.concatenate([ways, forces.reshape(n_steps, -1)], axis=1)


def _flick_n(body: Body) -> float:
    """Return the force that brings a body to its speed against its friction while it acts."""
    gain = body.speed_m_s / FLICK_S
    if body.is_ball:
        return 1.4 * _BALL_KG * (gain + body.friction)
    return _BLOCK_KG * (gain + body.friction * GRAVITY_M_S2)


def _motion(model: Any, number: int, body: Body, states: Array) -> Tuple[Array, Array]:
    """Return position and velocity (n, 3) of a body out of full-physics states (time first)."""
    n_dims = 2 if body.mode == DRIVEN else 3
    joint = model.joint(f"b{number}x" if body.mode == DRIVEN else f"b{number}")
    first, dof = 1 + int(joint.qposadr[0]), 1 + model.nq + int(joint.dofadr[0])
    place, velocity = np.zeros((len(states), 3)), np.zeros((len(states), 3))
    place[:, :n_dims] = states[:, first : first + n_dims]
    velocity[:, :n_dims] = states[:, dof : dof + n_dims]
    if body.mode == DRIVEN:
        place += [body.x_m, body.y_m, body.half_m + _HAND_GAP_M]
    return place, velocity
