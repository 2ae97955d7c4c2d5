"""The table as a 2-D world: balls that roll, blocks that slide, hands that push, an arm in the way.

Time moves in sub-steps of at most 2 ms. Everything is deterministic: the only input besides the
scenario is the arm's pose, so the same calls give the same world on every machine.
"""

import math
from dataclasses import dataclass
from typing import Dict, FrozenSet, List, Optional, Tuple

import numpy as np

from apex_edge.twin.contact import Body, collide, find_contact, gap_m
from apex_edge.twin.scene import (
    GRAVITY_M_S2,
    TABLE_X_M,
    TABLE_Y_M,
    HandMotion,
    Scenario,
    SceneObject,
)
from apex_edge.types import Array

SUB_STEP_S = 0.002
RESTITUTION = 0.3
WALL_RESTITUTION = 0.4
ARM_RESTITUTION = 0.1
# Soft fingertips: what is left of the speed along the surface after an impact.
ARM_GLIDE = 0.3
TIP_RADIUS_M = 0.012
HAND_LIMIT_KG = 0.2
HAND_JAM_M = 0.004
ARM_SAMPLE_M = 0.006


@dataclass(frozen=True)
class WorldObjects:
    """The bodies as struct of arrays, n of them, in the order of the scenario.

    ``pos_m (n, 3)`` centre (z is the centre's height), ``vel_m_s (n, 3)``, ``yaw_rad (n,)``,
    ``radius_m (n,)`` (half side of a block).
    """

    name: Tuple[str, ...]
    colour: Tuple[str, ...]
    kind: Tuple[str, ...]
    look: Tuple[str, ...]
    pos_m: Array
    vel_m_s: Array
    yaw_rad: Array
    radius_m: Array


@dataclass(frozen=True)
class HandPose:
    """Where a hand's fingertips are: ``pos_m`` x, y, pointing along ``heading_rad``."""

    object_name: str
    pos_m: Tuple[float, float]
    vel_m_s: Tuple[float, float]
    heading_rad: float


@dataclass(frozen=True)
class WorldState:
    """All a picture needs, taken at one instant.

    ``arm_m (j, 3)`` shoulder to tip and ``arm_vel_m_s (j, 3)``, or None when no arm was set.
    """

    t_s: float
    objects: WorldObjects
    hands: Tuple[HandPose, ...]
    arm_m: Optional[Array]
    arm_vel_m_s: Optional[Array]


class _Hand:
    """A hand and how far it got: driving, given up or done."""

    def __init__(self, motion: HandMotion, body: Optional[Body]) -> None:
        self.motion = motion
        self.body = body
        self.is_driving = body is not None
        self.stopped_s = math.inf
        # A fingertip touches the back face of what it pushes.
        self.reach_m = body.size_m if body is not None else 0.0
        self.peak_m_s = _peak_speed(motion)

    def move(self, t_s: float) -> None:
        """Put the driven body where the hand has it at ``t_s``; let go at the end."""
        body = self.body
        if body is None or not self.is_driving or t_s < self.motion.start_s:
            return
        body.x, body.y, body.vx, body.vy = self.motion.pose(t_s)
        body.spin_rad_s = 0.0
        if body.is_box:
            body.turn_to(self.motion.heading_rad(t_s))
        if t_s >= self.motion.end_s:
            self.is_driving = body.is_driven = False
            self.stopped_s = self.motion.end_s

    def give_up(self, t_s: float) -> None:
        """Stop at once and leave the body at rest where it is."""
        if self.body is None or not self.is_driving:
            return
        self.is_driving = self.body.is_driven = False
        self.stopped_s = t_s
        self.body.vx = self.body.vy = self.body.spin_rad_s = 0.0

    def pose(self, t_s: float) -> HandPose:
        """Return the fingertips' place; after a flick the hand draws back by 5 cm."""
        motion = self.motion
        at_s = min(t_s, self.stopped_s)
        x, y, vx, vy = motion.pose(at_s)
        heading = motion.heading_rad(at_s)
        back = self.reach_m
        if t_s > self.stopped_s:
            vx = vy = 0.0
            if motion.profile == "flick":
                tau = min((t_s - self.stopped_s) / 0.6, 1.0)
                back += 0.05 * tau * tau * (3.0 - 2.0 * tau)
        c, s = math.cos(heading), math.sin(heading)
        return HandPose(motion.object_name, (x - back * c, y - back * s), (vx, vy), heading)


class TwinWorld:
    """Steps one scenario; reads like a table: ``objects``, ``contacts``, ``arm_contacts``, ``t_s``.

    ``contacts`` maps the frozenset of two object names to the time they first touched,
    ``arm_contacts`` an object's name to the time the arm first touched it. Source: ours.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.t_s = 0.0
        self.contacts: Dict[FrozenSet[str], float] = {}
        self.arm_contacts: Dict[str, float] = {}
        self.names: Tuple[str, ...] = tuple(item.name for item in scenario.objects)
        self._bodies: List[Body] = [_body(item) for item in scenario.objects]
        self._hands: List[_Hand] = [self._hand(motion) for motion in scenario.hands]
        self._arm_m: Optional[Array] = None
        self._arm_vel_m_s: Optional[Array] = None
        self._arm_set_s = 0.0
        self._discs: List[Tuple[float, float, float]] = []
        self._disc = Body(False, TIP_RADIUS_M, 0.0)
        self._quiet_until_s = 0.0

    def step(self, dt_s: float) -> None:
        """Move on by ``dt_s`` seconds in equal sub-steps of at most 2 ms."""
        n_steps = max(1, math.ceil(dt_s / SUB_STEP_S - 1e-9))
        for _ in range(n_steps):
            self._sub_step(dt_s / n_steps)

    def set_arm(self, points_m: Array) -> None:
        """Set the arm's pose: ``points_m (j, 3)``, shoulder first, tip last.

        The arm is immovable. Wherever the links after the elbow come lower than an object is
        high, discs of the tip's radius stop or deflect that object.
        """
        points = np.array(points_m, dtype=np.float64)
        if points.ndim != 2 or points.shape[0] < 2 or points.shape[1] != 3:
            raise ValueError(f"the arm needs points of shape (j >= 2, 3), found {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError("the arm's points must be finite")
        elapsed = self.t_s - self._arm_set_s
        if self._arm_m is None or self._arm_m.shape != points.shape:
            self._arm_vel_m_s = np.zeros_like(points)
        elif elapsed > 0.0:
            self._arm_vel_m_s = (points - self._arm_m) / elapsed
        self._arm_m, self._arm_set_s = points, self.t_s
        tallest = max([body.top_m for body in self._bodies], default=0.0)
        self._discs = _low_discs(points, tallest)

    @property
    def objects(self) -> WorldObjects:
        """The bodies now, as arrays of their own."""
        items, bodies = self.scenario.objects, self._bodies
        return WorldObjects(
            name=self.names,
            colour=tuple(item.colour for item in items),
            kind=tuple(item.kind for item in items),
            look=tuple(item.look for item in items),
            pos_m=np.array([(b.x, b.y, b.size_m) for b in bodies]).reshape(-1, 3),
            vel_m_s=np.array([(b.vx, b.vy, 0.0) for b in bodies]).reshape(-1, 3),
            yaw_rad=np.array([b.yaw_rad for b in bodies]),
            radius_m=np.array([b.size_m for b in bodies]),
        )

    @property
    def is_at_rest(self) -> bool:
        """Say whether nothing moves and no hand is still to move anything."""
        return all(body.is_still for body in self._bodies) and not any(
            hand.is_driving for hand in self._hands
        )

    def state(self) -> WorldState:
        """Return everything a picture needs, as of now."""
        return WorldState(
            t_s=self.t_s,
            objects=self.objects,
            hands=tuple(hand.pose(self.t_s) for hand in self._hands),
            arm_m=self._arm_m,
            arm_vel_m_s=self._arm_vel_m_s,
        )

    def gap_m(self, first: str, second: str) -> float:
        """Return the distance between two objects' outlines in m, negative when they overlap."""
        return gap_m(self._bodies[self._index(first)], self._bodies[self._index(second)])

    def speed_m_s(self, name: str) -> float:
        """Return an object's speed."""
        body = self._bodies[self._index(name)]
        return math.hypot(body.vx, body.vy)

    def energy_j(self) -> float:
        """Return the kinetic energy of all bodies."""
        return sum(body.energy_j() for body in self._bodies)

    def _index(self, name: str) -> int:
        self.scenario.find(name)
        return self.names.index(name)

    def _hand(self, motion: HandMotion) -> _Hand:
        if motion.profile == "rest" or not motion.object_name:
            return _Hand(motion, None)
        body = self._bodies[self._index(motion.object_name)]
        body.is_driven = True
        return _Hand(motion, body)

    def _sub_step(self, dt_s: float) -> None:
        self.t_s += dt_s
        for hand in self._hands:
            hand.move(self.t_s)
        for body in self._bodies:
            if not body.is_driven and not body.is_still:
                _coast(body, dt_s)
        if self._discs:
            self._meet_arm()
        if self.t_s >= self._quiet_until_s:
            self._meet_walls()
            self._quiet_until_s = self.t_s + self._meet_each_other()

    def _meet_each_other(self) -> float:
        """Resolve all contacts between bodies; return for how long none can follow, in s."""
        bodies = self._bodies
        free_m = self._wall_gap_m()
        for i, a in enumerate(bodies):
            for j in range(i + 1, len(bodies)):
                b = bodies[j]
                if a.is_still and b.is_still:
                    continue
                distance = math.hypot(b.x - a.x, b.y - a.y) - a.reach_m - b.reach_m
                free_m = min(free_m, distance)
                if distance <= 0.0:
                    self._meet(i, j)
        fastest = max([hand.peak_m_s for hand in self._hands if hand.is_driving], default=0.0)
        for body in bodies:
            fastest = max(fastest, math.hypot(body.vx, body.vy))
        if free_m <= 0.0:
            return 0.0
        return min(0.5 * free_m / fastest, 1.0) if fastest > 0.0 else 1.0

    def _wall_gap_m(self) -> float:
        free_m = math.inf
        for b in self._bodies:
            if not b.is_still or b.is_driven:
                free_m = min(free_m, b.x - TABLE_X_M[0] - b.reach_m, TABLE_X_M[1] - b.x - b.reach_m)
                free_m = min(free_m, b.y - TABLE_Y_M[0] - b.reach_m, TABLE_Y_M[1] - b.y - b.reach_m)
        return free_m

    def _meet(self, i: int, j: int) -> None:
        a, b = self._bodies[i], self._bodies[j]
        contact = find_contact(a, b)
        if contact is None:
            return
        self.contacts.setdefault(frozenset((self.names[i], self.names[j])), self.t_s)
        self._quiet_until_s = 0.0
        collide(a, b, contact, RESTITUTION)
        for pusher, other in ((a, b), (b, a)):
            is_heavy = other.is_driven or other.inv_mass * HAND_LIMIT_KG < 1.0
            if pusher.is_driven and (is_heavy or contact[2] > HAND_JAM_M):
                self._give_up(pusher)

    def _meet_walls(self) -> None:
        for body in self._bodies:
            extent = body.size_m
            if body.is_box:
                extent *= abs(body.cos) + abs(body.sin)
            x = min(max(body.x, TABLE_X_M[0] + extent), TABLE_X_M[1] - extent)
            y = min(max(body.y, TABLE_Y_M[0] + extent), TABLE_Y_M[1] - extent)
            if x == body.x and y == body.y:
                continue
            if body.is_driven:
                self._give_up(body)
            if (x - body.x) * body.vx < 0.0:
                body.vx *= -WALL_RESTITUTION
            if (y - body.y) * body.vy < 0.0:
                body.vy *= -WALL_RESTITUTION
            body.x, body.y, body.spin_rad_s = x, y, 0.5 * body.spin_rad_s

    def _meet_arm(self) -> None:
        disc = self._disc
        for index, body in enumerate(self._bodies):
            reach = body.reach_m + TIP_RADIUS_M
            for x, y, height in self._discs:
                if height > body.top_m or abs(body.x - x) > reach or abs(body.y - y) > reach:
                    continue
                disc.x, disc.y = x, y
                contact = find_contact(disc, body)
                if contact is None:
                    continue
                self.arm_contacts.setdefault(self.names[index], self.t_s)
                self._quiet_until_s = 0.0
                if body.is_driven:
                    self._give_up(body)
                if collide(disc, body, contact, ARM_RESTITUTION) > 0.0:
                    _grip(body, contact[0], contact[1])

    def _give_up(self, body: Body) -> None:
        for hand in self._hands:
            if hand.body is body:
                hand.give_up(self.t_s)


def _body(item: SceneObject) -> Body:
    body = Body(item.kind == "block", item.radius_m, item.mass_kg)
    body.x, body.y = item.pos_m
    body.vx, body.vy = item.vel_m_s
    body.turn_to(item.yaw_rad)
    if item.kind == "block":
        body.drag_m_s2 = item.friction * GRAVITY_M_S2
        # Sliding friction of a square that turns on the spot: mean arm 0.765 h, inertia 2/3 h^2.
        body.spin_drag = 1.15 * body.drag_m_s2 / item.radius_m
    else:
        body.drag_m_s2 = item.friction
    return body


def _coast(body: Body, dt_s: float) -> None:
    """Move a free body under its friction, exactly, and stop it where it stops."""
    speed = math.hypot(body.vx, body.vy)
    if speed > 0.0:
        loss = body.drag_m_s2 * dt_s
        left = speed - loss if speed > loss else 0.0
        way = 0.5 * (speed + left) * dt_s
        if left == 0.0:
            way = 0.5 * speed * speed / body.drag_m_s2
        body.x += body.vx / speed * way
        body.y += body.vy / speed * way
        body.vx *= left / speed
        body.vy *= left / speed
    spin = body.spin_rad_s
    if spin != 0.0:
        body.turn_to(body.yaw_rad + spin * dt_s)
        loss = body.spin_drag * dt_s
        body.spin_rad_s = math.copysign(max(abs(spin) - loss, 0.0), spin)


def _grip(body: Body, nx: float, ny: float) -> None:
    """Take most of a body's speed along the arm's surface, as soft fingertips do."""
    across = body.vx * nx + body.vy * ny
    body.vx = across * nx + ARM_GLIDE * (body.vx - across * nx)
    body.vy = across * ny + ARM_GLIDE * (body.vy - across * ny)


def _low_discs(points: Array, tallest_m: float) -> List[Tuple[float, float, float]]:
    """Sample x, y, z along the links after the elbow, where they are lower than ``tallest_m``."""
    discs: List[Tuple[float, float, float]] = []
    tip = points[-1]
    if tip[2] <= tallest_m:
        discs.append((float(tip[0]), float(tip[1]), float(tip[2])))
    for start, end in zip(points[-2:0:-1], points[:0:-1]):
        if start[2] > tallest_m and end[2] > tallest_m:
            continue
        n_parts = max(1, math.ceil(float(np.linalg.norm(end - start)) / ARM_SAMPLE_M))
        for k in range(1, n_parts + 1):
            x, y, z = (end + (start - end) * (k / n_parts)).tolist()
            if z <= tallest_m:
                discs.append((x, y, z))
    return discs


def _peak_speed(motion: HandMotion) -> float:
    """Bound the speed a hand gives its object, in m/s."""
    if motion.profile == "rest":
        return 0.0
    times = [motion.start_s + motion.duration_s * k / 50.0 for k in range(51)]
    return 1.1 * max(math.hypot(*motion.pose(t)[2:]) for t in times)
