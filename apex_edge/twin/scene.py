"""What a scene is made of: objects at rest or rolling, hands that move them, what is at stake."""

import math
from dataclasses import dataclass
from typing import Optional, Tuple

from apex_edge.errors import InputError

Point = Tuple[float, float]

TABLE_X_M: Tuple[float, float] = (-0.05, 0.55)
TABLE_Y_M: Tuple[float, float] = (-0.40, 0.40)
GRAVITY_M_S2 = 9.81
UNIFORM_RAMP_S = 0.4
FINGER_GAP_M = 0.002


@dataclass(frozen=True)
class SceneObject:
    """One body on the table at the start of a scene.

    ``kind`` is "ball" (a sphere of ``radius_m``) or "block" (a cube of half side ``radius_m``);
    ``look`` changes only how it is drawn: "plain", "car" or "child". ``friction`` is the rolling
    deceleration in m/s^2 of a ball, and the sliding coefficient mu of a block.
    """

    name: str
    colour: str
    kind: str
    radius_m: float
    pos_m: Point
    vel_m_s: Point = (0.0, 0.0)
    yaw_rad: float = 0.0
    mass_kg: float = 0.02
    friction: float = 0.008
    look: str = "plain"

    @property
    def top_m(self) -> float:
        """Height of the highest point over the table."""
        return 2.0 * self.radius_m


@dataclass(frozen=True)
class HandMotion:
    """A hand that moves one object from ``start_m`` over ``via_m`` to ``end_m``.

    The path is the quadratic Bezier curve of the three points (straight when ``via_m`` is the
    middle). ``profile`` says how it is run through in time: "min-jerk", "uniform" (constant speed
    after a short ramp), "flick" (constant acceleration, then the object is let go) or "rest"
    (a hand that lies at ``start_m`` pointing to ``end_m`` and moves nothing).
    Source: minimum jerk as in Flash and Hogan 1985; the scenes are ours.
    """

    object_name: str
    profile: str
    start_s: float
    duration_s: float
    start_m: Point
    via_m: Point
    end_m: Point

    @property
    def end_s(self) -> float:
        """Time at which the move is over."""
        return self.start_s + self.duration_s

    def progress(self, t_s: float) -> Tuple[float, float]:
        """Return the share of the path done, 0..1, and its rate in 1/s."""
        if self.profile == "rest" or t_s <= self.start_s:
            return 0.0, 0.0
        if t_s >= self.end_s:
            return 1.0, 2.0 / self.duration_s if self.profile == "flick" else 0.0
        tau = (t_s - self.start_s) / self.duration_s
        if self.profile == "flick":
            return tau * tau, 2.0 * tau / self.duration_s
        if self.profile == "uniform":
            return _trapezoid(t_s - self.start_s, self.duration_s)
        share = tau * tau * tau * (10.0 - 15.0 * tau + 6.0 * tau * tau)
        return share, 30.0 * tau * tau * (1.0 - tau) * (1.0 - tau) / self.duration_s

    def pose(self, t_s: float) -> Tuple[float, float, float, float]:
        """Return x, y in m and their speeds in m/s of the moved object's centre."""
        share, rate = self.progress(t_s)
        x, y = self.at(share)
        slope_x, slope_y = self.slope(share)
        return x, y, slope_x * rate, slope_y * rate

    def at(self, share: float) -> Point:
        """Return the point at a share 0..1 of the Bezier parameter."""
        a, b, c = (1.0 - share) ** 2, 2.0 * share * (1.0 - share), share * share
        return (
            a * self.start_m[0] + b * self.via_m[0] + c * self.end_m[0],
            a * self.start_m[1] + b * self.via_m[1] + c * self.end_m[1],
        )

    def slope(self, share: float) -> Point:
        """Return the derivative of the path with respect to its parameter, in m."""
        a, b = 2.0 * (1.0 - share), 2.0 * share
        return (
            a * (self.via_m[0] - self.start_m[0]) + b * (self.end_m[0] - self.via_m[0]),
            a * (self.via_m[1] - self.start_m[1]) + b * (self.end_m[1] - self.via_m[1]),
        )

    def heading_rad(self, t_s: float) -> float:
        """Return the direction of travel (of the fingers, for a resting hand)."""
        slope_x, slope_y = self.slope(self.progress(t_s)[0])
        return math.atan2(slope_y, slope_x)


def _trapezoid(elapsed_s: float, duration_s: float) -> Tuple[float, float]:
    """Run through 0..1 at constant rate between two ramps of constant acceleration."""
    ramp = min(UNIFORM_RAMP_S, 0.5 * duration_s)
    top = 1.0 / (duration_s - ramp)
    if elapsed_s < ramp:
        return 0.5 * top * elapsed_s * elapsed_s / ramp, top * elapsed_s / ramp
    if elapsed_s > duration_s - ramp:
        left = duration_s - elapsed_s
        return 1.0 - 0.5 * top * left * left / ramp, top * left / ramp
    return top * (elapsed_s - 0.5 * ramp), top


def straight(
    object_name: str, profile: str, span_s: Tuple[float, float], start_m: Point, end_m: Point
) -> HandMotion:
    """Return a motion along a straight line; ``span_s`` is (start, duration) in s."""
    middle = (0.5 * (start_m[0] + end_m[0]), 0.5 * (start_m[1] + end_m[1]))
    return HandMotion(object_name, profile, span_s[0], span_s[1], start_m, middle, end_m)


@dataclass(frozen=True)
class Scenario:
    """One reproducible scene: everything that happens on the table unless the arm steps in.

    ``mover`` and ``target`` name the pair at stake ("" when nothing threatens the target);
    ``is_collision`` says whether they touch with no arm; ``mode`` is the decision mode the scene
    is meant for, "reflex_first" (explicit) or "wait_until_deadline" (implicit).
    """

    kind: str
    seed: int
    objects: Tuple[SceneObject, ...]
    hands: Tuple[HandMotion, ...]
    duration_s: float
    mover: str
    target: str
    is_collision: bool
    mode: str = "reflex_first"

    def find(self, name: str) -> SceneObject:
        """Return the object of that name.

        Raises
        ------
        InputError : the scene has no such object.
        """
        for item in self.objects:
            if item.name == name:
                return item
        known = ", ".join(item.name for item in self.objects)
        raise InputError(f"scene {self.kind} {self.seed} has no object {name!r}; it has {known}")

    def hand_of(self, name: str) -> Optional[HandMotion]:
        """Return the hand that moves that object, if any."""
        for hand in self.hands:
            if hand.object_name == name and hand.profile != "rest":
                return hand
        return None
