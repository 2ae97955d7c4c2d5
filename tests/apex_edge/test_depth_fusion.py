"""How far along the ray: depth surface, known size, table plane, and what they say together."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_perception import CAMERA, ball_frame, perception

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.folder import FolderCamera
from apex_edge.config import structure
from apex_edge.errors import ConfigError, InputError, RecordingError
from apex_edge.geometry import look_at, rays
from apex_edge.perception import ColourTable, Perception, PerceptionConfig, blobs, depth
from apex_edge.perception.colour_model import features, model_from
from apex_edge.perception.depth import range_of
from apex_edge.perception.range_fusion import Estimate, fuse
from apex_edge.types import Frame

RADIUS_M = 0.015
BALL = ("red=0.015",)


def placed(frame, **settings):
    """Return position, sd and radius of the only detection."""
    found, _ = perception(**settings).step(frame)
    assert len(found.name) == 1
    return found.pos_m[0], found.pos_sd_m[0], found.radius_m[0]


def without_depth(frame):
    return replace(frame, depth_mm=None)


def reach_of(pos_m):
    return float((pos_m - CAMERA.table_from_cam[:3, 3]) @ CAMERA.table_from_cam[:3, 2])


# --- weighing ------------------------------------------------------------------------------


def test_estimates_are_weighed_by_their_variance():
    best = fuse([Estimate(1.00, 0.01, 0.1), Estimate(1.04, 0.02, 0.2)])
    assert best.reach_m == pytest.approx(1.008)
    assert best.sd_m == pytest.approx((1 / 0.01**2 + 1 / 0.02**2) ** -0.5)


def test_contradiction_is_dropped_and_not_averaged():
    best = fuse([Estimate(1.30, 0.02, 0.2), Estimate(1.00, 0.01, 0.1)])
    assert best == Estimate(1.00, pytest.approx(0.01), 0.1)


def test_assumption_joins_what_it_agrees_with():
    best = fuse([Estimate(1.05, 0.03, 0.1)], assumed=Estimate(1.00, 0.01, 0.2))
    assert 1.00 < best.reach_m < 1.01
    assert best.sd_m < 0.01


def test_assumption_never_overrules_a_measurement():
    best = fuse([Estimate(1.5, 0.05, 0.1)], assumed=Estimate(1.0, 0.001, 0.2))
    assert best.reach_m == pytest.approx(1.5)


def test_nothing_said_is_nothing():
    assert fuse([]) is None


@given(
    st.lists(
        st.tuples(st.floats(0.2, 3.0), st.floats(0.001, 0.3)).map(lambda e: Estimate(*e, 0.02)),
        min_size=1,
        max_size=4,
    )
)
def test_fusion_stays_among_its_estimates_and_is_no_worse_than_the_best(estimates):
    best = fuse(estimates)
    reaches = [estimate.reach_m for estimate in estimates]
    assert min(reaches) - 1e-9 <= best.reach_m <= max(reaches) + 1e-9
    assert best.sd_m <= min(estimate.sd_m for estimate in estimates) + 1e-12


# --- known size ----------------------------------------------------------------------------


@pytest.mark.parametrize("height_m", [0.015, 0.10, 0.20])
def test_ball_of_known_size_is_placed_without_depth(height_m):
    truth = np.array([0.2, 0.05, height_m])
    pos_m, sd_m, radius_m = placed(without_depth(ball_frame(0, truth, 0.015)), ball_radius_m=BALL)
    assert np.linalg.norm(pos_m - truth) <= 3.0 * sd_m
    assert radius_m == RADIUS_M


def test_ball_held_above_the_table_was_put_on_it_before_its_size_was_known():
    truth = np.array([0.2, 0.05, 0.20])
    frame = without_depth(ball_frame(0, truth, 0.015))
    unknown, sd_m, _ = placed(frame)
    assert np.linalg.norm(unknown - truth) > 10.0 * sd_m
    known, sd_m, _ = placed(frame, ball_radius_m=BALL)
    assert np.linalg.norm(known - truth) <= 0.06


def test_size_sharpens_the_plane_and_does_not_move_it():
    truth = np.array([0.2, 0.05, 0.015])
    frame = without_depth(ball_frame(0, truth, 0.015))
    plain, plain_sd_m, _ = placed(frame)
    known, known_sd_m, _ = placed(frame, ball_radius_m=BALL)
    assert known_sd_m < plain_sd_m
    assert np.linalg.norm(known - truth) <= 0.004


def test_size_hardly_moves_what_depth_says():
    frame = ball_frame(0, (0.2, 0.05, 0.015), 0.015)
    plain, known = placed(frame)[0], placed(frame, ball_radius_m=BALL)[0]
    assert np.linalg.norm(plain - known) <= 0.0005


def test_wrong_size_is_dropped_where_depth_is_seen():
    frame = ball_frame(0, (0.2, 0.05, 0.015), 0.015)
    pos_m, _, radius_m = placed(frame, ball_radius_m=("red=0.030",))
    assert np.linalg.norm(pos_m - placed(frame)[0]) <= 1e-9
    assert abs(radius_m - RADIUS_M) <= 0.003


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_ball_half_hidden_is_not_taken_for_a_far_one(share):
    truth = np.array([0.2, 0.05, 0.015])
    frame = without_depth(ball_frame(0, truth, 0.015))
    found, _ = perception().step(frame)
    x, y, w, h = found.box_px[0].astype(int)
    frame.colour_bgr[y - 2 : y + int(share * h), x - 2 : x + w + 2] = (60, 60, 60)
    pos_m, _, _ = placed(frame, ball_radius_m=BALL)
    # no more than half its outline moved the ray; the range stayed the plane's
    assert np.linalg.norm(pos_m - truth) <= 0.020


def test_size_that_would_put_the_ball_below_the_table_is_dropped():
    frame = without_depth(ball_frame(0, (0.2, 0.05, 0.015), 0.015))
    pos_m, _, _ = placed(frame, ball_radius_m=("red=0.030",))
    assert pos_m[2] == pytest.approx(0.030)


def test_size_is_used_by_the_lens_where_the_ball_is():
    bent = replace(CAMERA, dist=np.array([-0.25, 0.06, 0.0, 0.0, 0.0]))
    truth = np.array([0.30, 0.24, 0.12])
    frame = without_depth(ball_frame(0, truth, 0.015, camera=bent))
    pos_m, sd_m, _ = placed(frame, ball_radius_m=BALL)
    assert np.linalg.norm(pos_m - truth) <= 3.0 * sd_m


def test_camera_that_looks_up_places_by_size_or_not_at_all():
    eye, aim = np.array([0.6, 0.0, 0.1]), np.array([0.2, 0.0, 0.5])
    camera = replace(CAMERA, table_from_cam=look_at(eye, aim))
    truth = np.array([0.3, 0.0, 0.42])
    frame = ball_frame(0, truth, 0.015, camera=camera)
    nowhere, _, _ = placed(without_depth(frame))
    assert np.all(np.isnan(nowhere))
    pos_m, sd_m, _ = placed(without_depth(frame), ball_radius_m=BALL)
    assert np.linalg.norm(pos_m - truth) <= 3.0 * sd_m


@pytest.mark.parametrize("text", ["red", "=0.02", "red=big", "red=0", "red=-1", "red=nan", "red=9"])
def test_radius_that_cannot_be_read_is_refused(text):
    with pytest.raises(ConfigError, match="ball_radius_m.*NAME=METRES"):
        structure(PerceptionConfig, {"ball_radius_m": [text]}, "apex.toml [perception]")


def test_radius_given_twice_is_refused():
    with pytest.raises(ConfigError, match="'red' is given twice"):
        PerceptionConfig(ball_radius_m=("red=0.02", "red=0.03"))


# --- depth that says little, or nothing ------------------------------------------------------


def up_camera():
    eye, aim = np.array([0.6, 0.0, 0.1]), np.array([0.2, 0.0, 0.5])
    return replace(CAMERA, table_from_cam=look_at(eye, aim))


@pytest.mark.parametrize("value", [0, 65535])
def test_no_valid_depth_and_no_plane_is_nowhere(value):
    frame = ball_frame(0, (0.3, 0.0, 0.42), 0.015, camera=up_camera())
    frame.depth_mm[:] = value
    pos_m, sd_m, radius_m = placed(frame)
    assert np.all(np.isnan(pos_m)) and np.isnan(sd_m) and np.isnan(radius_m)


@given(seed=st.integers(0, 2**31 - 1), share=st.floats(0.0, 1.0))
def test_random_depth_gives_a_finite_place_on_the_ray_or_none(seed, share):
    rng = np.random.RandomState(seed)
    frame = ball_frame(0, (0.2, 0.05, 0.015), 0.015)
    noise = rng.randint(0, 65536, frame.depth_mm.shape).astype(np.uint16)
    frame.depth_mm[:] = np.where(rng.uniform(size=noise.shape) < share, noise, frame.depth_mm)
    found, _ = perception(ball_radius_m=BALL).step(frame)
    for pos_m, sd_m, centre_px in zip(found.pos_m, found.pos_sd_m, found.centre_px):
        if np.isnan(sd_m):
            assert np.all(np.isnan(pos_m))
            continue
        ray = rays(CAMERA, centre_px[None])[0]
        reach_m = reach_of(pos_m)
        assert 0.0 < reach_m < 70.0 and sd_m > 0.0
        assert np.allclose(CAMERA.table_from_cam[:3, 3] + reach_m * ray, pos_m, atol=1e-6)


def test_range_ignores_holes_and_saturation():
    depth_mm = np.full((20, 30), 800, np.uint16)
    depth_mm[5:15, 5:15] = 1000
    depth_mm[5, 5:15], depth_mm[6, 5:15] = 0, 65535
    mask = np.zeros((20, 30), np.uint8)
    mask[5:15, 5:15] = 255
    found = range_of(mask, depth_mm)
    assert (found.median_m, found.spread_m, found.valid_share) == (1.0, 0.0, 0.8)
    assert range_of(np.ones((4, 4)), depth_mm, (20, 0)).median_m == 0.8


def test_range_spread_is_the_noise_sd():
    noise = np.random.RandomState(0).normal(1500.0, 12.0, (100, 100))
    found = range_of(np.ones((100, 100)), np.rint(noise).astype(np.uint16))
    assert found.spread_m == pytest.approx(0.012, rel=0.1)


@pytest.mark.parametrize("value", [0, 65535])
def test_range_of_nothing_valid_is_nan(value):
    found = range_of(np.ones((4, 4)), np.full((4, 4), value, np.uint16))
    assert np.isnan(found.median_m) and np.isnan(found.spread_m) and found.valid_share == 0.0
    assert np.isnan(range_of(np.zeros((4, 4)), np.full((4, 4), 500, np.uint16)).median_m)


@pytest.mark.parametrize(
    "mask, depth_mm",
    [
        (np.ones((4, 4)), np.full((4, 4), np.nan)),
        (np.ones((4, 4)), np.full((4, 4), 0.5, np.float32)),
        (np.ones((4, 4)), np.full((4, 4, 1), 500, np.uint16)),
        (np.ones((4, 4)), None),
        (np.ones((5, 4)), np.full((4, 4), 500, np.uint16)),
    ],
)
def test_range_of_something_else_than_depth_is_a_typed_error(mask, depth_mm):
    with pytest.raises(InputError):
        range_of(mask, depth_mm)


def test_piece_of_the_same_colour_far_behind_is_not_part_of_the_object():
    frame = ball_frame(0, (0.2, 0.0, 0.015), 0.015)
    plain, _ = perception().step(frame)
    x, y, w, _ = plain.box_px[0].astype(int)
    stripe = (slice(y - 12, y + 4), slice(x + w + 2, x + w + 7))
    frame.colour_bgr[stripe] = (40, 40, 200)
    joined, _ = perception().step(without_depth(frame))
    assert abs(joined.centre_px[0, 0] - plain.centre_px[0, 0]) > 0.5
    frame.depth_mm[stripe] = 2500
    told, _ = perception().step(frame)
    assert np.allclose(told.centre_px[0], plain.centre_px[0], atol=0.2)
    assert np.linalg.norm(told.pos_m[0] - plain.pos_m[0]) <= 0.001


# --- recorded depth in another unit ----------------------------------------------------------


def folder(path, unit=None, depth_mm=None):
    (path / "depth").mkdir()
    cv2.imwrite(str(path / "a.png"), np.zeros((4, 6, 3), np.uint8))
    raw = np.full((4, 6), 5000, np.uint16) if depth_mm is None else depth_mm
    cv2.imwrite(str(path / "depth" / "a.png"), raw)
    if unit is not None:
        (path / "depth" / "unit_m.txt").write_text(unit)
    with FolderCamera(CameraConfig(type="folder", path=str(path))) as camera:
        return camera.read(0.0)


@pytest.mark.parametrize("unit, mm", [(None, 5000), ("0.0002\n", 1000), ("0.001", 5000)])
def test_folder_says_the_unit_of_its_depth(tmp_path, unit, mm):
    assert np.all(folder(tmp_path, unit).depth_mm == mm)


@pytest.mark.parametrize("unit", ["", "5000 per metre", "0", "-0.001", "nan", "5000"])
def test_unit_that_cannot_be_read_is_refused(tmp_path, unit):
    with pytest.raises(RecordingError, match="unit_m.txt.*metres per count"):
        folder(tmp_path, unit)


# --- a real picture ------------------------------------------------------------------------


@pytest.fixture
def rgbd(real_data, tmp_path):
    """Return the truth and the frame of the RGB-D pair, read as a folder with its own unit."""
    source = real_data / "rgbd" / "tum"
    truth = json.loads((source / "truth.json").read_text())
    (tmp_path / "depth").mkdir()
    (tmp_path / "a.png").write_bytes((source / truth["colour"]).read_bytes())
    (tmp_path / "depth" / "a.png").write_bytes((source / truth["depth"]).read_bytes())
    (tmp_path / "depth" / "unit_m.txt").write_text(str(1.0 / truth["units_per_metre"]))
    with FolderCamera(CameraConfig(type="folder", path=str(tmp_path))) as camera:
        return truth, camera.read(0.0)


def test_real_depth_of_each_region_is_the_truth(rgbd):
    truth, frame = rgbd
    for name, ((x0, y0, x1, y1), median_m) in truth["rois_xyxy_median_m"].items():
        found = range_of(np.ones((y1 - y0, x1 - x0)), frame.depth_mm, (x0, y0))
        assert abs(found.median_m - median_m) <= truth["tol_m"], name
        assert found.valid_share > 0.9, name


def test_real_die_is_found_before_the_stripes_and_its_depth_is_right(rgbd):
    truth, frame = rgbd
    die = truth["yellow_die"]
    low, high = (np.array(limit) for limit in die["hsv_range"])
    x, y, w, h = die["bbox_xywh"]
    taught = cv2.inRange(cv2.cvtColor(frame.colour_bgr, cv2.COLOR_BGR2HSV), low, high)
    pixels = frame.colour_bgr[y : y + h, x : x + w][taught[y : y + h, x : x + w] > 0]
    table = ColourTable([model_from("die", features(pixels))])
    found, _ = Perception(PerceptionConfig(), table).step(frame)
    gaps_px = np.hypot(*(found.centre_px - die["centre"]).T)
    assert gaps_px.min() <= die["tol_px"]
    nearest = int(np.argmin(gaps_px))
    config = PerceptionConfig()
    whole = [(0, 0, frame.colour_bgr.shape[1], frame.colour_bgr.shape[0])]
    blob = min(
        blobs.find(frame.colour_bgr, table, whole, config),
        key=lambda b: np.hypot(*(np.array(b.centre_px) - found.centre_px[nearest])),
    )
    median_m = range_of(blob.core, frame.depth_mm, blob.origin_px).median_m
    expected_m = truth["rois_xyxy_median_m"]["yellow die"][1]
    assert abs(median_m / expected_m - 1.0) <= 0.015


def test_place_needs_no_stage():
    frame = ball_frame(0, (0.2, 0.05, 0.015), 0.015)
    table, config = ColourTable.builtin(), PerceptionConfig()
    windows = blobs.search(frame.colour_bgr, table, config)
    blob = blobs.find(frame.colour_bgr, table, blobs.union(windows), config)[0]
    at = depth.place(blob, frame.depth_mm, CAMERA, config)
    assert isinstance(frame, Frame) and np.linalg.norm(at.pos_m - (0.2, 0.05, 0.015)) <= 0.004
