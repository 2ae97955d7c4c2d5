"""A board as a known camera would see it: for tests, and to try a calibration with no hardware.

Every pixel's viewing ray is met with the board's plane, several times per pixel, so corners lie
where the lens model says to a few hundredths of a pixel. Source: ours.
"""

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import cv2
import numpy as np

from apex_edge.cameras.base import Camera, CameraConfig
from apex_edge.errors import CalibrationError, ConfigError
from apex_edge.geometry import camera_matrix
from apex_edge.types import Array, Frame, Intrinsics
from calib.boards import Board, black_boxes, parse_board
from calib.rigid import pose, turn_from_vector, vector_from_turn

CELL_PX = 96  # texture pixels per square
MARGIN = 1.0  # white paper around the squares, in squares
INK, PAPER, TABLE = 25.0, 225.0, 110.0
N_SUB = 3  # rays per pixel and axis
HOLD_FRAMES = 4
MOVE_FRAMES = 3


@dataclass(frozen=True)
class Look:
    """What spoils a picture: noise (grey levels), blur (px, sd) and brightness (1 = full)."""

    noise: float = 2.0
    blur_px: float = 0.5
    brightness: float = 1.0


class BoardRenderer:
    """Draws one board through one lens."""

    def __init__(self, board: Board, lens: Intrinsics) -> None:
        """Draw the texture and undistort every ray once."""
        self.board, self.lens = board, lens
        self._scale = CELL_PX / board.square_m
        self._texture = _texture(board, self._scale)
        self._rays = _rays(lens)

    def render(self, cam_from_board: Array, look: Look, rng: np.random.RandomState) -> Array:
        """Return the picture (h, w, 3) uint8 BGR of the board at a pose (4, 4)."""
        turn, shift = cam_from_board[:3, :3], cam_from_board[:3, 3]
        normal = turn[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = float(normal @ shift) / (self._rays @ normal)
        # behind the camera or level with the board: the table is seen
        depth = np.where(np.isfinite(depth) & (depth > 0.0), depth, 1e6)
        on_board = (depth[..., None] * self._rays - shift) @ turn[:, :2]
        margin = MARGIN * self.board.square_m
        u = (on_board[..., 0] + margin) * self._scale - 0.5
        v = (self.board.size_m[1] + margin - on_board[..., 1]) * self._scale - 0.5
        limit = 30000.0  # OpenCV's remap cannot look further
        fine = cv2.remap(
            self._texture,
            np.clip(u, -limit, limit).astype(np.float32),
            np.clip(v, -limit, limit).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=TABLE,
        )
        size = (self.lens.width_px, self.lens.height_px)
        grey = cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
        if look.blur_px > 0.0:
            grey = cv2.GaussianBlur(grey, (0, 0), look.blur_px)
        grey = look.brightness * grey + rng.normal(0.0, look.noise, grey.shape)
        result: Array = np.repeat(np.clip(grey, 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        return result


def board_pose(
    board: Board, centre_m: Array, tilt_x_deg: float, tilt_y_deg: float, spin_deg: float = 0.0
) -> Array:
    """Return cam_from_board (4, 4) of a board with its middle at ``centre_m`` (3,), camera frame.

    Without tilt the board faces the camera, upright; ``tilt_x_deg`` turns it about the picture's
    x axis, ``tilt_y_deg`` about y, ``spin_deg`` about the board's own normal.
    """
    facing = np.diag([1.0, -1.0, -1.0])  # the board's y is up and its z towards the camera
    turn = (
        turn_from_vector(np.radians([tilt_x_deg, 0.0, 0.0]))
        @ turn_from_vector(np.radians([0.0, tilt_y_deg, 0.0]))
        @ turn_from_vector(np.radians([0.0, 0.0, spin_deg]))
        @ facing
    )
    middle = 0.5 * np.array([*board.size_m, 0.0])
    return pose(turn, np.asarray(centre_m, dtype=np.float64) - turn @ middle)


def varied_poses(board: Board, lens: Intrinsics, n: int, tilt_deg: float = 35.0) -> Array:
    """Return n poses (n, 4, 4) that fill the picture: a good set to calibrate from.

    The middle walks over a 3 x 3 grid, near in the middle and farther out, and the tilt turns
    around. With ``tilt_deg`` of 0 the board always faces the camera.
    """
    poses = []
    reach = 0.62 * max(board.size_m)  # half a diagonal, about
    short = min(lens.width_px / lens.fx_px, lens.height_px / lens.fy_px)
    for i in range(n):
        row, column = (i // 3) % 3 - 1, i % 3 - 1
        depth = reach / (0.5 * short) * (1.0 + 0.45 * (row != 0 or column != 0) + 0.05 * (i % 4))
        x = 0.27 * column * depth * lens.width_px / lens.fx_px
        y = 0.25 * row * depth * lens.height_px / lens.fy_px
        phase = 2.0 * math.pi * i * 0.382  # the golden angle: no two alike
        tilts = tilt_deg * math.cos(phase), tilt_deg * math.sin(phase)
        poses.append(board_pose(board, np.array([x, y, depth]), tilts[0], tilts[1], 7.0 * (i % 5)))
    return np.array(poses)


def default_lens(width_px: int, height_px: int) -> Intrinsics:
    """Return a lens as cheap cameras have it: 60 degrees wide, some barrel distortion."""
    focal_px = 0.86 * width_px
    return Intrinsics(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px,
        fy_px=1.004 * focal_px,
        cx_px=0.508 * width_px,
        cy_px=0.489 * height_px,
        dist=np.array([-0.12, 0.05, 0.0008, -0.0005, 0.0]),
    )


class BoardCamera(Camera):
    """A simulated camera before which somebody waves a board, for as long as it is read.

    ``path`` names the board and its squares in mm, as ``charuco:7x5@25``; width, height and frame
    rate are those of the settings. Frames come as fast as they are read, with simulated times.
    """

    type = "board"

    def __init__(self, config: CameraConfig) -> None:
        """Read the board's name."""
        super().__init__()
        self._config = config
        text, _, side = (config.path or "charuco:7x5@25").partition("@")
        try:
            self.board = parse_board(text, 1e-3 * float(side))
        except (ValueError, CalibrationError) as error:
            raise ConfigError(
                f"camera.path = {config.path!r}: expected BOARD@MM such as charuco:7x5@25: {error}"
            ) from error
        self.lens = default_lens(config.width, config.height)
        self._renderer: Optional[BoardRenderer] = None
        self._rng = np.random.RandomState(0)
        self._seq = 0

    def open(self) -> None:
        """Draw the board."""
        self._renderer = BoardRenderer(self.board, self.lens)

    def read(self, timeout_s: float) -> Optional[Frame]:
        """Return the next frame."""
        if self._renderer is None:
            self.open()
        assert self._renderer is not None
        colour = self._renderer.render(self._pose(self._seq), Look(), self._rng)
        frame = Frame(seq=self._seq, t_s=self._seq / self._config.fps, colour_bgr=colour)
        self._seq += 1
        self._stats.grabbed += 1
        self._stats.delivered += 1
        return frame

    def close(self) -> None:
        """Forget the drawing."""
        self._renderer = None

    def _pose(self, seq: int) -> Array:
        """Return the pose of a frame: held for some frames, then on to the next."""
        index, step = divmod(seq, HOLD_FRAMES + MOVE_FRAMES)
        start, end = varied_poses(self.board, self.lens, index + 2)[-2:]
        share = max(0.0, (step - HOLD_FRAMES + 1) / (MOVE_FRAMES + 1.0))
        axis = vector_from_turn(end[:3, :3] @ start[:3, :3].T)
        turn = turn_from_vector(share * axis) @ start[:3, :3]
        return pose(turn, (1.0 - share) * start[:3, 3] + share * end[:3, 3])


def _texture(board: Board, scale: float) -> Array:
    """Return the paper (h, w) float32, top row first, ``scale`` pixels a metre."""
    margin = MARGIN * board.square_m
    width, height = board.size_m
    shape = (round((height + 2 * margin) * scale), round((width + 2 * margin) * scale))
    paper = np.full(shape, PAPER, np.float32)
    for left, bottom, box_w, box_h in black_boxes(board):
        x0, x1 = (round((value + margin) * scale) for value in (left, left + box_w))
        y1, y0 = (round((height + margin - value) * scale) for value in (bottom, bottom + box_h))
        paper[y0:y1, x0:x1] = INK
    return paper


def _rays(lens: Intrinsics) -> Array:
    """Return viewing rays (h * s, w * s, 3) in the camera's frame, s rays a pixel and axis."""
    size: Tuple[int, int] = (lens.width_px * N_SUB, lens.height_px * N_SUB)
    x, y = np.meshgrid(*((np.arange(n) + 0.5) / N_SUB - 0.5 for n in size))
    pixels = np.stack([x, y], axis=-1).reshape(-1, 1, 2)
    flat = cv2.undistortPoints(pixels, camera_matrix(lens), lens.dist).reshape(size[1], size[0], 2)
    result: Array = np.concatenate([flat, np.ones((size[1], size[0], 1))], axis=-1)
    return result
