"""One frame, or one frame's outcome, as the MCAP messages of a recording."""

import json
from typing import Any, Dict, Mapping, Optional, Union

from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from apex_edge.record import messages, topics
from apex_edge.types import CameraModel, Candidates, Frame, Step

N_EDGES = 10
"""Most salient edges kept per frame."""


class FrameEncoder:
    """Write frames and steps as messages to an MCAP writer.

    What rarely changes (camera model, candidates, schemas) is written when it changes.

    Parameters
    ----------
    writer : started MCAP writer.
    picture_format : ``jpeg`` or ``png``.
    jpeg_quality : 1 to 100.
    """

    def __init__(self, writer: Writer, picture_format: str, jpeg_quality: int) -> None:
        """Remember that nothing was written yet."""
        self._writer = writer
        self._format, self._quality = picture_format, jpeg_quality
        self._camera: Optional[CameraModel] = None
        self._candidates: Optional[Candidates] = None
        self._channels: Dict[str, int] = {}

    def write(self, item: Union[Frame, Step]) -> None:
        """Write all messages of one frame; the ``/frame`` message comes last.

        Raises
        ------
        OSError : the disk refuses it.
        RecordingError : a picture cannot be encoded.
        """
        frame = item.frame if isinstance(item, Step) else item
        self._write_pictures(frame)
        if isinstance(item, Step):
            self._write_outcome(item)
        self._json(
            topics.FRAME,
            frame,
            {
                "is_repeated": frame.is_repeated,
                "has_depth": frame.depth_mm is not None,
                "has_camera": frame.camera is not None,
            },
        )

    def _write_pictures(self, frame: Frame) -> None:
        time_ns = topics.to_nanoseconds(frame.t_s)
        if frame.camera is not None and frame.camera is not self._camera:
            calibration, transform = topics.camera_messages(frame.camera, time_ns)
            self._protobuf(topics.CALIBRATION, frame, calibration)
            self._protobuf(topics.TRANSFORM, frame, transform)
            self._camera = frame.camera
        data = topics.encode_picture(frame.colour_bgr, self._format, self._quality)
        self._protobuf(topics.COLOUR, frame, topics.image_message(data, self._format, time_ns))
        if frame.depth_mm is not None:
            data = topics.encode_picture(frame.depth_mm, "png", 0)
            self._protobuf(topics.DEPTH, frame, topics.image_message(data, "png", time_ns))

    def _write_outcome(self, step: Step) -> None:
        frame = step.frame
        self._json("/tracks", frame, {"tracks": messages.tracks_message(step.tracks)})
        if step.hazards is not None:
            edges = messages.hazards_message(step.hazards, N_EDGES)
            self._json("/hazards", frame, {"edges": edges})
        if step.rollouts is not None:
            self._write_candidates(frame, step.rollouts.candidates)
            summary = messages.rollouts_message(step.rollouts)
            detail = messages.rollouts_detail(step.rollouts)
            self._json("/rollouts", frame, {**summary, **detail})
        if step.proposal is not None:
            latency = {"latency_s": step.proposal.latency_s}
            proposal = messages.proposal_message(step.proposal)
            self._json(topics.PROPOSAL, frame, {**proposal, **latency})
        self._json("/decision", frame, messages.decision_message(step.decision))
        if step.command is not None:
            self._json("/command", frame, messages.command_message(step.command))
        if step.ack is not None:
            sent = {"t_sent_s": step.ack.t_sent_s}
            self._json("/ack", frame, {**messages.ack_message(step.ack), **sent})
        if step.arm is not None:
            self._json(topics.ARM, frame, messages.arm_message(step.arm))

    def _write_candidates(self, frame: Frame, candidates: Candidates) -> None:
        if candidates is self._candidates:
            return
        points = messages.packed(candidates.tip_m, "<f4")
        self._json("/candidates", frame, {"version": candidates.version, "tip_m_f4_base64": points})
        self._candidates = candidates

    def _json(self, topic: str, frame: Frame, message: Mapping[str, Any]) -> None:
        if topic not in self._channels:
            name, schema = topics.json_schema(topic)
            schema_id = self._writer.register_schema(name, "jsonschema", schema)
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        stamped = {"seq": frame.seq, "t_s": frame.t_s, **message}
        self._add(topic, frame, json.dumps(messages.plain(stamped)).encode("utf-8"))

    def _protobuf(self, topic: str, frame: Frame, message: topics.Protobuf) -> None:
        if topic not in self._channels:
            schema_id = register_schema(self._writer, type(message))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema_id)
        self._add(topic, frame, message.SerializeToString())

    def _add(self, topic: str, frame: Frame, data: bytes) -> None:
        time_ns = topics.to_nanoseconds(frame.t_s)
        self._writer.add_message(
            self._channels[topic], time_ns, data, time_ns, sequence=max(0, frame.seq)
        )
