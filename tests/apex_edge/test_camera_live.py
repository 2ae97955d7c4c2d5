import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import cv2
import pytest
import record_steps

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.live import LiveCamera
from apex_edge.errors import CameraError


class FakeCapture:
    """A device that delivers when told: each release of ``tick`` is one frame."""

    def __init__(self, n_frames=None, is_there=True):
        self.tick = threading.Semaphore(0)
        self.n_left = n_frames
        self.is_there = is_there
        self.is_released = threading.Event()
        self.n_grabbed = 0

    def isOpened(self):  # noqa: N802
        return self.is_there

    def grab(self):
        self.tick.acquire(timeout=5.0)
        if self.n_left == 0:
            return False
        if self.n_left is not None:
            self.n_left -= 1
        self.n_grabbed += 1
        return True

    def retrieve(self):
        return True, record_steps.picture(self.n_grabbed // 2)

    def release(self):
        self.is_released.set()


def live(capture, clock=lambda: 100.0, **settings):
    config = CameraConfig(type="live", path="/dev/video7", **settings)
    return LiveCamera(config, clock=clock, opener=lambda _: capture)


def test_frame_is_stamped_when_grabbed_less_the_latency():
    capture = FakeCapture()
    with live(capture, latency_s=0.04) as camera:
        capture.tick.release()
        frame = camera.read(10.0)
        assert frame.t_s == pytest.approx(99.96)
        assert frame.seq == 0
        capture.tick.release()


def test_silent_device_is_named():
    capture = FakeCapture()
    with live(capture) as camera:
        with pytest.raises(CameraError, match="/dev/video7.*no fresh frame for 0.05 s"):
            camera.read(0.05)
        capture.tick.release()


def test_lost_device_is_named_after_its_last_frame():
    capture = FakeCapture(n_frames=1)
    capture.tick.release()
    with live(capture) as camera:
        assert camera.read(10.0).seq == 0
        capture.tick.release()
        with pytest.raises(CameraError, match="/dev/video7.*was lost"):
            camera.read(10.0)
    assert capture.is_released.wait(10.0)


def test_device_that_cannot_be_opened_is_named():
    capture = FakeCapture(is_there=False)
    with pytest.raises(CameraError, match="/dev/video7.*cannot be opened"):
        live(capture).open()
    assert capture.is_released.is_set()


def test_real_device_that_is_missing_is_named():
    with pytest.raises(CameraError, match="video987"):
        LiveCamera(CameraConfig(type="live", path="/dev/video987")).open()


def test_stale_frames_are_counted_and_never_delivered():
    capture = FakeCapture()
    times = iter([100.0] + [200.0] * 1000)
    with live(capture, clock=lambda: next(times)) as camera:
        capture.tick.release()
        with pytest.raises(CameraError, match="no fresh frame"):
            camera.read(0.3)
        assert (camera.stats.stale, camera.stats.delivered) == (1, 0)
        capture.tick.release()


def test_repeated_pictures_are_marked():
    capture = FakeCapture()
    flags = []
    with live(capture) as camera:
        for _ in range(4):
            capture.tick.release()
            flags.append(camera.read(10.0).is_repeated)
        capture.tick.release()
    assert flags == [False, False, True, False]
    assert camera.stats.repeated >= 1


def test_reading_before_opening_is_refused():
    with pytest.raises(CameraError, match="not open"):
        live(FakeCapture()).read(0.1)


class MjpegHandler(BaseHTTPRequestHandler):
    def do_GET(self):  # noqa: N802
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        try:
            for seq in range(600):
                data = cv2.imencode(".jpg", record_steps.picture(seq))[1].tobytes()
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                self.wfile.write(head.encode() + data + b"\r\n")
        except OSError:
            return

    def log_message(self, *_):
        pass


def test_http_mjpeg_stream_is_read():
    server = HTTPServer(("127.0.0.1", 0), MjpegHandler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}/stream.mjpg"
    try:
        with LiveCamera(
            CameraConfig(type="live", path=url, timeout_s=10.0, max_age_s=5.0)
        ) as camera:
            first = camera.read(10.0)
            second = camera.read(10.0)
        assert first.colour_bgr.shape == (record_steps.HEIGHT, record_steps.WIDTH, 3)
        assert second.seq > first.seq
    finally:
        server.shutdown()
        server.server_close()


def test_stream_that_is_not_there_is_named():
    url = "http://127.0.0.1:9/stream.mjpg"
    with pytest.raises(CameraError, match="127.0.0.1:9"):
        LiveCamera(CameraConfig(type="live", path=url, timeout_s=1.0)).open()
