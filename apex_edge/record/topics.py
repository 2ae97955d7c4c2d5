"""What a recording holds: topics, their schemas, and the Foxglove messages for pictures.

Pictures and calibration are Foxglove protobuf, so Foxglove and Rerun show them; the rest is JSON.
The ``/frame`` message comes last of each frame's: a frame without it was cut off.
"""

import json
from typing import Any, Dict, Tuple, Union

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from apex_edge.errors import RecordingError
from apex_edge.geometry import camera_matrix
from apex_edge.pictures import decode
from apex_edge.types import Array, CameraModel

COLOUR = "/camera/colour"
DEPTH = "/camera/depth"
CALIBRATION = "/camera/calibration"
TRANSFORM = "/tf"
FRAME = "/frame"
ARM = "/arm"
PROPOSAL = "/proposal"

Protobuf = Union[CameraCalibration, CompressedImage, FrameTransform]

TABLE_FRAME, CAMERA_FRAME = "table", "camera"
FORMATS: Dict[str, str] = {"jpeg": ".jpg", "png": ".png"}

_NUMBER: Dict[str, Any] = {"type": ["number", "null"]}
_INTEGER: Dict[str, Any] = {"type": "integer"}
_TEXT: Dict[str, Any] = {"type": "string"}
_FLAG: Dict[str, Any] = {"type": "boolean"}
_LIST: Dict[str, Any] = {"type": ["array", "null"]}
_TIME: Dict[str, Any] = {"seq": _INTEGER, "t_s": _NUMBER}

SCHEMAS: Dict[str, Tuple[str, Dict[str, Any]]] = {
    FRAME: ("apex.Frame", {**_TIME, "is_repeated": _FLAG, "has_depth": _FLAG, "has_camera": _FLAG}),
    ARM: (
        "apex.ArmState",
        {**_TIME, "joints_rad": _LIST, "tip_m": _LIST, "is_moving": _FLAG, "source": _TEXT},
    ),
    PROPOSAL: (
        "apex.Proposal",
        {
            **_TIME,
            "source": _TEXT,
            "kind": _TEXT,
            "snapshot": _INTEGER,
            "index": _INTEGER,
            "latency_s": _NUMBER,
            "detail": _TEXT,
        },
    ),
    "/tracks": ("apex.Tracks", {**_TIME, "tracks": _LIST}),
    "/hazards": ("apex.Hazards", {**_TIME, "edges": _LIST}),
    "/candidates": ("apex.Candidates", {**_TIME, "version": _INTEGER, "tip_m_f4_base64": _TEXT}),
    "/rollouts": (
        "apex.Rollouts",
        {
            **_TIME,
            "mover": _INTEGER,
            "target": _INTEGER,
            "t_free_collision_s": _NUMBER,
            "candidates_version": _INTEGER,
            "n": _INTEGER,
            "n_safe": _INTEGER,
            "n_collision": _INTEGER,
            "n_blocked": _INTEGER,
            "best": _LIST,
            "best_tip_m": _LIST,
            "best_slack_s": _LIST,
            "score_f4_base64": _TEXT,
            "slack_s_f4_base64": _TEXT,
            "flags_u1_base64": _TEXT,
        },
    ),
    "/decision": (
        "apex.Decision",
        {
            **_TIME,
            "action": _TEXT,
            "source": _TEXT,
            "index": _INTEGER,
            "target_m": _LIST,
            "mover": _INTEGER,
            "target": _INTEGER,
            "deadline_s": _NUMBER,
            "ttc_s": _NUMBER,
            "verdict": _TEXT,
            "reason": _TEXT,
            "summary": _TEXT,
        },
    ),
    "/command": ("apex.ArmCommand", {**_TIME, "joints_rad": _LIST, "duration_s": _LIST}),
    "/ack": (
        "apex.ArmAck",
        {
            **_TIME,
            "t_sent_s": _NUMBER,
            "is_accepted": _FLAG,
            "joints_rad": _LIST,
            "duration_s": _LIST,
            "reason": _TEXT,
        },
    ),
}
"""Topic -> (schema name, its properties); every JSON topic there is."""


def json_schema(topic: str) -> Tuple[str, bytes]:
    """Return name and JSON Schema text of a JSON topic."""
    name, properties = SCHEMAS[topic]
    text = json.dumps({"title": name, "type": "object", "properties": properties}, sort_keys=True)
    return name, text.encode("utf-8")


def to_nanoseconds(t_s: float) -> int:
    """Return a capture time as MCAP's unsigned nanoseconds."""
    return max(0, int(round(t_s * 1e9)))


def encode_picture(picture: Array, kind: str, quality: int) -> bytes:
    """Compress a picture to ``jpeg`` at ``quality`` (1 to 100) or loss-free ``png``.

    Raises
    ------
    RecordingError : OpenCV cannot encode this array.
    """
    # level 1: 4 x the speed of the default for a few per cent more bytes
    options = (
        [cv2.IMWRITE_JPEG_QUALITY, quality] if kind == "jpeg" else [cv2.IMWRITE_PNG_COMPRESSION, 1]
    )
    try:
        is_done, data = cv2.imencode(FORMATS[kind], picture, options)
    except cv2.error as error:
        raise RecordingError(
            f"cannot encode a picture of shape {picture.shape}: {error}"
        ) from error
    if not is_done:
        raise RecordingError(f"cannot encode a picture of shape {picture.shape} as {kind}")
    return bytes(data.tobytes())


def decode_picture(data: bytes, is_depth: bool) -> Array:
    """Decode a compressed picture: (h, w, 3) uint8 BGR, or (h, w) uint16 depth.

    Raises
    ------
    ValueError : the bytes are not such a picture.
    """
    picture = decode(data, cv2.IMREAD_UNCHANGED if is_depth else cv2.IMREAD_COLOR)
    if picture is None:
        raise ValueError(f"{len(data)} picture bytes cannot be decoded")
    if is_depth and (picture.dtype != np.uint16 or picture.ndim != 2):
        raise ValueError(f"depth is {picture.dtype} {picture.shape}, expected 16-bit grey")
    return picture


def image_message(data: bytes, kind: str, nanoseconds: int) -> CompressedImage:
    """Wrap compressed bytes as foxglove.CompressedImage."""
    message = CompressedImage(frame_id=CAMERA_FRAME, data=data, format=kind)
    message.timestamp.FromNanoseconds(nanoseconds)
    return message


def camera_messages(
    camera: CameraModel, nanoseconds: int
) -> Tuple[CameraCalibration, FrameTransform]:
    """Return a camera model as foxglove.CameraCalibration and FrameTransform (table <- camera)."""
    matrix = camera_matrix(camera)
    calibration = CameraCalibration(
        frame_id=CAMERA_FRAME,
        width=camera.width_px,
        height=camera.height_px,
        distortion_model="plumb_bob",
        D=[float(value) for value in np.ravel(camera.dist)],
        K=matrix.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.column_stack([matrix, np.zeros(3)]).ravel().tolist(),
    )
    calibration.timestamp.FromNanoseconds(nanoseconds)
    x, y, z, w = _quaternion(camera.table_from_cam[:3, :3])
    transform = FrameTransform(parent_frame_id=TABLE_FRAME, child_frame_id=CAMERA_FRAME)
    transform.timestamp.FromNanoseconds(nanoseconds)
    at = camera.table_from_cam[:3, 3]
    transform.translation.x, transform.translation.y, transform.translation.z = map(float, at)
    rotation = transform.rotation
    rotation.x, rotation.y, rotation.z, rotation.w = x, y, z, w
    return calibration, transform


def camera_from(calibration: CameraCalibration, transform: FrameTransform) -> CameraModel:
    """Read a camera model back from its two messages.

    Raises
    ------
    ValueError : numbers are missing or not finite.
    """
    if len(calibration.K) != 9:
        raise ValueError(f"camera matrix has {len(calibration.K)} numbers, expected 9")
    at, turn = transform.translation, transform.rotation
    pose = np.eye(4)
    pose[:3, :3] = _rotation(turn.x, turn.y, turn.z, turn.w)
    pose[:3, 3] = (at.x, at.y, at.z)
    k = calibration.K
    model = CameraModel(
        width_px=int(calibration.width),
        height_px=int(calibration.height),
        fx_px=k[0],
        fy_px=k[4],
        cx_px=k[2],
        cy_px=k[5],
        dist=np.array(calibration.D, dtype=np.float64),
        table_from_cam=pose,
    )
    if not (np.isfinite(pose).all() and np.isfinite(model.dist).all() and np.isfinite(k).all()):
        raise ValueError("camera calibration holds numbers that are not finite")
    return model


def _quaternion(rotation: Array) -> Tuple[float, float, float, float]:
    """Return x, y, z, w of a rotation matrix: the eigenvector that fits it best (Bar-Itzhack)."""
    r = np.asarray(rotation, dtype=np.float64)
    fit = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0.0, 0.0, 0.0],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0.0, 0.0],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0.0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
        ]
    )
    _, vectors = np.linalg.eigh(fit)  # reads the lower triangle
    x, y, z, w = (float(value) for value in vectors[:, -1])
    return x, y, z, w


def _rotation(x: float, y: float, z: float, w: float) -> Array:
    norm = x * x + y * y + z * z + w * w
    if not norm > 1e-12:
        raise ValueError("camera pose has a zero quaternion")
    s = 2.0 / norm
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )
