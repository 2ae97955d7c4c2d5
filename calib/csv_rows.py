"""CSV files of measurements: one header line, then rows of cells; every fault names its row.

Source: ours.
"""

import csv
import io
from pathlib import Path
from typing import List, Sequence

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array

MAX_NUMBER = 1e12  # no time, length or brightness is larger, and its square is still a number


def read_numbers(path: Path, n_columns: int) -> Array:
    """Return the rows (n, c) of a CSV file of finite numbers below one header line.

    Raises
    ------
    CalibrationError : unreadable, no header line, or a cell that is not a finite number.
    """
    rows = [
        _numbers(path, index, cells) for index, cells in enumerate(read_cells(path, n_columns)[1:])
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, n_columns)


def read_cells(path: Path, n_columns: int) -> List[List[str]]:
    """Return the header of a CSV file and the rows below it, of ``n_columns`` stripped cells each.

    Raises
    ------
    CalibrationError : unreadable, no header line, or a row of another length.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: cannot read: {error}") from error
    try:
        table = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text))]
    except csv.Error as error:
        raise CalibrationError(f"{path}: not a CSV file: {error}") from error
    table = [row for row in table if any(row)]
    if not table:
        raise CalibrationError(f"{path}: the file is empty")
    if all(_is_number(cell) for cell in table[0]):
        raise CalibrationError(f"{path}: the first line must name the columns, found numbers")
    for index, row in enumerate(table[1:]):
        if len(row) != n_columns:
            raise CalibrationError(
                f"{path}: row {index + 1} has {len(row)} columns, expected {n_columns}"
            )
    return table


def _numbers(path: Path, index: int, cells: Sequence[str]) -> List[float]:
    for column, cell in enumerate(cells):
        # written so that NaN is refused
        if not _is_number(cell) or not abs(float(cell)) <= MAX_NUMBER:
            raise CalibrationError(
                f"{path}: row {index + 1}, column {column + 1}: {cell[:40]!r} is not a finite "
                f"number up to {MAX_NUMBER:g}"
            )
    return [float(cell) for cell in cells]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
