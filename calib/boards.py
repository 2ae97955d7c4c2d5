"""Calibration boards: what is printed, and where its corners are.

The board's own frame is the one a person at the table would choose: origin at the outer bottom
left corner of the squares, x right along the bottom edge, y up, z out of the paper. Corner ids
run row by row from the top left inner corner, as OpenCV numbers them. Source: ours.
"""

import re
from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array

CHESSBOARD, CHARUCO = "chessboard", "charuco"
MARKER_SHARE = 0.7  # of a square; larger markers crowd the corners, smaller ones are missed
MAX_SQUARES = 40
FORMS = "9x6 (chessboard, inner corners) or charuco:7x5[:DICT_4X4_50] (ChArUco, squares)"
_FORM = re.compile(r"(?:(charuco|chessboard):)?(\d{1,3})x(\d{1,3})(?::(DICT_\w+))?", re.ASCII)


@dataclass(frozen=True)
class Board:
    """A flat board of ``squares_x`` by ``squares_y`` squares.

    ``marker_m`` and ``dictionary`` belong to a ChArUco board and are 0 and "" on a chessboard.
    """

    kind: str
    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = ""

    @property
    def name(self) -> str:
        """Return the text that ``parse_board`` reads."""
        if self.kind == CHESSBOARD:
            return f"{self.squares_x - 1}x{self.squares_y - 1}"
        return f"charuco:{self.squares_x}x{self.squares_y}:{self.dictionary}"

    @property
    def inner(self) -> Tuple[int, int]:
        """Return how many inner corners there are along x and y."""
        return self.squares_x - 1, self.squares_y - 1

    @property
    def size_m(self) -> Tuple[float, float]:
        """Return the width and height of all squares together."""
        return self.squares_x * self.square_m, self.squares_y * self.square_m

    @property
    def is_ambiguous(self) -> bool:
        """Say whether the board looks the same after half a turn, so that its origin is unknown.

        A chessboard does so when both counts of inner corners are even or both are odd.
        """
        return self.kind == CHESSBOARD and (self.squares_x - self.squares_y) % 2 == 0

    def corners_m(self) -> Array:
        """Return the inner corners (n, 3) in the board's frame, in order of id."""
        n_x, n_y = self.inner
        x, y = np.meshgrid(np.arange(1, n_x + 1), np.arange(n_y, 0, -1))
        flat: Array = np.column_stack([x.ravel(), y.ravel(), np.zeros(n_x * n_y)])
        return flat * self.square_m

    def is_black(self, column: int, row: int) -> bool:
        """Say whether a square is black; rows count from the top, as in the picture of the board.

        The origin's square is black on a chessboard, the top left one on a ChArUco board.
        """
        first = self.squares_y - 1 if self.kind == CHESSBOARD else 0
        return (column + row - first) % 2 == 0


def parse_board(text: str, square_m: float, marker_m: float = 0.0) -> Board:
    """Read a board as the command line names it.

    Parameters
    ----------
    text : ``9x6``, ``charuco:7x5`` or ``charuco:7x5:DICT_5X5_100``.
    square_m : side of a square.
    marker_m : side of a ChArUco marker; 0 means seven tenths of a square.

    Raises
    ------
    CalibrationError : not of that form, a size out of range, or an unknown dictionary.
    """
    form = _FORM.fullmatch(text.strip())
    if form is None:
        raise CalibrationError(f"board {text!r}: expected {FORMS}")
    kind, n_x, n_y = form.group(1) or CHESSBOARD, int(form.group(2)), int(form.group(3))
    if not 0.0005 <= square_m <= 1.0:
        raise CalibrationError(f"board {text!r}: a square of {1e3 * square_m:g} mm; 0.5 to 1000")
    low = 3
    if not (low <= n_x <= MAX_SQUARES and low <= n_y <= MAX_SQUARES):
        raise CalibrationError(f"board {text!r}: counts must be {low} to {MAX_SQUARES}")
    if kind == CHESSBOARD:
        if form.group(4) or marker_m:
            raise CalibrationError(f"board {text!r}: a chessboard has no markers")
        return Board(CHESSBOARD, n_x + 1, n_y + 1, square_m)
    marker_m = marker_m or MARKER_SHARE * square_m
    if not 0.3 * square_m <= marker_m <= 0.95 * square_m:
        raise CalibrationError(
            f"board {text!r}: a marker of {1e3 * marker_m:g} mm in a square of "
            f"{1e3 * square_m:g} mm; expected 30 to 95 % of it"
        )
    return Board(CHARUCO, n_x, n_y, square_m, marker_m, _dictionary(form.group(4), n_x * n_y // 2))


def require_origin(board: Board) -> None:
    """Refuse a board whose origin cannot be told.

    Raises
    ------
    CalibrationError : the board looks the same upside down.
    """
    if board.is_ambiguous:
        raise CalibrationError(
            f"board {board.name} looks the same after half a turn, so its origin is unknown; use "
            "a ChArUco board, or a chessboard with one even and one odd count (9x6)"
        )


def load_dictionary(name: str) -> "cv2.aruco.Dictionary":
    """Return OpenCV's marker dictionary of that name.

    Raises
    ------
    CalibrationError : OpenCV has no ChArUco, or no such dictionary.
    """
    aruco = getattr(cv2, "aruco", None)
    if aruco is None or not hasattr(aruco, "CharucoDetector"):
        raise CalibrationError(
            f"OpenCV {cv2.__version__} has no ChArUco detector; use a chessboard, or install "
            "4.7 or newer: pip install 'opencv-python-headless>=4.7,<5'"
        )
    if not hasattr(aruco, name):
        known = sorted(key for key in dir(aruco) if re.fullmatch(r"DICT_\dX\d_\d+", key))
        raise CalibrationError(f"no marker dictionary {name!r}; there are {', '.join(known)}")
    found: cv2.aruco.Dictionary = aruco.getPredefinedDictionary(getattr(aruco, name))
    return found


def _dictionary(name: str, n_markers: int) -> str:
    """Return the dictionary to use: the named one, else the smallest of 4x4 bits that suffices."""
    # the smaller dictionaries are the beginning of the larger ones
    name = name or next(f"DICT_4X4_{n}" for n in (50, 100, 250, 1000) if n >= n_markers)
    n_there = len(load_dictionary(name).bytesList)
    if n_there < n_markers:
        raise CalibrationError(f"{name} has {n_there} markers, the board needs {n_markers}")
    return name


def charuco_board(board: Board, is_legacy: bool = False) -> "cv2.aruco.CharucoBoard":
    """Return OpenCV's description of a ChArUco board.

    ``is_legacy`` is the pattern of OpenCV before 4.6, which differs for an even row count.
    """
    made = cv2.aruco.CharucoBoard(
        (board.squares_x, board.squares_y),
        board.square_m,
        board.marker_m,
        load_dictionary(board.dictionary),
    )
    if hasattr(made, "setLegacyPattern"):  # OpenCV 4.7.0 has not
        made.setLegacyPattern(is_legacy)
    return made


def markers(board: Board) -> Tuple[Array, Array]:
    """Return the black cells of all markers of a ChArUco board.

    Returns
    -------
    corner_m (n, 2): bottom left corner of each black cell; cell_m (): side of a cell.
    """
    source = load_dictionary(board.dictionary)
    n_cells = int(source.markerSize) + 2  # one black cell all around
    cell_m = board.marker_m / n_cells
    made = charuco_board(board)
    found = []
    for number, corners in zip(np.ravel(made.getIds()), made.getObjPoints()):
        picture = cv2.aruco.generateImageMarker(source, int(number), n_cells)
        rows, columns = np.nonzero(picture == 0)
        # OpenCV's y runs down from the top edge
        left, top = float(corners[0][0]), board.size_m[1] - float(corners[0][1])
        found.append(np.column_stack([left + columns * cell_m, top - (rows + 1) * cell_m]))
    return np.concatenate(found), np.asarray(cell_m)


def black_boxes(board: Board) -> Array:
    """Return all that is black as boxes (n, 4): left, bottom, width, height in metres."""
    side = board.square_m
    top = board.squares_y - 1
    boxes = [
        (column * side, (top - row) * side, side, side)
        for row in range(board.squares_y)
        for column in range(board.squares_x)
        if board.is_black(column, row)
    ]
    if board.kind == CHESSBOARD:
        return np.array(boxes)
    corner_m, cell_m = markers(board)
    cells = np.column_stack([corner_m, np.full((len(corner_m), 2), cell_m)])
    result: Array = np.concatenate([np.array(boxes), cells])
    return result
