"""Where things may lie at the start of a scene: in view, apart, and out of the mover's way."""

import math
from typing import List, Tuple

import numpy as np

from apex_edge.twin.scene import TABLE_X_M, TABLE_Y_M, Point, SceneObject
from apex_edge.twin.view import is_in_view, twin_camera_model

APART_M = 0.012
CORRIDOR_M = 0.075
OTHER_COLOURS: Tuple[str, ...] = ("blue", "yellow", "purple", "orange")
_CAMERA = twin_camera_model()


def polar(radius_m: float, angle_rad: float) -> Point:
    """Return the table point at a radius and angle from the arm's base."""
    return radius_m * math.cos(angle_rad), radius_m * math.sin(angle_rad)


def heading(start: Point, end: Point) -> float:
    """Return the direction from one point to another, in rad."""
    return math.atan2(end[1] - start[1], end[0] - start[0])


def shifted(point: Point, angle_rad: float, way_m: float) -> Point:
    """Return the point ``way_m`` further along a direction."""
    return point[0] + way_m * math.cos(angle_rad), point[1] + way_m * math.sin(angle_rad)


def red_block(
    rng: np.random.RandomState, name: str = "red block", look: str = "plain"
) -> SceneObject:
    """Place what is to be protected: 0.085..0.11 m from the base, within 55 degrees of ahead.

    Further out the arm's hand leans so low that it cannot stand guard on the far side of a block
    without touching it: from 0.12 m on there is no safe point against a mover that comes straight
    at the arm (counted with the roll-outs, 0 of 1412).
    """
    at = polar(float(rng.uniform(0.085, 0.11)), math.radians(float(rng.uniform(-55.0, 55.0))))
    return plain_block(rng, name, "red", at, float(rng.uniform(-0.7, 0.7)), look)


def plain_block(
    rng: np.random.RandomState,
    name: str,
    colour: str,
    at: Point,
    yaw_rad: float,
    look: str = "plain",
) -> SceneObject:
    """Return a wooden cube of 30 to 40 mm."""
    half = float(rng.uniform(0.015, 0.020))
    mass = 600.0 * (2.0 * half) ** 3
    friction = float(rng.uniform(0.2, 0.35))
    return SceneObject(
        name, colour, "block", half, at, yaw_rad=yaw_rad, mass_kg=mass, friction=friction, look=look
    )


def is_safe_path(item: SceneObject, start: Point, end: Point) -> bool:
    """Say whether an object stays on the table and wholly in view from start to end."""
    if not (_is_on_table(start, item.radius_m) and _is_on_table(end, item.radius_m)):
        return False
    points = np.array(
        [(*start, item.radius_m), (*end, item.radius_m), (*item.pos_m, item.radius_m)]
    )
    return is_in_view(_CAMERA, points, 1.5 * item.radius_m)


def is_clear(objects: List[SceneObject]) -> bool:
    """Say whether no two objects lie closer together than 12 mm."""
    for i, a in enumerate(objects):
        for b in objects[i + 1 :]:
            distance = math.hypot(a.pos_m[0] - b.pos_m[0], a.pos_m[1] - b.pos_m[1])
            if distance < _reach(a) + _reach(b) + APART_M:
                return False
    return True


def clutter(
    rng: np.random.RandomState,
    n_wanted: int,
    present: List[SceneObject],
    start: Point,
    end: Point,
    n_moving: int = 0,
) -> List[SceneObject]:
    """Scatter up to ``n_wanted`` other objects away from the way start..end and from each other.

    The first ``n_moving`` of them are balls that roll slowly away from that way.
    """
    found: List[SceneObject] = []
    for _ in range(60 * n_wanted):
        if len(found) == n_wanted:
            break
        at = float(rng.uniform(0.02, 0.42)), float(rng.uniform(-0.30, 0.30))
        item = _other(rng, at, len(found), is_moving=len(found) < n_moving)
        if len(found) < n_moving:
            item = _rolled_away(rng, item, start, end)
        is_far = _way_distance(at, start, end) >= CORRIDOR_M
        is_off_base = math.hypot(*at) >= 0.09
        if is_far and is_off_base and _fits(item, present + found):
            found.append(item)
    return found


def _fits(item: SceneObject, others: List[SceneObject]) -> bool:
    return is_safe_path(item, item.pos_m, item.pos_m) and is_clear([item, *others])


def _reach(item: SceneObject) -> float:
    return item.radius_m * (math.sqrt(2.0) if item.kind == "block" else 1.0)


def _is_on_table(at: Point, radius_m: float) -> bool:
    room = 1.5 * radius_m
    is_x = TABLE_X_M[0] + room <= at[0] <= TABLE_X_M[1] - room
    return is_x and TABLE_Y_M[0] + room <= at[1] <= TABLE_Y_M[1] - room


def _other(rng: np.random.RandomState, at: Point, index: int, is_moving: bool) -> SceneObject:
    colour = OTHER_COLOURS[int(rng.randint(0, len(OTHER_COLOURS)))]
    is_ball = is_moving or rng.uniform() < 0.4
    name = f"{colour} {'ball' if is_ball else 'block'} {index + 1}"
    if is_ball:
        return SceneObject(
            name, colour, "ball", 0.015, at, friction=float(rng.uniform(0.004, 0.012))
        )
    return plain_block(rng, name, colour, at, float(rng.uniform(-0.8, 0.8)))


def _rolled_away(
    rng: np.random.RandomState, item: SceneObject, start: Point, end: Point
) -> SceneObject:
    """Give a ball a slow roll away from the nearest point of the way start..end."""
    near = _nearest_on_way(item.pos_m, start, end)
    angle = heading(near, item.pos_m) + float(rng.uniform(-0.6, 0.6))
    speed = float(rng.uniform(0.02, 0.06))
    rolling = (speed * math.cos(angle), speed * math.sin(angle))
    return SceneObject(
        item.name, item.colour, "ball", item.radius_m, item.pos_m, rolling, friction=item.friction
    )


def _nearest_on_way(at: Point, start: Point, end: Point) -> Point:
    dx, dy = end[0] - start[0], end[1] - start[1]
    square = dx * dx + dy * dy
    share = 0.0
    if square > 0.0:
        share = min(max(((at[0] - start[0]) * dx + (at[1] - start[1]) * dy) / square, 0.0), 1.0)
    return start[0] + share * dx, start[1] + share * dy


def _way_distance(at: Point, start: Point, end: Point) -> float:
    near = _nearest_on_way(at, start, end)
    return math.hypot(at[0] - near[0], at[1] - near[1])
