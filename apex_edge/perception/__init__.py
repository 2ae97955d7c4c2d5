"""Perception: coloured objects found, placed on the table and followed over time."""

from apex_edge.perception.colour import ColourTable
from apex_edge.perception.settings import PerceptionConfig
from apex_edge.perception.stage import Perception

__all__ = ["ColourTable", "Perception", "PerceptionConfig"]
