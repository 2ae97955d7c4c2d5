"""Files that appear under their name only when they are complete."""

from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import IO, Optional, Type, TypeVar, Union

from apex_edge.errors import RecordingError

Self = TypeVar("Self", bound="WholeFile")


class WholeFile(ABC):
    """An output written beside its final name and renamed when closed; ours.

    Leaving a ``with`` block normally, or by Ctrl-C or a signal, completes the file; any other
    exception abandons it, so that nobody mistakes half a result for a whole one.
    """

    def __init__(self, path: Union[str, Path], part: Optional[Path] = None) -> None:
        """Choose the names: ``path`` in the end, ``part`` (``path`` + ``.part``) until then."""
        self.path = Path(path)
        self.part = part if part is not None else Path(f"{path}.part")

    @abstractmethod
    def close(self) -> None:
        """Complete the file under its final name; a second call does nothing.

        Raises
        ------
        RecordingError : the file could not be written.
        """

    @abstractmethod
    def abandon(self) -> None:
        """Stop writing without publishing anything under the final name."""

    def __enter__(self: Self) -> Self:
        """Return the open file."""
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """Complete the file, or abandon it after an exception."""
        if kind is None or issubclass(kind, (KeyboardInterrupt, SystemExit)):
            self.close()
        else:
            self.abandon()


class WholeText(WholeFile):
    """A UTF-8 text file with ``\\n`` line ends on every system, written line by line."""

    def __init__(self, path: Union[str, Path]) -> None:
        """Open ``path`` + ``.part`` for writing.

        Raises
        ------
        RecordingError : the folder is missing or not writable.
        """
        super().__init__(path)
        try:
            self._file: Optional[IO[str]] = self.part.open("w", encoding="utf-8", newline="\n")
        except OSError as error:
            raise RecordingError(f"{self.part}: cannot write: {error}") from error

    def write_text(self, text: str) -> None:
        """Append text.

        Raises
        ------
        RecordingError : the disk refuses it, or the file is already closed.
        """
        if self._file is None:
            raise RecordingError(f"{self.path}: already closed")
        try:
            self._file.write(text)
        except OSError as error:
            raise RecordingError(f"{self.part}: cannot write: {error}") from error

    def close(self) -> None:
        """Flush and publish under the final name."""
        if self._file is None:
            return
        handle, self._file = self._file, None
        try:
            handle.close()
            self.part.replace(self.path)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot write: {error}") from error

    def abandon(self) -> None:
        """Remove what was written so far."""
        if self._file is None:
            return
        self._file.close()
        self._file = None
        self.part.unlink()


def write_whole_text(path: Union[str, Path], text: str) -> None:
    """Write a text file in one go, or leave the old one untouched.

    Raises
    ------
    RecordingError : the file cannot be written.
    """
    with WholeText(path) as file:
        file.write_text(text)


def write_whole_bytes(path: Union[str, Path], data: bytes) -> None:
    """Write a binary file in one go, or leave the old one untouched.

    Raises
    ------
    RecordingError : the file cannot be written.
    """
    part = Path(f"{path}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot write: {error}") from error
