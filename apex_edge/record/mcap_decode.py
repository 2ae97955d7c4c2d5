"""The MCAP messages of a recording, put together to frames again."""

import json
import math
import struct
from typing import Any, Dict, NamedTuple, Optional, Tuple, Type

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError

from apex_edge.record import messages, topics
from apex_edge.types import ArmState, CameraModel, Frame, Proposal

DAMAGE: Tuple[Type[Exception], ...] = (
    McapError,
    DecodeError,
    struct.error,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    OverflowError,
    MemoryError,
    RecursionError,
)
"""What flipped bits make the libraries raise; each means that the file is damaged."""


class Recorded(NamedTuple):
    """One frame of a recording with what replay needs beside it."""

    frame: Frame
    arm: Optional[ArmState]
    proposal: Optional[Proposal]


class FrameDecoder:
    """Collect messages until a ``/frame`` message completes a frame."""

    def __init__(self) -> None:
        """Start with nothing collected and no camera known."""
        self._pending: Dict[str, bytes] = {}
        self._calibration: Optional[bytes] = None
        self._transform: Optional[bytes] = None
        self._camera: Optional[CameraModel] = None

    def add(self, topic: str, data: bytes) -> Optional[Recorded]:
        """Take one message; return the frame it completes, if it does.

        Raises
        ------
        one of DAMAGE : the message is not what its topic promises.
        """
        if topic == topics.CALIBRATION:
            self._calibration, self._camera = data, None
        elif topic == topics.TRANSFORM:
            self._transform, self._camera = data, None
        elif topic == topics.FRAME:
            pending, self._pending = self._pending, {}
            return self._frame(_object(data), pending)
        elif topic in (topics.COLOUR, topics.DEPTH, topics.ARM, topics.PROPOSAL):
            self._pending[topic] = data
        return None

    def _frame(self, about: Dict[str, Any], pending: Dict[str, bytes]) -> Recorded:
        t_s = float(about["t_s"])
        if not math.isfinite(t_s):
            raise ValueError(f"capture time {t_s} is not a number")
        colour = CompressedImage.FromString(pending[topics.COLOUR]).data
        depth = None
        if about["has_depth"]:
            data = CompressedImage.FromString(pending[topics.DEPTH]).data
            depth = topics.decode_picture(data, is_depth=True)
        frame = Frame(
            seq=int(about["seq"]),
            t_s=t_s,
            colour_bgr=topics.decode_picture(colour, is_depth=False),
            depth_mm=depth,
            camera=self._current_camera() if about["has_camera"] else None,
            is_repeated=bool(about["is_repeated"]),
        )
        arm = pending.get(topics.ARM)
        proposal = pending.get(topics.PROPOSAL)
        return Recorded(
            frame=frame,
            arm=None if arm is None else messages.arm_from(_object(arm)),
            proposal=None if proposal is None else messages.proposal_from(_object(proposal)),
        )

    def _current_camera(self) -> CameraModel:
        if self._camera is None:
            if self._calibration is None or self._transform is None:
                raise ValueError("a frame has a camera model, but none was recorded before it")
            self._camera = topics.camera_from(
                CameraCalibration.FromString(self._calibration),
                FrameTransform.FromString(self._transform),
            )
        return self._camera


def _object(data: bytes) -> Dict[str, Any]:
    value = json.loads(data.decode("utf-8"))
    if not isinstance(value, dict):
        raise ValueError(f"expected a JSON object, found {type(value).__name__}")
    return value
