"""``apex replay``: run the agent over a recording, a video or a folder of pictures."""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Dict, Set

from apex_edge import plugins
from apex_edge.assemble import ApexConfig, ColoursConfig, Kit, load_config
from apex_edge.cameras.base import Camera, CameraConfig
from apex_edge.cameras.playback import config_for
from apex_edge.errors import ColourError, RecordingError
from apex_edge.outputs import RunOutputs
from apex_edge.replaying import replay
from apex_edge.types import Step, TrackStatus
from apex_edge.verbs.progress import Progress

HELP = "run the agent over a recording, a video or a folder of pictures"
N_TIMED = 9
N_CERTAIN = 3
"""A colour seen by one track for fewer frames may be grain."""
EXAMPLE = "apex replay clip.mp4 --colours colours.json --out out/clip"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is played and where the results go."""
    parser.add_argument("source", type=Path, help="MCAP recording, video file or folder")
    parser.add_argument("--out", type=Path, required=True, help="folder for the results")
    parser.add_argument("--config", type=Path, help="settings file (TOML)")
    parser.add_argument(
        "--colours",
        type=Path,
        action="append",
        default=[],
        help="colour file of apex calibrate colour; may be given several times",
    )
    parser.add_argument("--calibration", type=Path, help="camera calibration (JSON)")
    parser.add_argument("--json", action="store_true", help="print the counts as JSON")


def run(args: argparse.Namespace) -> int:
    """Replay and write decisions.jsonl, tracks.csv, an annotated video and pictures.

    Raises
    ------
    RecordingError, ColourError, CalibrationError, ConfigError : nothing is left half written.
    """
    config = _settings(args)
    source = config_for(args.source, str(args.calibration or ""))
    if not args.source.exists():
        raise RecordingError(f"{args.source}: no such file or folder")
    fps = _frame_rate(source)
    if source.type != "mcap" and not config.colours.files:
        raise ColourError(
            f"{args.source}: which colours are to be followed? Teach one with "
            "`apex calibrate colour` and give it with --colours FILE"
        )
    camera: Camera = plugins.load("cameras", source.type)(source)
    kit = Kit.from_config(config)
    seen = Seen()
    outputs = RunOutputs(args.out, fps, video_suffix=".webm" if source.type == "mcap" else ".mp4")
    with Progress("frames", is_quiet=args.json) as progress, outputs:

        def on_step(step: Step) -> None:
            outputs.write(step)
            seen.see(step)
            progress.advance()

        seen.colour_use = replay(kit, camera, on_step)
        seen.check(kit, args.source)
    outputs.report(f"Replay of {args.source.name}")
    _print_counts(args, seen, camera, outputs)
    return 0


def _frame_rate(source: CameraConfig) -> float:
    """Return the rate (Hz) of a source by its first capture times; also checks that it plays."""
    camera: Camera = plugins.load("cameras", source.type)(source)
    with camera:
        frames = [camera.read(0.0) for _ in range(N_TIMED)]
    times_s = [frame.t_s for frame in frames if frame is not None]
    steps_s = [b - a for a, b in zip(times_s, times_s[1:]) if b > a]
    return 1.0 / median(steps_s) if steps_s else source.fps


class Seen:
    """Count frames, tracks and decisions of a replay."""

    def __init__(self) -> None:
        self.n_frames = 0
        self.n_interventions = 0
        self.n_seen: Dict[int, int] = {}
        self.names: Set[str] = set()
        self.colour_use: Dict[str, float] = {}

    def see(self, step: Step) -> None:
        """Count one step."""
        self.n_frames += 1
        self.n_interventions += step.decision.action == "intervene"
        tracks = step.tracks
        for name, track_id, status in zip(tracks.name, tracks.track_id, tracks.status):
            if status == TrackStatus.SEEN:
                n_seen = self.n_seen[int(track_id)] = self.n_seen.get(int(track_id), 0) + 1
                if n_seen >= N_CERTAIN:
                    self.names.add(name)

    def check(self, kit: Kit, source: Path) -> None:
        """Refuse a source in which none of the colours ever showed.

        Raises
        ------
        ColourError : no object of any configured colour was seen for a few frames.
        RecordingError : there was no frame at all.
        """
        if not self.n_frames:
            raise RecordingError(f"{source}: holds no frame")
        if not self.names:
            names = ", ".join(kit.colours.names)
            raise ColourError(
                f"{source}: none of the configured colours ({names}) was seen in "
                f"{self.n_frames} frames; teach them from a frame of this very source"
            )


def _settings(args: argparse.Namespace) -> ApexConfig:
    config = load_config(args.config)
    if args.colours:
        files = tuple(str(path) for path in args.colours)
        config = replace(config, colours=ColoursConfig(files))
    return config


def _print_counts(
    args: argparse.Namespace, seen: Seen, camera: Camera, outputs: RunOutputs
) -> None:
    counts = {
        "frames": seen.n_frames,
        "repeated_frames": camera.stats.repeated,
        "objects": sorted(seen.names),
        "tracks": len(seen.n_seen),
        "interventions": seen.n_interventions,
        "colour_use": {name: round(used, 3) for name, used in seen.colour_use.items()},
        "out": str(args.out),
        "video": outputs.video.path.name,
    }
    if args.json:
        print(json.dumps(counts, sort_keys=True))
        return
    print(
        f"{seen.n_frames} frames, {len(seen.n_seen)} tracks of {', '.join(sorted(seen.names))}, "
        f"{seen.n_interventions} interventions"
    )
    names = sorted(path.name for path in args.out.iterdir())
    print(f"results in {args.out}: {', '.join(names)}")
