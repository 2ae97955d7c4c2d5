"""Contact between discs and square boxes seen from above: where, how deep, and what it does.

Plain Python floats: a scene has a dozen bodies at most, and a numpy call costs more than a pair.
"""

import math
from typing import List, Optional, Tuple

Contact = Tuple[float, float, float, float, float]
"""Normal x, y (from the first body to the second), depth m, contact point x, y."""

SLOP_M = 2e-5
CORRECTION = 0.25


class Body:
    """A rigid body in the plane; ``inv_mass`` 0 means nothing can push it.

    ``size_m`` is the radius of a disc or the half side of a box, ``reach_m`` the radius of the
    circle around it.
    """

    __slots__ = (
        "cos", "drag_m_s2", "inv_inertia", "inv_mass", "is_box", "is_driven", "reach_m",
        "sin", "size_m", "spin_drag", "spin_rad_s", "top_m", "vx", "vy", "x", "y", "yaw_rad",
    )  # fmt: skip

    def __init__(self, is_box: bool, size_m: float, mass_kg: float) -> None:
        self.is_box = is_box
        self.size_m = size_m
        self.reach_m = size_m * math.sqrt(2.0) if is_box else size_m
        self.top_m = 2.0 * size_m
        self.inv_mass = 1.0 / mass_kg if mass_kg > 0.0 else 0.0
        # A square of half side h has inertia 2/3 m h^2. Discs do not spin: no friction acts here.
        self.inv_inertia = 1.5 * self.inv_mass / (size_m * size_m) if is_box else 0.0
        self.is_driven = False
        self.drag_m_s2 = 0.0
        self.spin_drag = 0.0
        self.x = self.y = self.vx = self.vy = self.spin_rad_s = 0.0
        self.turn_to(0.0)

    def turn_to(self, yaw_rad: float) -> None:
        """Set the yaw and what is derived from it."""
        self.yaw_rad = yaw_rad
        self.cos = math.cos(yaw_rad)
        self.sin = math.sin(yaw_rad)

    @property
    def is_still(self) -> bool:
        """Say whether the body neither moves nor spins."""
        return self.vx == 0.0 and self.vy == 0.0 and self.spin_rad_s == 0.0

    def corners(self) -> List[Tuple[float, float]]:
        """Return the four corners of a box, counter-clockwise."""
        c, s = self.cos * self.size_m, self.sin * self.size_m
        x, y = self.x, self.y
        return [
            (x + c - s, y + s + c),
            (x - c - s, y - s + c),
            (x - c + s, y - s - c),
            (x + c + s, y + s - c),
        ]

    def energy_j(self) -> float:
        """Return the kinetic energy (0 for a body of infinite mass)."""
        if self.inv_mass == 0.0:
            return 0.0
        energy = 0.5 * (self.vx * self.vx + self.vy * self.vy) / self.inv_mass
        if self.inv_inertia > 0.0:
            energy += 0.5 * self.spin_rad_s * self.spin_rad_s / self.inv_inertia
        return energy


def find_contact(a: Body, b: Body) -> Optional[Contact]:
    """Return how two bodies overlap, or None."""
    if a.is_box and b.is_box:
        return _box_box(a, b)
    if a.is_box:
        return _flip(_disc_box(b, a))
    if b.is_box:
        return _disc_box(a, b)
    dx, dy = b.x - a.x, b.y - a.y
    reach = a.size_m + b.size_m
    square = dx * dx + dy * dy
    if square >= reach * reach:
        return None
    distance = math.sqrt(square)
    nx, ny = (dx / distance, dy / distance) if distance > 1e-12 else (1.0, 0.0)
    return nx, ny, reach - distance, a.x + nx * a.size_m, a.y + ny * a.size_m


def gap_m(a: Body, b: Body) -> float:
    """Return the distance between two outlines; negative by the depth when they overlap."""
    contact = find_contact(a, b)
    if contact is not None:
        return -contact[2]
    if a.is_box and b.is_box:
        # The shortest way between two convex outlines starts at a corner of one of them.
        gaps = [_point_box(x, y, b) for x, y in a.corners()]
        return min(gaps + [_point_box(x, y, a) for x, y in b.corners()])
    if a.is_box:
        return _point_box(b.x, b.y, a) - b.size_m
    if b.is_box:
        return _point_box(a.x, a.y, b) - a.size_m
    return math.hypot(b.x - a.x, b.y - a.y) - a.size_m - b.size_m


def collide(a: Body, b: Body, contact: Contact, restitution: float) -> float:
    """Apply the impulse of a contact and push the bodies apart; return the closing speed m/s.

    A driven body counts as infinitely heavy. Kinetic energy never grows: the impulse is that of
    a frictionless impact with 0 <= restitution <= 1, and the push changes no speed.
    """
    nx, ny, depth, px, py = contact
    inv_a = 0.0 if a.is_driven else a.inv_mass
    inv_b = 0.0 if b.is_driven else b.inv_mass
    if inv_a + inv_b == 0.0:
        return 0.0
    turn_a = (px - a.x) * ny - (py - a.y) * nx
    turn_b = (px - b.x) * ny - (py - b.y) * nx
    spin_a = 0.0 if a.is_driven else a.inv_inertia
    spin_b = 0.0 if b.is_driven else b.inv_inertia
    closing = (a.vx - b.vx) * nx + (a.vy - b.vy) * ny
    closing += a.spin_rad_s * turn_a - b.spin_rad_s * turn_b
    if closing > 0.0:
        softness = inv_a + inv_b + spin_a * turn_a * turn_a + spin_b * turn_b * turn_b
        impulse = (1.0 + restitution) * closing / softness
        a.vx -= impulse * inv_a * nx
        a.vy -= impulse * inv_a * ny
        a.spin_rad_s -= impulse * spin_a * turn_a
        b.vx += impulse * inv_b * nx
        b.vy += impulse * inv_b * ny
        b.spin_rad_s += impulse * spin_b * turn_b
    push = CORRECTION * max(depth - SLOP_M, 0.0) / (inv_a + inv_b)
    a.x -= push * inv_a * nx
    a.y -= push * inv_a * ny
    b.x += push * inv_b * nx
    b.y += push * inv_b * ny
    return closing


def _flip(contact: Optional[Contact]) -> Optional[Contact]:
    if contact is None:
        return None
    nx, ny, depth, px, py = contact
    return -nx, -ny, depth, px, py


def _point_box(x: float, y: float, box: Body) -> float:
    """Return the distance from a point to a box, negative inside."""
    dx, dy = x - box.x, y - box.y
    along = abs(box.cos * dx + box.sin * dy) - box.size_m
    across = abs(box.cos * dy - box.sin * dx) - box.size_m
    if along <= 0.0 and across <= 0.0:
        return max(along, across)
    return math.hypot(max(along, 0.0), max(across, 0.0))


def _disc_box(disc: Body, box: Body) -> Optional[Contact]:
    dx, dy = disc.x - box.x, disc.y - box.y
    u, v = box.cos * dx + box.sin * dy, box.cos * dy - box.sin * dx
    half = box.size_m
    cu, cv = min(max(u, -half), half), min(max(v, -half), half)
    if cu == u and cv == v:  # the centre is inside: leave by the nearest side
        if half - abs(u) < half - abs(v):
            nu, nv, depth = (-1.0 if u > 0 else 1.0), 0.0, disc.size_m + half - abs(u)
        else:
            nu, nv, depth = 0.0, (-1.0 if v > 0 else 1.0), disc.size_m + half - abs(v)
    else:
        square = (u - cu) ** 2 + (v - cv) ** 2
        if square >= disc.size_m * disc.size_m:
            return None
        distance = math.sqrt(square)
        nu, nv, depth = (cu - u) / distance, (cv - v) / distance, disc.size_m - distance
    return (
        box.cos * nu - box.sin * nv,
        box.sin * nu + box.cos * nv,
        depth,
        box.x + box.cos * cu - box.sin * cv,
        box.y + box.sin * cu + box.cos * cv,
    )


def _box_box(a: Body, b: Body) -> Optional[Contact]:
    """Separating axis test; the contact point is the mean of the corners inside the other box."""
    dx, dy = b.x - a.x, b.y - a.y
    turn_cos = abs(a.cos * b.cos + a.sin * b.sin)
    turn_sin = abs(a.cos * b.sin - a.sin * b.cos)
    spread = turn_cos + turn_sin
    best, nx, ny = math.inf, 0.0, 0.0
    axes = (
        (a.cos, a.sin, a.size_m + b.size_m * spread),
        (-a.sin, a.cos, a.size_m + b.size_m * spread),
        (b.cos, b.sin, b.size_m + a.size_m * spread),
        (-b.sin, b.cos, b.size_m + a.size_m * spread),
    )
    for ax, ay, reach in axes:
        along = dx * ax + dy * ay
        depth = reach - abs(along)
        if depth <= 0.0:
            return None
        if depth < best:
            sign = 1.0 if along > 0.0 else -1.0
            best, nx, ny = depth, sign * ax, sign * ay
    inside = [c for c in a.corners() if _point_box(c[0], c[1], b) <= 1e-6]
    inside += [c for c in b.corners() if _point_box(c[0], c[1], a) <= 1e-6]
    if not inside:  # crossed boxes: no corner of one in the other
        return nx, ny, best, 0.5 * (a.x + b.x), 0.5 * (a.y + b.y)
    n_inside = len(inside)
    return nx, ny, best, sum(c[0] for c in inside) / n_inside, sum(c[1] for c in inside) / n_inside
