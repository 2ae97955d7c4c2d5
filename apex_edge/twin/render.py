"""The twin's eye: a world's state in, a colour picture and a depth map out."""

from functools import lru_cache
from typing import Tuple

import numpy as np

from apex_edge.twin.backdrop import paint_backdrop
from apex_edge.twin.canvas import Canvas, Lens
from apex_edge.twin.figures import paint_arm, paint_hand, paint_objects, shadows
from apex_edge.twin.sensor import Sensor, SensorConfig
from apex_edge.twin.world import TwinWorld, WorldObjects, WorldState
from apex_edge.types import Array, CameraModel

Layer = Tuple[Array, Array, Array]
"""Colour (h, w, 3) uint8, depth (h, w) float32 in m, bare table (h, w) 0/255."""

CameraKey = Tuple[
    Tuple[int, int], Tuple[float, float, float, float], Tuple[float, ...], Tuple[float, ...]
]


class Renderer:
    """Draws states of a world as one calibrated RGB-D camera sees them. Source: ours.

    The backdrop and the noise banks are made once; the same ``rng`` seed and the same states
    give the same pictures byte for byte. What is at rest is kept as a layer until it changes:
    most frames then cost half.
    """

    def __init__(
        self, camera: CameraModel, config: SensorConfig, rng: np.random.RandomState
    ) -> None:
        self.camera = camera
        self._lens, self._backdrop = _scenery(_camera_key(camera))
        self._sensor = Sensor(config, (camera.height_px, camera.width_px), rng)
        self._still_key: Tuple[bytes, ...] = ()
        self._still: Layer = self._backdrop

    def paint(self, state: WorldState) -> Tuple[Array, Array]:
        """Return the clean picture: colour (h, w, 3) uint8 and depth (h, w) float32 in m."""
        still, moving = _split(state)
        key = _key(still)
        if key != self._still_key:
            self._still, self._still_key = self._on_top_of(self._backdrop, still), key
        colour, depth_m, _ = self._on_top_of(self._still, moving)
        return colour, depth_m

    def _on_top_of(self, layer: Layer, state: WorldState) -> Layer:
        colour, depth_m, is_bare = layer
        canvas = Canvas(self._lens, colour.copy(), depth_m.copy(), self._sensor.config.exposure_s)
        canvas.shade_ground(shadows(state), is_bare)
        if state.arm_m is not None and state.arm_vel_m_s is not None:
            paint_arm(canvas, state.arm_m, state.arm_vel_m_s)
        paint_objects(canvas, state.objects)
        for hand in state.hands:
            paint_hand(canvas, hand)
        is_bare = is_bare * (canvas.depth_m == depth_m).view(np.uint8)
        return canvas.colour, canvas.depth_m, is_bare

    def render(self, state: WorldState) -> Tuple[Array, Array]:
        """Return the sensor's picture: colour (h, w, 3) uint8 BGR, depth (h, w) uint16 in mm."""
        colour, depth_m = self.paint(state)
        return self._sensor.expose(colour), self._sensor.measure(depth_m)


def render(
    world: TwinWorld, camera: CameraModel, rng: np.random.RandomState, config: SensorConfig
) -> Tuple[Array, Array]:
    """Draw one picture of a world as it is now; for a sequence keep a ``Renderer``."""
    return Renderer(camera, config, rng).render(world.state())


def _camera_key(camera: CameraModel) -> CameraKey:
    size = camera.width_px, camera.height_px
    optics = camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px
    pose = np.asarray(camera.table_from_cam, dtype=np.float64).ravel()
    return size, optics, tuple(np.ravel(camera.dist).tolist()), tuple(pose.tolist())


@lru_cache(maxsize=4)
def _scenery(key: CameraKey) -> Tuple[Lens, Layer]:
    """Return what depends on the camera alone; it costs as much as thirty pictures."""
    size, optics, dist, pose = key
    camera = CameraModel(*size, *optics, np.array(dist), np.array(pose).reshape(4, 4))
    lens = Lens(camera)
    backdrop = paint_backdrop(lens)
    for part in backdrop:
        part.setflags(write=False)
    return lens, backdrop


def _split(state: WorldState) -> Tuple[WorldState, WorldState]:
    """Return what is at rest and what moves."""
    is_moving = np.any(state.objects.vel_m_s != 0.0, axis=1)
    has_moving_arm = state.arm_vel_m_s is not None and bool(np.any(state.arm_vel_m_s != 0.0))
    parts = []
    for wanted in (False, True):
        has_arm = has_moving_arm == wanted
        parts.append(
            WorldState(
                t_s=state.t_s,
                objects=_pick(state.objects, is_moving == wanted),
                hands=tuple(h for h in state.hands if (h.vel_m_s != (0.0, 0.0)) == wanted),
                arm_m=state.arm_m if has_arm else None,
                arm_vel_m_s=state.arm_vel_m_s if has_arm else None,
            )
        )
    return parts[0], parts[1]


def _pick(objects: WorldObjects, chosen: Array) -> WorldObjects:
    at = np.flatnonzero(chosen)
    return WorldObjects(
        name=tuple(objects.name[k] for k in at),
        colour=tuple(objects.colour[k] for k in at),
        kind=tuple(objects.kind[k] for k in at),
        look=tuple(objects.look[k] for k in at),
        pos_m=objects.pos_m[at],
        vel_m_s=objects.vel_m_s[at],
        yaw_rad=objects.yaw_rad[at],
        radius_m=objects.radius_m[at],
    )


def _key(state: WorldState) -> Tuple[bytes, ...]:
    """Return what tells two still states apart."""
    objects = state.objects
    words = repr((objects.name, objects.colour, objects.look, state.hands)).encode("utf-8")
    arm = b"" if state.arm_m is None else state.arm_m.tobytes()
    return (
        words,
        objects.pos_m.tobytes(),
        objects.radius_m.tobytes(),
        objects.yaw_rad.tobytes(),
        arm,
    )
