"""Boards seen by known cameras, as corners (fast) or as pictures; shared by the lens tests."""

import argparse
import math
from dataclasses import replace

import cv2
import numpy as np

from apex_edge.geometry import camera_matrix, look_at
from apex_edge.types import CameraModel
from calib.boards import parse_board
from calib.detect import View
from calib.simulated import BoardRenderer, Look, default_lens, varied_poses

CHESS = parse_board("9x6", 0.025)
CHARUCO = parse_board("charuco:7x5", 0.025)
LENS = default_lens(640, 480)


def views(poses, noise_px=0.1, seed=0, board=CHESS, lens=LENS):
    """Return a view per pose (n, 4, 4), its corners exact but for Gaussian noise."""
    rng = np.random.RandomState(seed)
    points = board.corners_m()
    found = []
    for i, pose in enumerate(poses):
        turn, _ = cv2.Rodrigues(pose[:3, :3])
        pixels, _ = cv2.projectPoints(points, turn, pose[:3, 3], camera_matrix(lens), lens.dist)
        pixels = pixels.reshape(-1, 2) + rng.normal(0.0, noise_px, (len(points), 2))
        size_px = (lens.width_px, lens.height_px)
        found.append(View(f"v{i}.png", size_px, np.arange(len(points)), pixels, points))
    return found


def good_views(n=18, **given):
    return views(varied_poses(given.get("board", CHESS), LENS, n), **given)


def with_corners(view, corners):
    return replace(view, corners_px=corners)


def camera_at(eye_m, aim_m, lens=LENS):
    return CameraModel(**vars(lens), table_from_cam=look_at(np.array(eye_m), np.array(aim_m)))


def on_table(where, height_m):
    """Return table_from_board (4, 4) of a board that lies at a Placement."""
    cosine, sine = math.cos(where.angle_rad), math.sin(where.angle_rad)
    pose = np.eye(4)
    pose[:2, :2] = [[cosine, -sine], [sine, cosine]]
    pose[:3, 3] = where.x_m, where.y_m, height_m
    return pose


def photo(camera, board, where, height_m=0.003, seed=0):
    """Return a picture (h, w, 3) of a board lying on the table."""
    pose = np.linalg.inv(camera.table_from_cam) @ on_table(where, height_m)
    return BoardRenderer(board, camera).render(pose, Look(), np.random.RandomState(seed))


def parsed(verb, *words):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])
