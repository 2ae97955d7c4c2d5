"""``apex record``: write what a camera sees to a recording, without an agent."""

import argparse
import time
from dataclasses import replace
from pathlib import Path

from apex_edge import __version__
from apex_edge.assemble import load_config, open_camera
from apex_edge.record.mcap_io import RecordingWriter
from apex_edge.verbs.progress import Progress

HELP = "record a camera to a file that Foxglove opens and apex replay plays"
EXAMPLE = "apex record --camera live --path 0 --seconds 20 --out table.mcap"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the source, the length and the file."""
    parser.add_argument("--out", type=Path, required=True, help="recording to write, *.mcap")
    parser.add_argument("--config", type=Path, help="settings file (TOML)")
    parser.add_argument("--camera", help="camera plug-in, instead of the one in the settings")
    parser.add_argument("--path", help="device, URL, file, or KIND:SEED of a twin's scene")
    parser.add_argument("--seconds", type=float, default=10.0, help="longest recording (10)")
    parser.add_argument("--lossless", action="store_true", help="PNG colour instead of JPEG")


def run(args: argparse.Namespace) -> int:
    """Record until the time is up, the source ends, or Ctrl-C; the file is whole each time.

    Raises
    ------
    CameraError, RecordingError, ConfigError : the file does not appear.
    """
    config = load_config(args.config)
    if args.camera is not None:
        config = replace(config, camera=replace(config.camera, type=args.camera))
    if args.path is not None:
        config = replace(config, camera=replace(config.camera, path=args.path))
    camera = open_camera(config, time.monotonic)
    metadata = {"apex_edge": __version__, "camera": config.camera.type}
    picture = "png" if args.lossless else "jpeg"
    with camera, Progress("frames") as progress, RecordingWriter(
        args.out, metadata, picture, is_threaded=True
    ) as recording:
        first_s = None
        while True:
            frame = camera.read(config.camera.timeout_s)
            if frame is None:
                break
            first_s = frame.t_s if first_s is None else first_s
            if frame.t_s - first_s > args.seconds:
                break
            recording.write_frame(frame)
            progress.advance()
    stats = camera.stats
    print(
        f"{args.out}: {recording.n_written} frames; camera: {stats.grabbed} grabbed, "
        f"{stats.dropped} dropped, {stats.repeated} repeated; "
        f"{recording.n_dropped} left out by a slow disk"
    )
    return 0
