"""The truth of a labelled clip: ``truth.json``, checked key by key. See docs/labelled-clips.md."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, List, Mapping, Optional, Tuple, TypeVar

from apex_edge.errors import InputError

FILE = "truth.json"
MAX_FRAME = 10_000_000
MAX_PX = 1e5
T = TypeVar("T")


@dataclass(frozen=True)
class Centre:
    """One labelled centre; ``identity`` tells objects of one name apart ("" where not labelled)."""

    frame: int
    name: str
    identity: str
    x_px: float
    y_px: float
    area_px2: float
    tolerance_px: float


@dataclass(frozen=True)
class StraightRun:
    """Frames ``first``..``last`` in which an object moves at one velocity."""

    name: str
    identity: str
    first: int
    last: int
    vx_px_s: float
    vy_px_s: float
    tolerance_px_s: float


@dataclass(frozen=True)
class ClipTruth:
    """All that is labelled in one clip; ``absent`` holds (frame, names) without these objects."""

    folder: Path
    video: Path
    size_px: Tuple[int, int]
    fps: float
    centres: Tuple[Centre, ...]
    absent: Tuple[Tuple[int, Tuple[str, ...]], ...]
    straight_runs: Tuple[StraightRun, ...]
    bounce_frames: Tuple[int, ...]
    teach: Tuple[int, ...]

    @property
    def names(self) -> Tuple[str, ...]:
        """Return the object names, in the order of their first mention."""
        return tuple(dict.fromkeys(centre.name for centre in self.centres))

    @property
    def last_frame(self) -> int:
        """Return the last frame that anything is said about."""
        frames = [centre.frame for centre in self.centres] + [frame for frame, _ in self.absent]
        return max(frames + [run.last for run in self.straight_runs] + list(self.teach) + [0])


def find_clips(folder: Path) -> List[Path]:
    """Return the truth files of all clips in a folder, itself one or holding one folder each.

    Raises
    ------
    InputError : there is none.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    if (folder / FILE).is_file():
        return [folder / FILE]
    found = sorted(folder.glob(f"*/{FILE}"))
    if not found:
        raise InputError(
            f"{folder}: holds no labelled clip; expected one folder per clip with a {FILE}"
        )
    return found


def load(path: Path) -> ClipTruth:
    """Read and check one truth file.

    Raises
    ------
    InputError : unreadable, not JSON, or a key that is missing or not usable; names file and key.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not isinstance(document, dict):
        raise InputError(f"{path}: expected an object with the keys of a labelled clip")
    return _clip(_Reader(path, "", document), path.parent)


class _Reader:
    """Reads checked values of one JSON object and names what is wrong."""

    def __init__(self, path: Path, where: str, values: Mapping[str, Any]) -> None:
        self._path = path
        self._where = where
        self._values = values

    def has(self, key: str) -> bool:
        return self._values.get(key) is not None

    def fault(self, key: str, expected: str) -> InputError:
        found = repr(self._values[key])[:60] if key in self._values else "nothing"
        return InputError(f"{self._path}: {self._where}{key}: expected {expected}, found {found}")

    def number(self, key: str, low: float, high: float, default: Optional[float] = None) -> float:
        value = self._values.get(key, default)
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value) or not low <= value <= high:
            raise self.fault(key, f"a number in [{low:g}, {high:g}]")
        return float(value)

    def whole(self, key: str, low: int, high: int) -> int:
        value = self._values.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.fault(key, f"a whole number in [{low}, {high}]")
        return value

    def text(self, key: str, default: Optional[str] = None) -> str:
        value = self._values.get(key, default)
        if not isinstance(value, str) or (default is None and not value.strip()):
            raise self.fault(key, "a text")
        return value

    def texts(self, key: str) -> Tuple[str, ...]:
        value = self._values.get(key)
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.fault(key, "a list of names")
        return tuple(value)

    def frames(self, key: str) -> Tuple[int, ...]:
        value = self._values.get(key, [])
        if not isinstance(value, list) or not all(_is_frame(v) for v in value):
            raise self.fault(key, "a list of frame numbers, 0-based")
        return tuple(value)

    def each(self, key: str, read: Callable[["_Reader"], T]) -> Tuple[T, ...]:
        value = self._values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self.fault(key, "a list of objects")
        return tuple(read(_Reader(self._path, f"{key}[{i}].", v)) for i, v in enumerate(value))


def _is_frame(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MAX_FRAME


def _clip(reader: _Reader, folder: Path) -> ClipTruth:
    size = reader.frames("size_px")
    if len(size) != 2 or min(size) < 1:
        raise reader.fault("size_px", "[width, height]")
    video = Path(reader.text("video"))
    if video.is_absolute() or ".." in video.parts:
        raise reader.fault("video", "a file or folder beside the truth file")
    tolerance = reader.number("tolerance_px", 0.0, MAX_PX)
    fps = reader.number("nominal_fps", 0.1, 1000.0)
    truth = ClipTruth(
        folder=folder,
        video=folder / video,
        size_px=(size[0], size[1]),
        fps=fps,
        centres=reader.each("centres", lambda part: _centre(part, tolerance)),
        absent=reader.each("absent", _absence),
        straight_runs=reader.each("straight_runs", _straight_run),
        bounce_frames=reader.frames("bounce_frames"),
        teach=reader.frames("teach"),
    )
    if not truth.centres:
        raise reader.fault("centres", "at least one labelled centre")
    n_frames = reader.whole("n_frames", 1, MAX_FRAME)
    if truth.last_frame >= n_frames:
        raise reader.fault("n_frames", f"more than {truth.last_frame}, as that frame is labelled")
    for run in truth.straight_runs:
        if run.name not in truth.names:
            raise reader.fault("straight_runs", f"names of labelled objects, not {run.name!r}")
    return truth


def _centre(reader: _Reader, tolerance_px: float) -> Centre:
    return Centre(
        frame=reader.whole("frame", 0, MAX_FRAME),
        name=reader.text("name"),
        identity=reader.text("object", ""),
        x_px=reader.number("x_px", -MAX_PX, MAX_PX),
        y_px=reader.number("y_px", -MAX_PX, MAX_PX),
        area_px2=reader.number("area_px2", 1.0, MAX_PX**2),
        tolerance_px=reader.number("tolerance_px", 0.0, MAX_PX, tolerance_px),
    )


def _absence(reader: _Reader) -> Tuple[int, Tuple[str, ...]]:
    return reader.whole("frame", 0, MAX_FRAME), reader.texts("names")


def _straight_run(reader: _Reader) -> StraightRun:
    run = StraightRun(
        name=reader.text("name"),
        identity=reader.text("object", ""),
        first=reader.whole("first", 0, MAX_FRAME),
        last=reader.whole("last", 0, MAX_FRAME),
        vx_px_s=reader.number("vx_px_s", -MAX_PX, MAX_PX),
        vy_px_s=reader.number("vy_px_s", -MAX_PX, MAX_PX),
        tolerance_px_s=reader.number("tolerance_px_s", 0.0, MAX_PX),
    )
    if run.last - run.first < 2:
        raise reader.fault("last", f"at least {run.first + 2}: a speed needs three frames")
    return run
