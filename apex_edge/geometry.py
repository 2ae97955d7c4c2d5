"""Pinhole geometry: table point <-> pixel, in one place for all who need it."""

from typing import Tuple

import cv2
import numpy as np

from apex_edge.types import Array, CameraModel, Intrinsics


def camera_matrix(camera: Intrinsics) -> Array:
    """Return the (3, 3) intrinsic matrix."""
    return np.array(
        [[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]]
    )


def is_rigid(pose: Array) -> bool:
    """Say whether a matrix is a rotation and a translation (4, 4), all finite."""
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        return False
    turn = pose[:3, :3]
    is_turn = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
    return bool(is_turn and np.allclose(pose[3], [0.0, 0.0, 0.0, 1.0], atol=1e-12))


def look_at(eye_m: Array, aim_m: Array) -> Array:
    """Return table_from_cam (4, 4) of a camera at ``eye_m`` looking at ``aim_m``, picture upright.

    Raises
    ------
    ValueError : eye and aim coincide or the view is straight along z.
    """
    forward = np.asarray(aim_m, dtype=np.float64) - np.asarray(eye_m, dtype=np.float64)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-9:
        raise ValueError("the view direction is vertical or zero; tilt the camera a little")
    forward = forward / np.linalg.norm(forward)
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = right, np.cross(forward, right), forward
    pose[:3, 3] = eye_m
    return pose


def project(camera: CameraModel, points_m: Array) -> Tuple[Array, Array]:
    """Project table points (n, 3) to pixels.

    Returns
    -------
    pixels (n, 2) with lens distortion applied, depth (n,) along the optical axis in metres
    (a point behind the camera has depth <= 0 and a pixel of NaN).
    """
    points = np.atleast_2d(np.asarray(points_m, dtype=np.float64))
    rotation, eye = camera.table_from_cam[:3, :3], camera.table_from_cam[:3, 3]
    cam = (points - eye) @ rotation
    depth = cam[:, 2].copy()
    pixels = np.full((len(points), 2), np.nan)
    front = depth > 1e-6
    if front.any():
        found, _ = cv2.projectPoints(
            cam[front].reshape(-1, 1, 3),
            np.zeros(3),
            np.zeros(3),
            camera_matrix(camera),
            camera.dist,
        )
        pixels[front] = found.reshape(-1, 2)
    return pixels, depth


def rays(camera: CameraModel, pixels: Array) -> Array:
    """Return viewing rays (n, 3) in the table frame for pixels (n, 2), scaled to unit depth.

    ``eye + depth * ray`` is the point at that depth along the optical axis.
    """
    points = np.atleast_2d(np.asarray(pixels, dtype=np.float64)).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(points, camera_matrix(camera), camera.dist).reshape(-1, 2)
    cam = np.column_stack([flat, np.ones(len(flat))])
    result: Array = cam @ camera.table_from_cam[:3, :3].T
    return result


def on_plane(camera: CameraModel, pixels: Array, height_m: Array) -> Array:
    """Intersect the viewing rays of pixels (n, 2) with the planes z = ``height_m`` (n,) or scalar.

    Returns
    -------
    points (n, 3); NaN where the ray is level with or runs away from the plane.
    """
    direction = rays(camera, pixels)
    eye = camera.table_from_cam[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (np.asarray(height_m, dtype=np.float64) - eye[2]) / direction[:, 2]
    depth = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan)
    result: Array = eye + depth[:, None] * direction
    return result
