"""Malformed files, through the cameras, loaders and commands that users call."""

import contextlib
import io
import json
import shutil
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Dict, List

import cv2
import numpy as np

from apex_edge import cli, plugins
from apex_edge.cameras.base import Camera
from apex_edge.cameras.calibration import camera_document, load_camera
from apex_edge.cameras.playback import config_for
from apex_edge.errors import ApexError
from apex_edge.perception import ColourTable, Perception, colour_file
from apex_edge.record.mcap_io import RecordingWriter
from apex_edge.types import Frame
from offline_train.benchmarks.perception import damage, judge, truth
from offline_train.benchmarks.perception.bad_frames import CONFIG, LOST, NOTHING, REFUSED, TRUE

N_FRAMES = 12
MAX_FRAMES = 60
FPS = 30.0
USABLE = "used as it is"

Case = Callable[[np.random.RandomState, Path], str]


def play(path: Path) -> str:
    """Play a source through its camera and perception; say what came of it."""
    source = config_for(path)
    camera: Camera = plugins.load("cameras", source.type)(source)
    stage = Perception(CONFIG, ColourTable.builtin())
    n_seen = n_tracks = 0
    try:
        with camera:
            for _ in range(MAX_FRAMES):
                frame = camera.read(0.0)
                if frame is None:
                    break
                detections, tracks = stage.step(frame)
                n_seen += judge.check(frame, detections, tracks, CONFIG)
                n_tracks += len(tracks.name)
    except ApexError:
        return REFUSED
    return TRUE if n_seen else LOST if n_tracks else NOTHING


@lru_cache(maxsize=None)
def _source(kind: str, folder: Path) -> bytes:
    """Return the bytes of a sound little recording: ``.avi`` (MJPG), ``.mp4`` or ``.mcap``."""
    pictures = damage.balls(np.random.RandomState(5), N_FRAMES)
    path = folder / f"sound{kind}"
    if kind == ".mcap":
        with RecordingWriter(path, {"note": "sound"}) as writer:
            for i, picture in enumerate(pictures):
                depth, camera = damage.depth_of(picture), damage.camera()
                writer.write_frame(Frame(i, i / FPS, picture, depth, camera))
    else:
        code = cv2.VideoWriter_fourcc(*{".avi": "MJPG", ".mp4": "mp4v"}[kind])
        video = cv2.VideoWriter(str(path), code, FPS, damage.SIZE)
        for picture in pictures:
            video.write(picture)
        video.release()
    return path.read_bytes()


def _damaged_recording(kind: str) -> Case:
    def case(rng: np.random.RandomState, folder: Path) -> str:
        path = folder / f"damaged{kind}"
        path.write_bytes(damage.broken(rng, _source(kind, folder.parent)))
        return play(path)

    return case


def foreign(rng: np.random.RandomState, folder: Path) -> str:
    """Play something that is not what its name says, or is not there."""
    _, png = cv2.imencode(".png", damage.balls(rng, 1)[0])
    contents = [
        b"",
        b"\0",
        b"RIFF",
        png.tobytes(),
        b'{"format": "apex-camera"}',
        _source(".avi", folder.parent),
        _source(".mp4", folder.parent),
        _source(".mcap", folder.parent),
        bytes(rng.randint(0, 256, 4096).astype(np.uint8)),
    ]
    names = ["a.mp4", "a.avi", "a.mcap", "a.mkv", "a.png", "a", "a.mcap.part", "a.MP4", "a b.webm"]
    path = folder / names[int(rng.randint(0, len(names)))]
    kind = int(rng.randint(0, len(contents) + 2))
    if kind < len(contents):
        path.write_bytes(contents[kind])
    elif kind == len(contents):
        path.mkdir()
    return play(path)


def pictures(rng: np.random.RandomState, folder: Path) -> str:
    """Play a folder in which some pictures, colour or depth, are damaged or of another kind."""
    (folder / "depth").mkdir()
    for i, picture in enumerate(damage.balls(rng, 4)):
        suffix = (".png", ".jpg", ".bmp")[int(rng.randint(0, 3))]
        _put(rng, folder / f"{i:03d}{suffix}", picture)
        if rng.uniform() < 0.5:
            depth = damage.depth_of(picture)
            odd = [depth] * 12 + [depth[:-3], (depth // 256).astype(np.uint8), picture]
            _put(rng, folder / "depth" / f"{i:03d}.png", odd[int(rng.randint(0, len(odd)))])
    if rng.uniform() < 0.2:
        (folder / "camera.json").write_text(_camera_text(rng), encoding="utf-8")
    return play(folder)


def _put(rng: np.random.RandomState, path: Path, picture: Any) -> None:
    _, data = cv2.imencode(path.suffix, picture)
    content = data.tobytes()
    path.write_bytes(damage.broken(rng, content) if rng.uniform() < 0.12 else content)


def timestamps(rng: np.random.RandomState, folder: Path) -> str:
    """Play a folder whose times are garbage."""
    names = [f"{i:03d}.png" for i in range(4)]
    for name, picture in zip(names, damage.balls(rng, len(names))):
        cv2.imwrite(str(folder / name), picture)
    odd = ("nan", "inf", "-inf", "1e400", "", "x", "0.1,0.2", "-5", "0", "1e300", "\0", "0x10")
    lines = [f"{name},{i / FPS:.6f}" for i, name in enumerate(names)]
    for _ in range(int(rng.randint(1, 3))):
        at = int(rng.randint(0, len(lines)))
        lines[at] = f"{names[at]},{odd[int(rng.randint(0, len(odd)))]}"
    text = "\n".join(lines).encode("utf-8")
    if rng.uniform() < 0.4:
        text = damage.broken(rng, text)
    (folder / "timestamps.csv").write_bytes(text)
    return play(folder)


def _colours() -> Dict[str, Any]:
    colours = [asdict(model) for model in ColourTable.builtin().models[:2]]
    return colour_file.compose(colours, {"note": "sound"})


def _spoilt(rng: np.random.RandomState, document: Dict[str, Any]) -> bytes:
    """Return a document with a wrong value and a fitting hash, or with damaged bytes."""
    if rng.uniform() < 0.7:
        return damage.signed(damage.edited(rng, document)).encode("utf-8")
    return damage.broken(rng, damage.signed(document).encode("utf-8"))


def colours(rng: np.random.RandomState, folder: Path) -> str:
    """Load a damaged colour file; what is taken must still classify, and see nothing in grey."""
    path = folder / "colours.json"
    path.write_bytes(_spoilt(rng, _colours()))
    try:
        table = ColourTable.load(path)
    except ApexError:
        return REFUSED
    stage = Perception(CONFIG, table)
    for i, picture in enumerate(damage.balls(rng, 2)):
        stage.step(Frame(i, i / FPS, picture))
    return USABLE


def _camera_text(rng: np.random.RandomState) -> str:
    document = camera_document(damage.camera(), {"note": "sound"})
    return _spoilt(rng, document).decode("utf-8", "replace")


def camera(rng: np.random.RandomState, folder: Path) -> str:
    """Load a damaged camera file; what is taken must give finite places."""
    path = folder / "camera.json"
    path.write_text(_camera_text(rng), encoding="utf-8")
    try:
        model = load_camera(path)
    except ApexError:
        return REFUSED
    stage = Perception(CONFIG, ColourTable.builtin())
    for i, picture in enumerate(damage.balls(rng, 4)):
        frame = Frame(i, i / FPS, picture, damage.depth_of(picture), model)
        judge.check(frame, *stage.step(frame), CONFIG)
    return USABLE


def truths(rng: np.random.RandomState, folder: Path) -> str:
    """Load a damaged truth file of a labelled clip."""
    document = {
        "video": "clip.avi",
        "size_px": [160, 120],
        "n_frames": 30,
        "nominal_fps": 30,
        "tolerance_px": 4,
        "centres": [
            {"frame": 3, "name": "red", "object": "a", "x_px": 5, "y_px": 6.5, "area_px2": 80}
        ],
        "absent": [{"frame": 5, "names": ["red"]}],
        "straight_runs": [
            {"name": "red", "first": 3, "last": 9, "vx_px_s": 1, "vy_px_s": 2, "tolerance_px_s": 3}
        ],
        "bounce_frames": [7],
        "teach": [3],
    }
    text = json.dumps(damage.edited(rng, document)).encode("utf-8")
    if rng.uniform() < 0.3:
        text = damage.broken(rng, json.dumps(document).encode("utf-8"))
    path = folder / truth.FILE
    path.write_bytes(text)
    try:
        truth.load(path)
    except ApexError:
        return REFUSED
    return USABLE


def command(arguments: List[str], out: Path) -> str:
    """Run a command as a user does; on an error it must leave no result behind.

    Raises
    ------
    judge.MadeUp : it failed but left results, or said neither 0 nor 2.
    """
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            code = cli.main(arguments)
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else 1
    if code == 0:
        return USABLE
    left = sorted(p.name for p in out.parent.glob(f"{out.stem}*")) if out.suffix else []
    if out.is_dir():
        left = sorted(p.name for p in out.iterdir())
    if code != 2 or left:
        raise judge.MadeUp(f"apex {' '.join(arguments[:2])}: exit code {code}, left {left}")
    return REFUSED


def teach(rng: np.random.RandomState, folder: Path) -> str:
    """Teach a colour from a damaged picture, or from discs that are none."""
    picture = folder / ("p.png", "p.jpg", "p.avi")[int(rng.randint(0, 3))]
    if picture.suffix == ".avi":
        content = _source(".avi", folder.parent)
    else:
        content = cv2.imencode(picture.suffix, damage.balls(rng, 1)[0])[1].tobytes()
    picture.write_bytes(damage.broken(rng, content) if rng.uniform() < 0.5 else content)
    numbers = ["40", "72", "6", "nan", "inf", "-1", "1e9", "0", "", "1e-300", "112"]
    parts = [numbers[int(rng.randint(0, len(numbers)))] for _ in range(3)]
    sample = "red:40,72,6" if rng.uniform() < 0.4 else "red:" + ",".join(parts)
    out = folder / "out.json"
    arguments = ["calibrate", "colour", "--image", str(picture), "--sample", sample]
    return command([*arguments, "--out", str(out), "--json"], out)


def replay(rng: np.random.RandomState, folder: Path) -> str:
    """Replay a damaged recording with sound colours, or a sound one with damaged colours."""
    kind = (".avi", ".mp4", ".mcap")[int(rng.randint(0, 3))]
    content, colours_text = _source(kind, folder.parent), damage.signed(_colours()).encode("utf-8")
    if rng.uniform() < 0.8:
        content = damage.broken(rng, content)
    else:
        colours_text = _spoilt(rng, _colours())
    source, colour_path, out = folder / f"clip{kind}", folder / "colours.json", folder / "out"
    source.write_bytes(content)
    colour_path.write_bytes(colours_text)
    arguments = ["replay", str(source), "--colours", str(colour_path)]
    return command([*arguments, "--out", str(out), "--json"], out)


FILE_CASES: Dict[str, Case] = {
    "video: MJPG damaged": _damaged_recording(".avi"),
    "video: mp4 damaged": _damaged_recording(".mp4"),
    "recording: mcap damaged": _damaged_recording(".mcap"),
    "file: empty, foreign, missing": foreign,
    "folder: pictures damaged": pictures,
    "folder: timestamps": timestamps,
    "colours.json": colours,
    "camera.json": camera,
    "truth.json": truths,
    "command: calibrate colour": teach,
    "command: replay": replay,
}


def clear(folder: Path) -> None:
    """Empty a case's folder for the next one."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
