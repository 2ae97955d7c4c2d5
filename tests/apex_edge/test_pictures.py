import struct
import zlib

import cv2
import numpy as np
import pytest

from apex_edge.pictures import decode

PICTURE = np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)


def png(picture):
    return cv2.imencode(".png", picture)[1].tobytes()


def with_width(data, width):
    """Return a PNG that claims another width, with the checksum it then has to have."""
    head = data[12:16] + struct.pack(">I", width) + data[20:29]
    return data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]


def test_a_sound_picture_comes_back_exactly():
    assert np.array_equal(decode(png(PICTURE)), PICTURE)


def test_depth_keeps_its_sixteen_bits():
    depth = np.array([[0, 650], [65535, 1]], dtype=np.uint16)
    assert np.array_equal(decode(png(depth), cv2.IMREAD_UNCHANGED), depth)


@pytest.mark.parametrize(
    "data",
    [b"", b"\0", b"not a picture", png(PICTURE)[:20], with_width(png(PICTURE), 2**30)],
    ids=["empty", "zero", "text", "cut", "a size OpenCV raises at"],
)
def test_bytes_that_are_no_picture_give_none(data):
    assert decode(data) is None
