"""The folder a run leaves behind: decisions, tracks, annotated video, recording and pictures."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import List, Mapping, Optional, Type, Union

import cv2

from apex_edge.errors import RecordingError
from apex_edge.record.decision_log import DecisionLog
from apex_edge.record.mcap_io import RecordingWriter
from apex_edge.record.report import write_report
from apex_edge.record.story import SceneStory
from apex_edge.record.summary import RunSummary, SceneNotes, SceneResult
from apex_edge.record.tracks_csv import TracksCsv
from apex_edge.record.video import AnnotatedVideo
from apex_edge.types import Array, Step

MAX_UNDRAWN = 600
"""A picture of 640x480 takes 0.9 MB until it is drawn."""


class RunOutputs:
    """Write all that a run leaves into one folder; a context manager.

    Each file appears only when the run ended well; after an error nothing half written is left
    (a recording stays as ``.part``, readable up to the last chunk). ``notes`` is what a report
    needs, once the context was left.

    Parameters
    ----------
    folder : made when missing.
    fps : of the annotated video.
    metadata : remembered in the recording; None means no recording.
    video_suffix : ``.mp4`` (fast, small) or ``.webm`` (plays in browsers).
    draws_later : draw only when the context is left. Drawing and encoding cost 20 ms a frame, which
        a run in real time has no time for.

    Raises
    ------
    RecordingError : the folder or a file in it cannot be written.
    """

    def __init__(
        self,
        folder: Union[str, Path],
        fps: float,
        metadata: Optional[Mapping[str, str]] = None,
        video_suffix: str = ".mp4",
        draws_later: bool = False,
    ) -> None:
        self.folder = Path(folder)
        self.notes: Optional[SceneNotes] = None
        self._metadata = metadata
        self._stack = ExitStack()
        self._story = SceneStory()
        self._log: Optional[DecisionLog] = None
        self._tracks: Optional[TracksCsv] = None
        self._recording: Optional[RecordingWriter] = None
        self._draws_later = draws_later
        self._undrawn: List[Step] = []
        self._is_new = not self.folder.exists()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"{self.folder}: cannot make the folder: {error}") from error
        self.video = AnnotatedVideo(self.folder / f"annotated{video_suffix}", fps)

    def __enter__(self) -> "RunOutputs":
        """Open the files that do not depend on the first frame."""
        self._log = self._stack.enter_context(DecisionLog(self.folder / "decisions.jsonl"))
        self._stack.enter_context(self.video)
        if self._metadata is not None:
            place = self.folder / "recording.mcap"
            self._recording = self._stack.enter_context(RecordingWriter(place, self._metadata))
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """Complete or abandon every file, then draw the pictures of a run that ended well."""
        if kind is None:
            for step in self._undrawn:
                self._draw(step)
        self._stack.__exit__(kind, error, trace)
        if kind is not None and self._is_new and not any(self.folder.iterdir()):
            self.folder.rmdir()
        if kind is None:
            self.notes = self._story.notes()
            self._save("montage.png", self.notes.montage)
            self._save("safe_points.png", self.notes.safe_points)

    def write(self, step: Step) -> None:
        """Write one step; without its picture only the logs get it.

        Raises
        ------
        RecordingError : the disk refuses it.
        """
        assert self._log is not None
        if self._tracks is None:
            is_calibrated = step.frame.camera is not None
            tracks = TracksCsv(self.folder / "tracks.csv", is_calibrated)
            self._tracks = self._stack.enter_context(tracks)
        self._log.write(step)
        self._tracks.write(step)
        if self._recording is not None and step.frame.colour_bgr.size:
            self._recording.write(step)
        if not self._draws_later:
            self._draw(step)
        elif len(self._undrawn) < MAX_UNDRAWN:
            self._undrawn.append(replace(step, frame=replace(step.frame, depth_mm=None)))

    def report(self, title: str) -> None:
        """Write report.html about a run that was not judged; after the context was left.

        Raises
        ------
        RecordingError : the file cannot be written.
        """
        assert self.notes is not None
        is_video = self.video.path.suffix == ".webm"
        scene = SceneResult("run", self.notes, video=self.video.path if is_video else None)
        write_report(self.folder / "report.html", RunSummary(title, (scene,), is_judged=False))

    def _draw(self, step: Step) -> None:
        self._story.write(step)
        if step.frame.colour_bgr.size:
            self.video.write(step)

    def _save(self, name: str, picture: Optional[Array]) -> None:
        if picture is not None and not cv2.imwrite(str(self.folder / name), picture):
            raise RecordingError(f"{self.folder / name}: cannot write the picture")
