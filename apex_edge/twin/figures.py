"""What the twin's solids look like: balls, blocks, a toy car, a child, a hand and the arm."""

import math
from typing import List, Tuple

import numpy as np

from apex_edge.twin.canvas import Canvas, box_corners, shadow_of
from apex_edge.twin.palette import PALETTE, SURROUNDINGS
from apex_edge.twin.world import HandPose, WorldObjects, WorldState
from apex_edge.types import Array

Bar = Tuple[Tuple[float, float, float], Tuple[float, float, float], float, float, str]
"""Ends in the hand's frame (x ahead, y left, z up; m), radii in m, and a surroundings colour."""

_TYRE = (52.0, 50.0, 50.0)
_GLASS = (120.0, 108.0, 98.0)
_HAIR = (38.0, 46.0, 60.0)

HAND_BARS: Tuple[Bar, ...] = (
    ((-0.170, 0.0, 0.040), (-0.360, 0.0, 0.050), 0.031, 0.036, "sleeve"),
    ((-0.095, 0.0, 0.032), (-0.200, 0.0, 0.042), 0.020, 0.025, "skin"),
    ((-0.052, 0.020, 0.028), (-0.100, 0.012, 0.031), 0.012, 0.016, "skin"),
    ((-0.054, 0.004, 0.029), (-0.100, 0.002, 0.032), 0.013, 0.017, "skin"),
    ((-0.052, -0.016, 0.028), (-0.100, -0.010, 0.031), 0.012, 0.016, "skin"),
    ((-0.080, 0.022, 0.028), (-0.034, 0.034, 0.018), 0.010, 0.0068, "skin"),
    ((-0.006, 0.012, 0.017), (-0.056, 0.018, 0.027), 0.0062, 0.0085, "skin"),
    ((-0.006, -0.001, 0.017), (-0.056, 0.002, 0.028), 0.0064, 0.0088, "skin"),
    ((-0.007, -0.014, 0.016), (-0.055, -0.014, 0.027), 0.0060, 0.0085, "skin"),
)


def paint_objects(canvas: Canvas, objects: WorldObjects) -> None:
    """Paint every ball and block."""
    for k in range(len(objects.name)):
        bgr = PALETTE[objects.colour[k]]
        centre, radius = objects.pos_m[k], float(objects.radius_m[k])
        vel, yaw = objects.vel_m_s[k], float(objects.yaw_rad[k])
        if objects.kind[k] == "ball":
            canvas.sphere(centre, radius, bgr, vel, gloss=0.55)
            continue
        canvas.box(centre, np.full(3, radius), yaw, bgr, vel)
        if objects.look[k] == "car":
            _paint_car(canvas, centre, radius, yaw, vel)
        elif objects.look[k] == "child":
            _paint_head(canvas, centre, radius, vel)


def paint_hand(canvas: Canvas, hand: HandPose) -> None:
    """Paint a hand whose fingertips are at the pose."""
    vel = np.array([hand.vel_m_s[0], hand.vel_m_s[1], 0.0])
    for start, end, r_start, r_end, colour in HAND_BARS:
        ends = _placed(hand, np.array([start, end]))
        canvas.capsule(ends, (r_start, r_end), SURROUNDINGS[colour], vel)


def paint_arm(canvas: Canvas, points_m: Array, vel_m_s: Array) -> None:
    """Paint the arm: turntable, links, servos across the joints, closed gripper."""
    dark, light = SURROUNDINGS["arm"], SURROUNDINGS["gripper"]
    still = np.zeros(3)
    shoulder, tip = points_m[0], points_m[-1]
    foot = np.array([shoulder[0], shoulder[1], 0.0])
    canvas.box(foot + (0.0, 0.0, 0.010), np.array([0.042, 0.042, 0.010]), 0.0, dark, still)
    canvas.capsule(np.array([foot + (0.0, 0.0, 0.02), shoulder]), (0.028, 0.022), light, still)
    across = _across(points_m)
    for k in range(len(points_m) - 1):
        radius = 0.0145 - 0.002 * k
        vel = 0.5 * (vel_m_s[k] + vel_m_s[k + 1])
        is_last = k == len(points_m) - 2
        end = points_m[k] + 0.62 * (tip - points_m[k]) if is_last else points_m[k + 1]
        canvas.capsule(np.array([points_m[k], end]), (radius, radius - 0.0015), dark, vel)
        joint = np.array([points_m[k] - 0.019 * across, points_m[k] + 0.019 * across])
        canvas.capsule(joint, (0.013, 0.013), light, vel_m_s[k])
    wrist = points_m[-2]
    for side in (-1.0, 1.0):
        knuckle = wrist + 0.58 * (tip - wrist) + side * 0.013 * across
        jaw = np.array([knuckle, tip + side * 0.0062 * across])
        canvas.capsule(jaw, (0.0065, 0.0055), light, vel_m_s[-1])


def shadows(state: WorldState) -> List[Array]:
    """Return the outlines (k, 3) of what lies in shadow on the table."""
    found: List[Array] = []
    objects = state.objects
    for k in range(len(objects.name)):
        centre, radius = objects.pos_m[k], float(objects.radius_m[k])
        if objects.kind[k] == "ball":
            found.append(shadow_of(centre, radius))
        else:
            corners = box_corners(centre, np.full(3, radius), float(objects.yaw_rad[k]))
            found.append(shadow_of(corners))
    for hand in state.hands:
        for start, end, radius, _, _ in HAND_BARS:
            found.append(shadow_of(_placed(hand, np.array([start, end])), radius))
    if state.arm_m is not None:
        for k in range(len(state.arm_m) - 1):
            found.append(shadow_of(state.arm_m[k : k + 2], 0.012))
    return found


def _placed(hand: HandPose, points: Array) -> Array:
    c, s = math.cos(hand.heading_rad), math.sin(hand.heading_rad)
    turned = points[:, :2] @ np.array([[c, s], [-s, c]]) + hand.pos_m
    result: Array = np.column_stack([turned, points[:, 2]])
    return result


def _across(points_m: Array) -> Array:
    """Return the unit direction of the joints' axes: level, square to the arm's plane."""
    reach = points_m[-1, :2] - points_m[0, :2]
    length = float(np.linalg.norm(reach))
    if length < 1e-6:
        return np.array([0.0, 1.0, 0.0])
    return np.array([-reach[1] / length, reach[0] / length, 0.0])


def _paint_car(canvas: Canvas, centre: Array, half: float, yaw: float, vel: Array) -> None:
    """Add a windscreen and wheels to a block; both small, so that the body keeps its colour."""
    c, s = math.cos(yaw), math.sin(yaw)
    ahead, left = np.array([c, s, 0.0]), np.array([-s, c, 0.0])
    roof = centre + (0.0, 0.0, half)
    glass = [
        roof + half * (a * ahead + b * left)
        for a, b in ((0.3, 0.7), (0.3, -0.7), (0.55, -0.7), (0.55, 0.7))
    ]
    canvas.polygon(np.array(glass), _GLASS, vel, lift_m=0.001)
    for a in (-0.55, 0.55):
        for b in (-1.0, 1.0):
            hub = centre + half * (a * ahead + b * left) - (0.0, 0.0, 0.7 * half)
            axle = np.array([hub - 0.0015 * left, hub + 0.0015 * left])
            canvas.capsule(axle, (0.3 * half, 0.3 * half), _TYRE, vel)


def _paint_head(canvas: Canvas, centre: Array, half: float, vel: Array) -> None:
    """Put a head on a block: it becomes a child in a T-shirt of the block's colour."""
    head = centre + (0.0, 0.0, 1.38 * half)
    canvas.sphere(head, 0.48 * half, SURROUNDINGS["skin"], vel)
    canvas.sphere(head + (-0.12 * half, 0.0, 0.14 * half), 0.46 * half, _HAIR, vel)
