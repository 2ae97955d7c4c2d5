"""The part of each maker's package that its driver touches, with frames from a script.

``frames`` is a list of what comes next: ``Taken`` values, None for silence, or an error to raise.
When it is used up the device is silent.
"""

import concurrent.futures
from datetime import timedelta
from types import SimpleNamespace

import numpy as np

WIDTH, HEIGHT = 64, 48


class Taken:
    """One exposure: picture, depth in the device's unit, stamp in its clock, frame number."""

    def __init__(self, number, stamp_s, depth=None, depth_stamp_s=None):
        self.number, self.stamp_s = number, stamp_s
        self.picture = np.full((HEIGHT, WIDTH, 3), number % 256, np.uint8)
        self.depth = np.full((HEIGHT, WIDTH), 500, np.uint16) if depth is None else depth
        self.depth_stamp_s = stamp_s if depth_stamp_s is None else depth_stamp_s


class Script:
    def __init__(self, frames):
        self.frames, self.n_opened, self.n_closed = list(frames), 0, 0

    def next(self):
        item = self.frames.pop(0) if self.frames else None
        if isinstance(item, Exception):
            raise item
        return item


def realsense(script, domain="global_time", unit_m=0.001, n_devices=1):
    def frame(item, data, stamp_s):
        return SimpleNamespace(
            get_frame_number=lambda: item.number,
            get_timestamp=lambda: 1000.0 * stamp_s,
            get_frame_timestamp_domain=lambda: domain,
            get_data=lambda: data,
        )

    def frames(item):
        return SimpleNamespace(
            get_color_frame=lambda: frame(item, item.picture, item.stamp_s),
            get_depth_frame=lambda: frame(item, item.depth, item.depth_stamp_s),
        )

    lens = SimpleNamespace(
        width=WIDTH, height=HEIGHT, fx=60.0, fy=60.0, ppx=32.0, ppy=24.0, coeffs=[0.0] * 5
    )
    stream = SimpleNamespace(
        as_video_stream_profile=lambda: SimpleNamespace(get_intrinsics=lambda: lens)
    )
    sensor = SimpleNamespace(get_depth_scale=lambda: unit_m)
    profile = SimpleNamespace(
        get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor),
        get_stream=lambda kind: stream,
    )

    class Pipeline:
        def start(self, config):
            script.n_opened += 1
            return profile

        def try_wait_for_frames(self, timeout_ms):
            item = script.next()
            return item is not None, item and frames(item)

        def stop(self):
            script.n_closed += 1

    class Config:
        def enable_stream(self, *_):
            pass

        def enable_device(self, serial):
            script.serial = serial

    return SimpleNamespace(
        pipeline=Pipeline,
        config=Config,
        context=lambda: SimpleNamespace(query_devices=lambda: [None] * n_devices),
        align=lambda to: SimpleNamespace(process=lambda frames: frames),
        stream=SimpleNamespace(color="color", depth="depth"),
        format=SimpleNamespace(bgr8="bgr8", z16="z16"),
        timestamp_domain=SimpleNamespace(
            global_time="global_time", system_time="system_time", hardware_clock="hardware_clock"
        ),
    )


class Anything:
    """Takes every call and attribute, as a pipeline that is only described."""

    def __getattr__(self, name):
        return Anything()

    def __getitem__(self, key):
        return Anything()

    def __call__(self, *args, **kwargs):
        return Anything()


def depthai(script, exposure_s=0.010, model="perspective"):
    def message(item):
        def stamp(offset):
            return timedelta(seconds=item.stamp_s - offset * exposure_s)

        colour = SimpleNamespace(getTimestamp=stamp, getCvFrame=lambda: item.picture)
        return {"colour": colour, "depth": SimpleNamespace(getFrame=lambda: item.depth)}

    class Queue:
        def tryGet(self):  # noqa: N802
            item = script.next()
            return None if item is None else message(item)

    stored = SimpleNamespace(
        getDistortionModel=lambda socket: model,
        getCameraIntrinsics=lambda socket, w, h: [[450.0, 0, w / 2], [0, 450.0, h / 2], [0, 0, 1]],
        getDistortionCoefficients=lambda socket: [0.0] * 14,
    )

    class Device:
        def __init__(self, pipeline, *which):
            script.n_opened += 1

        def getOutputQueue(self, *_):  # noqa: N802
            return Queue()

        def getQueueEvent(self, *_):  # noqa: N802
            return ""

        def readCalibration(self):  # noqa: N802
            return stored

        def close(self):
            script.n_closed += 1

    return SimpleNamespace(
        __version__="2.30.0",
        node=Anything(),
        Pipeline=Anything,
        Device=Device,
        DeviceInfo=str,
        CameraBoardSocket=Anything(),
        ColorCameraProperties=Anything(),
        MonoCameraProperties=Anything(),
        CameraModel=SimpleNamespace(Perspective="perspective"),
        CameraExposureOffset=SimpleNamespace(MIDDLE=0.5),
    )


class OBError(Exception):
    pass


def orbbec(script, is_global=True, scale=1.0, offered="RGB", n_devices=1):
    def frame(item, data, kind):
        return SimpleNamespace(
            get_width=lambda: WIDTH,
            get_height=lambda: HEIGHT,
            get_format=lambda: kind,
            get_data=lambda: data.view(np.uint8).ravel(),
            get_depth_scale=lambda: scale,
            get_global_timestamp_us=lambda: int(1e6 * item.stamp_s),
            get_system_timestamp_us=lambda: int(1e6 * item.stamp_s),
        )

    def frames(item):
        found = SimpleNamespace(
            get_color_frame=lambda: frame(item, item.picture, offered),
            get_depth_frame=lambda: frame(item, item.depth, "Y16"),
        )
        found.as_frame_set = lambda: found
        return found

    lens = SimpleNamespace(width=WIDTH, height=HEIGHT, fx=60.0, fy=61.0, cx=32.0, cy=24.0)
    bend = SimpleNamespace(k1=0.1, k2=0.0, k3=0.0, k4=0.0, k5=0.0, k6=0.0, p1=0.0, p2=0.0)

    class Profiles:
        def get_video_stream_profile(self, width, height, kind, fps):
            if kind != offered:
                raise OBError("no such stream")
            return SimpleNamespace(get_intrinsic=lambda: lens, get_distortion=lambda: bend)

        def get_default_video_stream_profile(self):
            return None

    class Pipeline:
        def __init__(self, device):
            pass

        def get_stream_profile_list(self, sensor):
            return Profiles()

        def enable_frame_sync(self):
            pass

        def start(self, config):
            script.n_opened += 1

        def wait_for_frames(self, timeout_ms):
            item = script.next()
            return None if item is None else frames(item)

        def stop(self):
            script.n_closed += 1

    device = SimpleNamespace(
        is_global_timestamp_supported=lambda: is_global, enable_global_timestamp=lambda on: None
    )

    class Context:
        set_logger_to_file = staticmethod(lambda level, folder: None)

        def query_devices(self):
            return SimpleNamespace(
                get_count=lambda: n_devices, get_device_by_index=lambda index: device
            )

    return SimpleNamespace(
        OBError=OBError,
        OBFormat=SimpleNamespace(BGR="BGR", RGB="RGB", MJPG="MJPG", YUYV="YUYV"),
        OBLogLevel=Anything(),
        OBSensorType=Anything(),
        OBStreamType=Anything(),
        OBFrameAggregateOutputMode=Anything(),
        Config=Anything,
        Context=Context,
        Pipeline=Pipeline,
        AlignFilter=lambda stream: SimpleNamespace(process=lambda frames: frames),
    )


def picamera2(script, exposure_us=10000):
    class Request:
        def __init__(self, item):
            self.item = item

        def get_metadata(self):
            return {
                "SensorTimestamp": int(1e9 * self.item.stamp_s),
                "ExposureTime": exposure_us,
            }

        def make_array(self, name):
            return self.item.picture

        def release(self):
            script.n_released = getattr(script, "n_released", 0) + 1

    class Picamera2:
        def __init__(self, number):
            if number > 0:
                raise IndexError("list index out of range")
            script.n_opened += 1

        def create_video_configuration(self, **wanted):
            return wanted

        def configure(self, wanted):
            script.wanted = wanted

        def start(self):
            pass

        def capture_request(self, wait):
            item = script.next()
            if item is None:
                raise concurrent.futures.TimeoutError
            return Request(item)

        def cancel_all_and_flush(self):
            script.n_cancelled = getattr(script, "n_cancelled", 0) + 1

        def close(self):
            script.n_closed += 1

    return SimpleNamespace(Picamera2=Picamera2)
