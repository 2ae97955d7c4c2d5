"""A board on a sheet of paper at true scale, as PDF or PNG.

The PDF is written by hand: a handful of boxes, lines and one standard font need no library, and
the pure-Python ones do not install on Python 3.7 and 32-bit ARM without compiled parts.
Millimetres from the sheet's bottom left corner, y up. Source: ours; PDF 1.4, PNG 1.2.
"""

import struct
import zlib
from dataclasses import dataclass
from typing import List, Tuple

import cv2
import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from calib.boards import CHARUCO, Board, black_boxes
from calib.files import encode_png

PAPERS_MM = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
SIDE_MM = 12.0  # beside the board: the y mark, and what a printer cannot reach
TOP_MM = 7.0
NOTE_MM = 27.0  # below the board: the x mark, two lines of text and the ruler
RULER_MM = 100.0
PX_PER_MM = 12  # 304.8 dpi, a whole number of pixels a metre, as PNG states it
POINT_MM = 25.4 / 72.0
TEXT_MM = 3.0


@dataclass(frozen=True)
class Sheet:
    """What to draw, in mm: ``boxes (n, 4)`` left, bottom, width, height; ``lines (m, 4)``.

    ``texts`` are x, y of the baseline's start, and the words.
    """

    size_mm: Tuple[float, float]
    boxes: Array
    lines: Array
    texts: Tuple[Tuple[float, float, str], ...]


def lay_out(board: Board, paper: str) -> Sheet:
    """Place a board on paper, upright or on its side, whichever fits.

    Raises
    ------
    CalibrationError : unknown paper, or the board does not fit (the message says what would).
    """
    if paper not in PAPERS_MM:
        raise CalibrationError(f"paper {paper!r}: there are {', '.join(PAPERS_MM)}")
    width, height = (1e3 * side for side in board.size_m)
    short, long = PAPERS_MM[paper]
    needs = width + 2 * SIDE_MM, height + TOP_MM + NOTE_MM
    fitting = [size for size in ((short, long), (long, short)) if _fits(needs, size)]
    if not fitting:
        room = max(_room(board, size) for size in ((short, long), (long, short)))
        raise CalibrationError(
            f"board {board.name} with squares of {1e3 * board.square_m:g} mm is {width:g} x "
            f"{height:g} mm and does not fit on {paper}; squares of up to {room:.1f} mm would"
        )
    size = fitting[0]
    left = 0.5 * (size[0] - width)
    bottom = NOTE_MM + 0.5 * (size[1] - TOP_MM - NOTE_MM - height)
    boxes = 1e3 * black_boxes(board) + np.array([left, bottom, 0.0, 0.0])
    marks, mark_texts = _origin_marks(left, bottom, width)
    ruler, ruler_texts = _ruler(SIDE_MM, 6.0)
    texts = (*mark_texts, *ruler_texts, *_notes(board))
    return Sheet(size, boxes, np.array([*marks, *ruler]), texts)


def _fits(needs: Tuple[float, float], size: Tuple[float, float]) -> bool:
    return needs[0] <= size[0] + 1e-9 and needs[1] <= size[1] + 1e-9


def _room(board: Board, size: Tuple[float, float]) -> float:
    """Return the largest square (mm) that this sheet can hold."""
    across = (size[0] - 2 * SIDE_MM) / board.squares_x
    return min(across, (size[1] - TOP_MM - NOTE_MM) / board.squares_y)


Line = Tuple[float, float, float, float]
Text = Tuple[float, float, str]


def _origin_marks(left: float, bottom: float, width: float) -> Tuple[List[Line], List[Text]]:
    """Return crop marks at the board's origin and arrows along its x and y axes."""
    off, tip = 5.0, 22.0
    lines = [
        (left, bottom - 2.0, left, bottom - 8.0),
        (left - 2.0, bottom, left - 8.0, bottom),
        (left, bottom - off, left + tip, bottom - off),
        (left + tip, bottom - off, left + tip - 2.5, bottom - off + 1.2),
        (left + tip, bottom - off, left + tip - 2.5, bottom - off - 1.2),
        (left - off, bottom, left - off, bottom + tip),
        (left - off, bottom + tip, left - off + 1.2, bottom + tip - 2.5),
        (left - off, bottom + tip, left - off - 1.2, bottom + tip - 2.5),
    ]
    texts = [
        (left + tip + 1.5, bottom - off - 1.0, "x"),
        (left - off - 0.8, bottom + tip + 1.5, "y"),
        (left + 30.0, bottom - off - 1.0, "x/y origin: the corner between the two crop marks"),
    ]
    return lines, texts if width >= 60.0 else texts[:2]


def _ruler(x: float, y: float) -> Tuple[List[Line], List[Text]]:
    lines = [(x, y, x + RULER_MM, y)]
    lines += [(x + t, y, x + t, y + (4.0 if t % 50 == 0 else 2.5)) for t in range(0, 101, 10)]
    return lines, [(x + RULER_MM + 3.0, y, "this line must measure exactly 100 mm")]


def _notes(board: Board) -> Tuple[Text, ...]:
    marker = f", markers {1e3 * board.marker_m:g} mm" if board.kind == CHARUCO else ""
    line = f"apex calibrate --board {board.name} --square-mm {1e3 * board.square_m:g}"
    if board.kind == CHARUCO:
        line += f" --marker-mm {1e3 * board.marker_m:g}"
    about = f"{board.squares_x} x {board.squares_y} squares of {1e3 * board.square_m:g} mm{marker}"
    if board.is_ambiguous:
        about += "; looks the same upside down: lens only, not for the table"
    return (SIDE_MM, 15.5, line), (
        SIDE_MM,
        11.5,
        about + "; print at 100 %, glue onto a flat plate",
    )


def to_pdf(sheet: Sheet) -> bytes:
    """Return a one-page PDF; a unit of its content stream is one millimetre."""
    # one path for all that is black: boxes that touch are filled without hairlines in between
    ops = [f"{1.0 / POINT_MM:.8f} 0 0 {1.0 / POINT_MM:.8f} 0 0 cm", "0 g 0 G 0.2 w"]
    ops += [" ".join(f"{value:.4f}" for value in box) + " re" for box in sheet.boxes]
    ops.append("f")
    ops += ["{:.4f} {:.4f} m {:.4f} {:.4f} l".format(*line) for line in sheet.lines]
    ops.append("S")
    for x, y, words in sheet.texts:
        safe = words.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        ops.append(f"BT /F1 {TEXT_MM:g} Tf {x:.4f} {y:.4f} Td ({safe}) Tj ET")
    stream = "\n".join(ops).encode("latin-1")
    box = " ".join(f"{side / POINT_MM:.4f}" for side in sheet.size_mm)
    bodies = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode("ascii"),
        f"<< /Length {len(stream)} >>\nstream\n".encode("ascii") + stream + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    return _pdf_file(bodies)


def _pdf_file(bodies: List[bytes]) -> bytes:
    """Return objects 1, 2, ... with the header and the table of their offsets."""
    data = b"%PDF-1.4\n"
    offsets = []
    for number, body in enumerate(bodies, start=1):
        offsets.append(len(data))
        data += f"{number} 0 obj\n".encode("ascii") + body + b"\nendobj\n"
    table = f"xref\n0 {len(bodies) + 1}\n0000000000 65535 f \n"
    table += "".join(f"{offset:010d} 00000 n \n" for offset in offsets)
    end = f"trailer\n<< /Size {len(bodies) + 1} /Root 1 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    return data + (table + end).encode("ascii")


def to_picture(sheet: Sheet) -> Array:
    """Return the sheet (h, w) uint8 at ``PX_PER_MM`` pixels a millimetre."""
    width, height = (round(side * PX_PER_MM) for side in sheet.size_mm)
    picture = np.full((height, width), 255, np.uint8)
    for left, bottom, box_w, box_h in sheet.boxes:
        x0, x1 = (round(value * PX_PER_MM) for value in (left, left + box_w))
        y1, y0 = (height - round(value * PX_PER_MM) for value in (bottom, bottom + box_h))
        picture[y0:y1, x0:x1] = 0
    for line in sheet.lines:
        ends = [(round(x * PX_PER_MM), height - round(y * PX_PER_MM)) for x, y in _pairs(line)]
        cv2.line(picture, ends[0], ends[1], 0, 3, cv2.LINE_AA)
    for x, y, words in sheet.texts:
        place = (round(x * PX_PER_MM), height - round(y * PX_PER_MM))
        scale = TEXT_MM * PX_PER_MM / 32.0  # Hershey's letters are about 22 px high at scale 1
        cv2.putText(picture, words, place, cv2.FONT_HERSHEY_SIMPLEX, scale, 0, 2, cv2.LINE_AA)
    return picture


def _pairs(line: Array) -> List[Tuple[float, float]]:
    return [(float(line[0]), float(line[1])), (float(line[2]), float(line[3]))]


def to_png(sheet: Sheet) -> bytes:
    """Return the sheet as PNG that states its scale (pHYs), so that it prints at true size."""
    data = encode_png(to_picture(sheet))
    per_m = PX_PER_MM * 1000
    body = b"pHYs" + struct.pack(">IIB", per_m, per_m, 1)
    chunk = struct.pack(">I", 9) + body + struct.pack(">I", zlib.crc32(body) & 0xFFFFFFFF)
    header_end = 8 + 4 + 4 + 13 + 4  # signature and the IHDR chunk, which must come first
    return data[:header_end] + chunk + data[header_end:]
