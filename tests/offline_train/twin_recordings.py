"""Small recordings of the twin with no arm, for tests."""

from pathlib import Path
from typing import Iterator

from apex_edge.cameras.twin import TwinCamera, TwinConfig
from apex_edge.record.mcap_io import RecordingWriter
from apex_edge.twin.scenarios import make
from apex_edge.twin.world import TwinWorld
from apex_edge.types import Frame

SMALL = TwinConfig(width_px=240, height_px=180, focal_px=210.0, fps=15.0, delay_s=0.0)


def frames(world: TwinWorld, from_s: float = 0.0) -> Iterator[Frame]:
    """Yield the frames of a scene; it ends half a second after the first contact."""
    while world.t_s < from_s:
        world.step(0.005)
    camera = TwinCamera(SMALL, world)
    while True:
        frame = camera.advance()
        pair = frozenset((world.scenario.mover, world.scenario.target))
        if frame is None or world.t_s > world.contacts.get(pair, 99.0) + 0.5:
            return
        yield frame


def record(kind: str, seed: int, path: Path, from_s: float = 0.0) -> TwinWorld:
    """Write one scene as ``apex record`` would and return its world, run to the end."""
    world = TwinWorld(make(kind, seed))
    with RecordingWriter(path, {"scene": f"{kind}:{seed}"}) as writer:
        for frame in frames(world, from_s):
            writer.write_frame(frame)
    return world
