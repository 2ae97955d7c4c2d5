"""A recording of ours as a camera."""

from typing import Optional

from apex_edge.cameras.playback import Frames, PlaybackCamera
from apex_edge.record.mcap_decode import Recorded
from apex_edge.record.mcap_io import RecordingReader


class McapCamera(PlaybackCamera):
    """Play an MCAP recording at its recorded capture times.

    ``recorded`` is the last frame read with the arm state and the proposal recorded beside it.
    """

    type = "mcap"
    recorded: Optional[Recorded] = None

    def _start(self) -> Frames:
        self.recorded = None
        return self._play(RecordingReader(self._path))

    def _play(self, reader: RecordingReader) -> Frames:
        for recorded in reader:
            self.recorded = recorded
            yield recorded.frame
