"""Bytes -> picture, whatever the bytes are."""

from typing import Optional

import cv2
import numpy as np

from apex_edge.types import Array


def decode(data: bytes, flags: int = cv2.IMREAD_COLOR) -> Optional[Array]:
    """Return a compressed picture, or None where the bytes are none.

    OpenCV answers damage with None or, at an empty buffer or a size it finds absurd, with an error
    of its own. ``flags`` are those of ``cv2.imdecode``.
    """
    if not data:
        return None
    try:
        picture: Optional[Array] = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error:
        return None
    return picture
