"""Colours of the twin: what is painted on the objects, and what must not be confused with them.

Shading is multiplicative (a factor of about 0.55 on a side away from the light to 1.1 on a side
towards it), so a surface keeps its chromaticity and changes in brightness only.
"""

from typing import Dict, Tuple

Bgr = Tuple[float, float, float]

PALETTE: Dict[str, Bgr] = {
    "red": (44.0, 36.0, 204.0),
    "green": (74.0, 164.0, 46.0),
    "blue": (196.0, 92.0, 34.0),
    "yellow": (36.0, 204.0, 234.0),
    "orange": (18.0, 124.0, 238.0),
    "purple": (164.0, 54.0, 124.0),
}
"""Name -> mean BGR of the lit surface at exposure gain 1."""

SURROUNDINGS: Dict[str, Bgr] = {
    "table": (178.0, 184.0, 187.0),
    "wall": (150.0, 158.0, 164.0),
    "floor": (92.0, 96.0, 98.0),
    "skin": (132.0, 164.0, 214.0),
    "sleeve": (96.0, 84.0, 78.0),
    "arm": (66.0, 62.0, 60.0),
    "gripper": (122.0, 118.0, 115.0),
}
"""Mean BGR of everything that is not an object; none of it is an object colour."""
