import dataclasses
import json

import numpy as np
import pytest
import record_steps

from apex_edge import documents
from apex_edge.cameras.calibration import load_camera, load_intrinsics, save_camera
from apex_edge.errors import CalibrationError
from apex_edge.types import Intrinsics


def test_calibration_comes_back_bit_for_bit(tmp_path):
    camera = record_steps.camera_model()
    save_camera(tmp_path / "c.json", camera, {"rms_px": 0.21})
    back = load_camera(tmp_path / "c.json")
    assert np.array_equal(back.table_from_cam, camera.table_from_cam)
    assert np.array_equal(back.dist, camera.dist)
    assert dataclasses.replace(back, dist=0, table_from_cam=0) == dataclasses.replace(
        camera, dist=0, table_from_cam=0
    )


SKEWED = np.eye(4)
SKEWED[0, 1] = 0.1


@pytest.mark.parametrize(
    "change, message",
    [
        ({"fx_px": float("nan")}, "focal"),
        ({"fy_px": -1.0}, "focal"),
        ({"cx_px": float("inf")}, "principal point"),
        ({"dist": np.zeros(4)}, "dist"),
        ({"width_px": 0}, "picture size"),
        ({"table_from_cam": SKEWED}, "rigid"),
        ({"table_from_cam": np.diag([1.0, 1.0, -1.0, 1.0])}, "rigid"),
        ({"table_from_cam": np.eye(3)}, "4 x 4"),
    ],
)
def test_unusable_camera_is_not_written(tmp_path, change, message):
    camera = dataclasses.replace(record_steps.camera_model(), **change)
    with pytest.raises(CalibrationError, match=message):
        save_camera(tmp_path / "c.json", camera, {})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "not JSON"),
        ("[1, 2]", "not a file of format"),
        ('{"format": "apex-camera", "version": 7}', "version 7"),
        ('{"format": "apex-camera", "version": 1, "camera": {}, "sha256": "0"}', "hash"),
        ("[" * 100000, "not JSON"),
    ],
)
def test_what_is_no_calibration_is_refused_with_the_reason(tmp_path, text, message):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(CalibrationError, match=message):
        load_camera(tmp_path / "c.json")


def test_missing_calibration_is_refused_by_name(tmp_path):
    with pytest.raises(CalibrationError, match="gone.json"):
        load_camera(tmp_path / "gone.json")


def test_numbers_outside_their_range_are_refused_even_with_a_fitting_hash(tmp_path):
    save_camera(tmp_path / "c.json", record_steps.camera_model(), {})
    document = json.loads((tmp_path / "c.json").read_text())
    document["camera"]["dist"] = [0.0, "x"]
    document["sha256"] = documents.digest(document)
    (tmp_path / "c.json").write_text(json.dumps(document))
    with pytest.raises(CalibrationError, match="camera"):
        load_camera(tmp_path / "c.json")


def test_lens_without_a_pose_is_kept_and_says_what_is_missing(tmp_path):
    whole = record_steps.camera_model()
    names = [field.name for field in dataclasses.fields(Intrinsics)]
    lens = Intrinsics(**{name: getattr(whole, name) for name in names})
    save_camera(tmp_path / "lens.json", lens, {})
    back = load_intrinsics(tmp_path / "lens.json")
    assert type(back) is Intrinsics
    assert back.fx_px == lens.fx_px
    assert np.array_equal(back.dist, lens.dist)
    with pytest.raises(CalibrationError, match="apex calibrate table"):
        load_camera(tmp_path / "lens.json")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"fx_px": 1e308}, "focal lengths"),
        ({"fy_px": 1e-6}, "focal lengths"),
        ({"dist": np.array([-1.0, 0.0, 0.0, 0.0, 0.0])}, "cannot be undone"),
        ({"dist": np.array([0.0, 0.0, 0.0, 0.0, 1e308])}, "cannot be undone"),
        ({"table_from_cam": np.array(np.eye(4)) + np.eye(4, k=3) * 1e9}, "over 100 m"),
    ],
)
def test_camera_that_would_make_up_positions_is_refused(tmp_path, change, message):
    camera = dataclasses.replace(record_steps.camera_model(), **change)
    with pytest.raises(CalibrationError, match=message):
        save_camera(tmp_path / "c.json", camera, {})


def test_strong_distortion_of_a_real_lens_is_kept(tmp_path):
    strong = np.array([-0.35, 0.12, 0.001, -0.001, 0.0])
    camera = dataclasses.replace(record_steps.camera_model(), dist=strong)
    save_camera(tmp_path / "c.json", camera, {})
    assert np.array_equal(load_camera(tmp_path / "c.json").dist, strong)
