"""Colour of a pixel -> number of an object colour, through one 64 Ki table.

The table is indexed by OpenCV's 16-bit BGR565 word, so the cost does not depend on how many
colours there are nor on the shape of their regions. Label 0 is background, label ``i + 1`` is
``names[i]``.
"""

from functools import lru_cache
from pathlib import Path
from typing import Iterable, List, Sequence, Union

import numpy as np

from apex_edge.errors import ColourError
from apex_edge.perception import colour_file
from apex_edge.perception.colour_model import features, model_from
from apex_edge.perception.lookup import look_up, words
from apex_edge.perception.regions import Region, coverage_table, label_table
from apex_edge.twin.palette import PALETTE
from apex_edge.types import Array


class ColourTable:
    """Classify every pixel of a picture by one look-up."""

    def __init__(self, models: Sequence[Region]) -> None:
        """Build the table; where two colours claim a word the likelier one gets it.

        Raises
        ------
        ColourError : no colour, more than 255, or a name given twice.
        """
        self.models = tuple(models)
        self.names = tuple(model.name for model in self.models)
        if not 1 <= len(self.models) <= 255:
            raise ColourError(f"a colour table holds 1 to 255 colours, found {len(self.models)}")
        for name in self.names:
            if self.names.count(name) > 1:
                raise ColourError(f"colour {name!r} is defined twice")
        self._table = label_table(self.models)
        self._coverage = tuple(coverage_table(model) for model in self.models)

    @classmethod
    def load(cls, path: Union[str, Path], *more: Union[str, Path]) -> "ColourTable":
        """Read one or several colour files written by ``apex calibrate colour``.

        Raises
        ------
        ColourError : unreadable, wrong format, version, hash or range, or a name in two files.
        """
        return cls.merge([cls._load_one(Path(p)) for p in (path, *more)])

    @classmethod
    def _load_one(cls, path: Path) -> "ColourTable":
        try:
            return cls(colour_file.read(path))
        except ColourError as error:
            raise ColourError(f"{path}: {error}") from error

    @classmethod
    def merge(cls, tables: Iterable["ColourTable"]) -> "ColourTable":
        """Join the colours of several tables.

        Raises
        ------
        ColourError : a name occurs in two tables.
        """
        models: List[Region] = [model for table in tables for model in table.models]
        return cls(models)

    @classmethod
    def builtin(cls) -> "ColourTable":
        """Return the colours of the twin's objects."""
        return _builtin()

    def classify(self, bgr: Array) -> Array:
        """Return labels (h, w) uint8 of a picture (h, w, 3) uint8; 0 is background."""
        return self.labels(words(bgr))

    def labels(self, word: Array) -> Array:
        """Return the label, uint8, of each BGR565 word (h, w)."""
        return look_up(self._table, word)

    def coverage(self, word: Array, label: int) -> Array:
        """Return how much of each pixel is of colour ``label``, uint8 (h, w), 255 = all of it."""
        return look_up(self._coverage[label - 1], word)


@lru_cache(maxsize=1)
def _builtin() -> ColourTable:
    models = []
    for name, bgr in PALETTE.items():
        shades = np.outer(np.linspace(0.5, 1.2, 15), np.asarray(bgr))
        models.append(model_from(name, features(np.minimum(shades, 255.0))))
    return ColourTable(models)
