"""The twin as a camera: as fast as possible in simulated time, or in real time on its own threads.

Each frame carries the world's time at the instant of capture, taken before anything is drawn, as
a good driver stamps a picture when its exposure ends and not when it has been copied.
"""

import queue
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Callable, ClassVar, List, Optional, Tuple

import numpy as np

from apex_edge.cameras.base import Camera, NewestSlot
from apex_edge.config import setting
from apex_edge.errors import CameraError
from apex_edge.twin.render import Renderer
from apex_edge.twin.sensor import SensorConfig
from apex_edge.twin.view import twin_camera_model
from apex_edge.twin.world import TwinWorld, WorldState
from apex_edge.types import Array, CameraModel, Frame

STEP_S = 0.005
NAP_S = 0.003
CLOSE_TIMEOUT_S = 5.0

StepHook = Callable[[TwinWorld, float], None]
Clock = Callable[[], float]


@dataclass(frozen=True)
class TwinConfig:
    """Settings of the twin's camera."""

    width_px: int = setting(640, "picture width (px)", 16, 4096)
    height_px: int = setting(480, "picture height (px)", 16, 4096)
    focal_px: float = setting(560.0, "focal length (px)", 10.0, 10000.0)
    fps: float = setting(30.0, "frame rate (Hz)", 1.0, 240.0)
    jitter_s: float = setting(0.002, "spread of the capture instants (s, sd)", 0.0, 0.1)
    delay_s: float = setting(0.025, "capture to delivery in simulated time (s)", 0.0, 0.5)
    drop_rate: float = setting(0.01, "share of frames that never arrive", 0.0, 0.9)
    repeat_rate: float = setting(0.005, "share of frames that show the one before", 0.0, 0.9)
    seed: int = setting(0, "seed of the sensor's random numbers", 0, 2**31 - 1)
    sensor: SensorConfig = setting(SensorConfig(), "noise of the sensor")


@dataclass(frozen=True)
class _Shot:
    """One capture: its number, the world at that instant, and what the driver does to it."""

    seq: int
    state: WorldState
    is_dropped: bool
    is_repeated: bool


class TwinCamera(Camera):
    """Sees a ``TwinWorld``; owns its time.

    Parameters
    ----------
    config : picture, rate and noise.
    world : stepped by this camera alone, from its ``t_s`` to the scenario's end.
    on_step : called after each physics step of at most 5 ms with the world and the step in s;
        the place to move an arm (``world.set_arm``). In real time it runs on the camera's thread.
    clock : seconds, monotonic. None means simulated time: each ``read`` steps the world up to
        the next capture. With a clock, ``open`` starts two threads that follow it.

    Source: ours.
    """

    type: ClassVar[str] = "twin"

    def __init__(
        self,
        config: TwinConfig,
        world: TwinWorld,
        on_step: Optional[StepHook] = None,
        clock: Optional[Clock] = None,
    ) -> None:
        super().__init__()
        self.config = config
        self.world = world
        self.camera: CameraModel = twin_camera_model(
            config.width_px, config.height_px, config.focal_px
        )
        self._on_step = on_step
        self._clock = clock
        seeds = [config.seed, world.scenario.seed]
        self._timing_rng = np.random.RandomState([*seeds, 1])
        self._renderer = Renderer(self.camera, config.sensor, np.random.RandomState([*seeds, 2]))
        self._start_s = world.t_s
        self._seq = 0
        self._next_s = self._start_s
        self._last: Optional[Tuple[Array, Array]] = None
        self._clock_start_s = 0.0
        self._stop = threading.Event()
        self._slot = NewestSlot(self._stats)
        self._shots: queue.Queue[Optional[_Shot]] = queue.Queue(maxsize=1)
        self._pool: Optional[ThreadPoolExecutor] = None
        self._loops: List[Future[None]] = []

    @property
    def is_real_time(self) -> bool:
        """Say whether the world follows a clock."""
        return self._clock is not None

    def now_s(self) -> float:
        """Return the time on the scene's clock, the one frames are stamped with."""
        if self._clock is None or self._pool is None:
            return self.world.t_s
        return self._start_s + self._clock() - self._clock_start_s

    def open(self) -> None:
        """Start the world's clock; in real time, the two threads.

        Raises
        ------
        CameraError : a real-time twin was closed before (its world has moved on).
        """
        if self._clock is None or self._pool is not None:
            return
        if self._stop.is_set():
            raise CameraError("this real-time twin was closed; make a new one with a new world")
        self._clock_start_s = self._clock()
        self._pool = ThreadPoolExecutor(max_workers=2, thread_name_prefix="twin")
        self._loops = [self._pool.submit(self._follow_clock), self._pool.submit(self._draw_shots)]

    def read(self, timeout_s: float) -> Optional[Frame]:
        """Return the next frame (simulated time) or the newest one (real time); None at the end.

        Raises
        ------
        CameraError : in real time, no frame within ``timeout_s`` though the scene goes on.
        """
        if self._clock is None:
            return self.advance()
        frame = self._slot.get(timeout_s)
        if frame is not None:
            return frame
        for loop in self._loops:
            if loop.done():
                loop.result()  # raises what stopped the thread
        if not self._loops or not self._slot.is_closed:
            raise CameraError(f"the twin delivered no frame for {timeout_s} s; is it open?")
        return None

    def advance(self) -> Optional[Frame]:
        """Step the world to the next capture that arrives and return it; None when it is over.

        Raises
        ------
        CameraError : the twin runs in real time and steps itself.
        """
        if self._clock is not None:
            raise CameraError("a real-time twin steps itself; use read()")
        while self._next_s <= self.world.scenario.duration_s:
            self._step_to(self._next_s)
            frame = self._develop(self._shoot())
            if frame is not None:
                self._stats.delivered += 1
                # drawing takes no simulated time; a real picture is old when it is handed out
                self._step_to(min(self.world.t_s + self.config.delay_s, self._next_s))
                return frame
        return None

    def close(self) -> None:
        """Stop the threads; may be called twice."""
        self._stop.set()
        self._slot.close()
        if self._pool is not None:
            self._pool.shutdown(wait=True)
            self._pool = None

    def _step_to(self, t_s: float) -> None:
        while self.world.t_s < t_s - 1e-9:
            dt_s = min(STEP_S, t_s - self.world.t_s)
            self.world.step(dt_s)
            if self._on_step is not None:
                self._on_step(self.world, dt_s)

    def _shoot(self) -> _Shot:
        """Take the world's state now and set the time of the next capture."""
        config, rng = self.config, self._timing_rng
        chance, jitter = float(rng.uniform()), float(rng.standard_normal())
        is_dropped = chance < config.drop_rate
        is_repeated = not is_dropped and chance < config.drop_rate + config.repeat_rate
        shot = _Shot(self._seq, self.world.state(), is_dropped, is_repeated)
        self._seq += 1
        late_s = min(max(jitter * config.jitter_s, -0.4 / config.fps), 0.4 / config.fps)
        self._next_s = self._start_s + self._seq / config.fps + late_s
        return shot

    def _develop(self, shot: _Shot, slot: Optional[NewestSlot] = None) -> Optional[Frame]:
        """Draw a shot and count it; None when it is dropped. A slot counts for itself."""
        if shot.is_dropped:
            self._stats.grabbed += 1
            self._stats.dropped += 1
            return None
        is_repeated = shot.is_repeated and self._last is not None
        if self._last is None or not is_repeated:
            self._last = self._renderer.render(shot.state)
        colour, depth = self._last
        frame = Frame(shot.seq, shot.state.t_s, colour, depth, self.camera, is_repeated)
        if slot is not None:
            slot.put(frame)
        else:
            self._stats.grabbed += 1
            self._stats.repeated += int(is_repeated)
        return frame

    def _follow_clock(self) -> None:
        """Step the world along the clock and hand a shot to the drawing thread when one is due."""
        end_s = self.world.scenario.duration_s
        try:
            while not self._stop.is_set() and self._next_s <= end_s:
                self._step_to(min(self.now_s(), self._next_s))
                if self.world.t_s < self._next_s - 1e-9:
                    self._stop.wait(NAP_S)
                    continue
                shot = self._shoot()
                try:
                    self._shots.put_nowait(shot)
                except queue.Full:  # drawing fell behind: the frame is lost, the world is not
                    self._stats.grabbed += 1
                    self._stats.dropped += 1
        finally:
            self._shots.put(None, timeout=CLOSE_TIMEOUT_S)

    def _draw_shots(self) -> None:
        try:
            while True:
                shot = self._shots.get()
                if shot is None:
                    return
                self._develop(shot, self._slot)
        finally:
            self._slot.close()
