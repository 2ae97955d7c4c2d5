"""Recordings in MCAP: all that a run saw and did, for ``apex replay`` and for Foxglove."""

import logging
import queue
import threading
from pathlib import Path
from typing import IO, Dict, Iterator, Mapping, Optional, Tuple, Union

from mcap.records import Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from apex_edge.errors import RecordingError
from apex_edge.record import topics
from apex_edge.record.mcap_decode import DAMAGE, FrameDecoder, Recorded
from apex_edge.record.mcap_encode import FrameEncoder
from apex_edge.record.whole import WholeFile
from apex_edge.types import Frame, Step

LOG = logging.getLogger(__name__)

METADATA_NAME = "apex_edge"
FORMAT_VERSION = "1"
MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 256 * 1024
"""Small, so that a power cut loses under a second of frames."""
RECORD_LIMIT_BYTES = 256 * 1024 * 1024
"""A damaged length field must not ask for all memory."""


class RecordingWriter(WholeFile):
    """Write a recording to ``path`` + ``.part``, renamed to ``path`` when closed.

    After a crash the ``.part`` file holds all but the last chunk and can be read with
    ``RecordingReader(path, is_partial_ok=True)``.

    Parameters
    ----------
    path : where to, usually ``*.mcap``.
    metadata : what to remember of the run (settings, versions, scene).
    picture_format : ``jpeg``, or ``png`` for loss-free colour.
    jpeg_quality : 1 to 100.
    is_threaded : encode and write in a thread, so that ``write`` never waits for the disk; frames
        that do not fit in the queue are counted in ``n_dropped``.
    queue_length : frames that may wait for the thread.

    Raises
    ------
    RecordingError : the file cannot be written (with a thread: reported by ``close``).
    """

    def __init__(
        self,
        path: Union[str, Path],
        metadata: Mapping[str, str],
        picture_format: str = "jpeg",
        jpeg_quality: int = 90,
        is_threaded: bool = False,
        queue_length: int = 32,
    ) -> None:
        """Open the file and start the thread, if any."""
        super().__init__(path)
        if picture_format not in topics.FORMATS:
            known = ", ".join(topics.FORMATS)
            raise RecordingError(f"picture format {picture_format!r} is not one of {known}")
        self.n_written = 0
        self.n_dropped = 0
        self._error: Optional[RecordingError] = None
        self._open_file(metadata)
        self._encoder = FrameEncoder(self._writer, picture_format, jpeg_quality)
        self._queue: Optional[queue.Queue[Union[Frame, Step, None]]] = None
        self._thread: Optional[threading.Thread] = None
        self._is_drained = False
        if is_threaded:
            self._queue = queue.Queue(queue_length)
            self._thread = threading.Thread(target=self._drain, name="recorder", daemon=True)
            self._thread.start()

    def write(self, step: Step) -> bool:
        """Record a frame and all it led to; False when it had to be dropped.

        Raises
        ------
        RecordingError : the disk refuses it (never with a thread).
        """
        return self._accept(step)

    def write_frame(self, frame: Frame) -> bool:
        """Record a frame alone; otherwise as ``write``."""
        return self._accept(frame)

    def close(self) -> None:
        """Write what is queued, complete the file and publish it under its name.

        Raises
        ------
        RecordingError : something could not be written; the ``.part`` file stays.
        """
        if self._file is None:
            return
        self._stop_thread()
        try:
            if self._error is None:
                self._writer.finish()
        except OSError as error:
            self._error = RecordingError(f"{self.part}: cannot write: {error}")
        self._close_file()
        if self._error is not None:
            raise self._error
        try:
            self.part.replace(self.path)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot write: {error}") from error

    def abandon(self) -> None:
        """Stop, leaving what was recorded so far in the ``.part`` file, complete and readable."""
        if self._file is None:
            return
        self._stop_thread()
        try:
            self._writer.finish()
        except OSError as error:
            LOG.warning("%s: cannot complete the recording: %s", self.part, error)
        self._close_file()

    def _open_file(self, metadata: Mapping[str, str]) -> None:
        try:
            self._file: Optional[IO[bytes]] = self.part.open("wb")
            # pictures are compressed already, and lz4 and zstd have no 32-bit ARM wheels
            self._writer = Writer(
                self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.NONE
            )
            self._writer.start(profile="apex_edge")
            described = {str(key): str(value) for key, value in metadata.items()}
            self._writer.add_metadata(METADATA_NAME, {**described, "format": FORMAT_VERSION})
            self._file.flush()
        except OSError as error:
            raise RecordingError(f"{self.part}: cannot write: {error}") from error

    def _close_file(self) -> None:
        handle, self._file = self._file, None
        try:
            if handle is not None:
                handle.close()
        except OSError as error:
            self._error = self._error or RecordingError(f"{self.part}: cannot write: {error}")

    def _accept(self, item: Union[Frame, Step]) -> bool:
        if self._file is None:
            raise RecordingError(f"{self.path}: the recording is closed")
        if self._queue is None:
            self._write_item(item)
            return True
        try:
            if self._error is None:
                self._queue.put_nowait(item)
                return True
        except queue.Full:
            pass
        self.n_dropped += 1
        return False

    def _stop_thread(self) -> None:
        thread, self._thread = self._thread, None
        if thread is None or self._queue is None:
            return
        while thread.is_alive():
            try:
                self._queue.put(None, timeout=0.1)
                thread.join()
            except queue.Full:
                continue
        if not self._is_drained and self._error is None:
            self._error = RecordingError(f"{self.part}: the recorder's thread died")

    def _drain(self) -> None:
        assert self._queue is not None
        while True:
            item = self._queue.get()
            if item is None:
                break
            if self._error is not None:
                self.n_dropped += 1
                continue
            try:
                self._write_item(item)
            except RecordingError as error:
                LOG.error("recording stopped: %s", error)
                self._error = error
        self._is_drained = True

    def _write_item(self, item: Union[Frame, Step]) -> None:
        assert self._file is not None
        try:
            self._encoder.write(item)
            self._file.flush()
        except OSError as error:
            raise RecordingError(f"{self.part}: cannot write: {error}") from error
        self.n_written += 1


class RecordingReader:
    """Read a recording frame by frame, in the order it was written; iterate as often as wanted.

    Parameters
    ----------
    path : an MCAP file written by ``RecordingWriter``.
    is_partial_ok : read what there is of a recording that was cut short (``is_truncated`` says
        so); without it such a file is refused before the first frame.

    Raises
    ------
    RecordingError : missing, not MCAP, not one of ours, or cut short (the message says how many
        frames could be read).
    """

    def __init__(self, path: Union[str, Path], is_partial_ok: bool = False) -> None:
        """Check both ends of the file and read its metadata."""
        self.path = Path(path)
        self.n_read = 0
        self._is_partial_ok = is_partial_ok
        self.is_truncated = self._check_ends()
        if self.is_truncated and not is_partial_ok:
            raise RecordingError(
                f"{self.path}: the recording was cut short; {self._count()} frames could be read"
            )
        self.metadata = self._read_metadata()

    def __iter__(self) -> Iterator[Recorded]:
        """Yield the frames with arm state and proposal.

        Raises
        ------
        RecordingError : damaged; the message says how many frames could be read.
        """
        self.n_read = 0
        decoder = FrameDecoder()
        for topic, data in self._messages():
            try:
                recorded = decoder.add(topic, data)
            except DAMAGE as error:
                raise self._damaged(error) from error
            if recorded is not None:
                self.n_read += 1
                yield recorded
        if self.n_read == 0:
            raise RecordingError(f"{self.path}: holds no complete frame")

    def _messages(self) -> Iterator[Tuple[str, bytes]]:
        topic_of: Dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel):
                topic_of[record.id] = record.topic
            elif isinstance(record, Message):
                yield topic_of.get(record.channel_id, ""), record.data

    def _records(self) -> Iterator[object]:
        """Yield MCAP records; whatever damage makes the library raise becomes one error."""
        try:
            with self.path.open("rb") as file:
                reader = StreamReader(
                    file, validate_crcs=True, record_size_limit=RECORD_LIMIT_BYTES
                )
                yield from reader.records
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot read: {error}") from error
        except DAMAGE as error:
            if not self.is_truncated:
                raise self._damaged(error) from error

    def _damaged(self, error: Exception) -> RecordingError:
        found = f"{type(error).__name__}: {error}".rstrip(": ")
        return RecordingError(
            f"{self.path}: damaged after {self.n_read} frames that could be read ({found})"
        )

    def _check_ends(self) -> bool:
        """Return whether the end is missing; raise when the start is."""
        try:
            with self.path.open("rb") as file:
                start = file.read(len(MAGIC))
                size = file.seek(0, 2)
                file.seek(max(0, size - len(MAGIC)))
                end = file.read()
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot read: {error}") from error
        if start != MAGIC:
            raise RecordingError(f"{self.path}: not an MCAP file (starts with {start!r})")
        return end != MAGIC or size == len(MAGIC)

    def _count(self) -> int:
        return sum(topic == topics.FRAME for topic, _ in self._messages())

    def _read_metadata(self) -> Dict[str, str]:
        for record in self._records():
            if isinstance(record, Metadata) and record.name == METADATA_NAME:
                return self._checked(dict(record.metadata))
            if isinstance(record, (Channel, Message)):
                break
        raise RecordingError(f"{self.path}: an MCAP file, but not a recording of apex_edge")

    def _checked(self, metadata: Dict[str, str]) -> Dict[str, str]:
        version = metadata.pop("format", "")
        if version != FORMAT_VERSION:
            raise RecordingError(
                f"{self.path}: recording format {version!r}, expected {FORMAT_VERSION!r}"
            )
        return metadata
