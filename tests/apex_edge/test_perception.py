"""The perception stage on drawn pictures: what is found, where it is put, and what is said lost."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apex_edge.errors import InputError
from apex_edge.geometry import look_at, project, rays
from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.twin.palette import PALETTE, SURROUNDINGS
from apex_edge.types import CameraModel, Frame, TrackStatus

DT = 1.0 / 30.0
CAMERA = CameraModel(
    width_px=640,
    height_px=480,
    fx_px=560.0,
    fy_px=560.0,
    cx_px=319.5,
    cy_px=239.5,
    dist=np.zeros(5),
    table_from_cam=look_at(np.array([0.60, 0.0, 0.55]), np.array([0.20, 0.0, 0.0])),
)


def table_picture(seed=0, sd=4.0, shape=(480, 640)):
    picture = np.empty((*shape, 3))
    picture[:] = SURROUNDINGS["table"]
    return picture, np.random.RandomState(seed).normal(0.0, sd, picture.shape)


def disc(picture, name, x, y, r):
    """Draw a filled circle with 1/16 px precision and soft edges."""
    bgr = tuple(float(v) for v in PALETTE[name])
    centre = (int(round(x * 16)), int(round(y * 16)))
    cv2.circle(picture, centre, int(round(r * 16)), bgr, -1, cv2.LINE_AA, 4)


def frame(seq, things, t_s=None, seed=None, **extra):
    picture, noise = table_picture(seq if seed is None else seed)
    drawn = picture.astype(np.uint8)
    for name, x, y, r in things:
        disc(drawn, name, x, y, r)
    shown = np.clip(drawn + noise, 0, 255).astype(np.uint8)
    return Frame(seq, seq * DT if t_s is None else t_s, shown, **extra)


def perception(**settings):
    return Perception(PerceptionConfig(**settings), ColourTable.builtin())


def run(stage, frames):
    return [stage.step(f)[1] for f in frames]


# --- what is found -------------------------------------------------------------------------


def test_discs_are_found_with_sub_pixel_centres():
    things = [
        ("red", 100.3, 80.7, 14.0),
        ("green", 320.5, 240.2, 9.0),
        ("blue", 500.8, 400.1, 20.0),
    ]
    detections, _ = perception().step(frame(0, things))
    assert sorted(detections.name) == ["blue", "green", "red"]
    for name, x, y, r in things:
        i = detections.name.index(name)
        assert np.hypot(*(detections.centre_px[i] - (x, y))) <= 0.5
        assert abs(detections.area_px2[i] / (np.pi * r * r) - 1.0) <= 0.15
        assert np.allclose(detections.box_px[i], [x - r, y - r, 2 * r + 1, 2 * r + 1], atol=2.0)


def test_small_ball_is_found():
    detections, _ = perception().step(frame(0, [("orange", 300.0, 200.0, 4.5)]))
    assert detections.name == ("orange",)


def test_empty_table_shows_nothing():
    stage = perception()
    for seq in range(5):
        detections, tracks = stage.step(frame(seq, []))
        assert detections.name == () and tracks.name == ()
        assert tracks.pos_m.shape == (0, 3) and tracks.cov.shape == (0, 6, 6)


def test_specks_of_an_object_colour_are_not_objects():
    f = frame(0, [])
    rng = np.random.RandomState(0)
    f.colour_bgr[rng.randint(0, 480, 300), rng.randint(0, 640, 300)] = PALETTE["red"]
    assert perception().step(f)[0].name == ()


def test_thin_fringe_of_another_colour_is_not_an_object():
    f = frame(0, [("red", 300.0, 200.0, 20.0)])
    cv2.circle(f.colour_bgr, (300, 200), 20, PALETTE["purple"], 1)
    assert perception().step(f)[0].name == ("red",)


def test_highlight_inside_an_object_is_not_a_second_object():
    f = frame(0, [("orange", 300.0, 200.0, 22.0)])
    cv2.circle(f.colour_bgr, (303, 197), 4, PALETTE["yellow"], -1)
    detections, _ = perception().step(f)
    assert detections.name == ("orange",)
    assert np.hypot(*(detections.centre_px[0] - (300.0, 200.0))) <= 0.5


def test_ball_cut_by_the_picture_edge_is_flagged():
    detections, _ = perception().step(frame(0, [("red", 2.0, 200.0, 15.0), ("blue", 300, 200, 15)]))
    flags = dict(zip(detections.name, detections.touches_border))
    assert flags == {"red": True, "blue": False}


def test_everything_in_one_colour_is_no_object():
    picture = np.full((480, 640, 3), PALETTE["red"], dtype=np.uint8)
    assert perception().step(Frame(0, 0.0, picture))[0].name == ()


# --- where it is put -----------------------------------------------------------------------


def ball_frame(seq, centre, radius, depth_sd=0.002, hole_share=0.05, camera=CAMERA):
    """Draw one red ball with its true depth, by intersecting every pixel's ray with it."""
    height, width = camera.height_px, camera.width_px
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    ray = rays(camera, np.column_stack([columns.ravel(), rows.ravel()]))
    eye = camera.table_from_cam[:3, 3]
    to_centre = np.asarray(centre) - eye
    a, b = np.sum(ray * ray, axis=1), ray @ to_centre
    inside = b * b - a * (to_centre @ to_centre - radius**2)
    is_ball = inside > 0.0
    depth = -eye[2] / ray[:, 2]
    depth[is_ball] = (b[is_ball] - np.sqrt(inside[is_ball])) / a[is_ball]
    rng = np.random.RandomState(seq)
    measured = np.clip(1000.0 * (depth + rng.normal(0.0, depth_sd, depth.shape)), 0, 65000)
    measured[rng.uniform(size=depth.shape) < hole_share] = 0
    measured[rng.uniform(size=depth.shape) < hole_share] = 65535
    picture, noise = table_picture(seq)
    picture[is_ball.reshape(height, width)] = PALETTE["red"]
    shown = np.clip(picture + noise, 0, 255).astype(np.uint8)
    return Frame(seq, seq * DT, shown, measured.reshape(height, width).astype(np.uint16), camera)


@pytest.mark.parametrize("x, y", [(0.12, 0.0), (0.10, 0.12), (0.30, -0.15)])
def test_ball_is_placed_within_four_millimetres(x, y):
    detections, _ = perception().step(ball_frame(0, (x, y, 0.015), 0.015))
    assert np.linalg.norm(detections.pos_m[0] - (x, y, 0.015)) <= 0.004
    assert abs(detections.radius_m[0] - 0.015) <= 0.003
    assert 0.0005 <= detections.pos_sd_m[0] <= 0.004


def test_ball_held_above_the_table_is_placed_above_it():
    detections, _ = perception().step(ball_frame(0, (0.2, 0.0, 0.12), 0.015))
    assert np.linalg.norm(detections.pos_m[0] - (0.2, 0.0, 0.12)) <= 0.015


def test_ball_without_depth_is_placed_by_the_table_plane_and_less_surely():
    f = ball_frame(0, (0.2, 0.05, 0.015), 0.015)
    with_depth, _ = perception().step(f)
    without = Frame(f.seq, f.t_s, f.colour_bgr, None, f.camera)
    detections, _ = perception().step(without)
    assert np.linalg.norm(detections.pos_m[0] - (0.2, 0.05, 0.015)) <= 0.004
    assert detections.pos_sd_m[0] > 2.0 * with_depth.pos_sd_m[0]


@pytest.mark.parametrize("value", [0, 65535])
def test_depth_that_is_all_invalid_is_not_used(value):
    f = ball_frame(0, (0.2, 0.05, 0.015), 0.015)
    f.depth_mm[:] = value
    detections, _ = perception().step(f)
    assert np.linalg.norm(detections.pos_m[0] - (0.2, 0.05, 0.015)) <= 0.004


def test_without_calibration_only_pixels_are_reported():
    detections, tracks = perception().step(frame(0, [("red", 300, 200, 14)]))
    assert np.all(np.isnan(detections.pos_m)) and np.all(np.isnan(detections.radius_m))
    assert np.all(np.isnan(tracks.pos_m)) and np.all(np.isnan(tracks.cov))
    assert np.allclose(tracks.centre_px, [[300, 200]], atol=0.5)


def test_rolling_ball_gets_its_table_velocity():
    stage, truth = perception(), np.array([-0.10, 0.20, 0.0])
    for seq in range(12):
        where = np.array([0.3, -0.1, 0.015]) + truth * seq * DT
        _, tracks = stage.step(ball_frame(seq, where, 0.015))
    error = tracks.vel_m_s[0] - truth
    assert np.linalg.norm(error[:2]) <= 0.02
    assert np.all(np.abs(error) <= 4.0 * np.sqrt(np.diag(tracks.cov[0])[3:]))
    assert np.linalg.norm(tracks.pos_m[0] - where) <= 0.003
    assert tracks.n_samples[0] >= 10


# --- over time -----------------------------------------------------------------------------


def test_resting_object_keeps_one_identity_and_stands_still():
    frames = [ball_frame(seq, (0.14, 0.05, 0.015), 0.015) for seq in range(15)]
    found = run(perception(), frames)
    assert {tuple(t.track_id) for t in found} == {(1,)}
    assert np.linalg.norm(found[-1].vel_m_s[0]) <= 0.005


def test_short_occlusion_is_predicted_and_keeps_the_identity():
    def at(seq):
        return [] if 10 <= seq < 15 else [("red", 100.0 + 8.0 * seq, 200.0, 14.0)]

    found = run(perception(), [frame(seq, at(seq)) for seq in range(20)])
    statuses = [TrackStatus(int(t.status[0])) for t in found]
    assert statuses[9:16] == [TrackStatus.SEEN] + [TrackStatus.PREDICTED] * 5 + [TrackStatus.SEEN]
    assert {tuple(t.track_id) for t in found} == {(1,)}
    assert abs(found[14].centre_px[0, 0] - (100.0 + 8.0 * 14)) <= 3.0
    assert np.allclose(found[14].age_s, 5 * DT)


def test_lost_is_said_once_with_nothing_stale_and_then_dropped():
    frames = [frame(seq, [("red", 300, 200, 14)] if seq < 5 else []) for seq in range(20)]
    found = run(perception(), frames)
    lost = [i for i, t in enumerate(found) if TrackStatus.LOST in t.status]
    assert len(lost) == 1
    assert frames[lost[0]].t_s - frames[4].t_s == pytest.approx(0.25 + DT, abs=DT)
    assert np.all(np.isnan(found[lost[0]].centre_px))
    assert all(len(t.name) == 0 for t in found[lost[0] + 1 :])


def test_object_that_comes_back_after_being_lost_is_a_new_one():
    def at(seq):
        return [] if 5 <= seq < 20 else [("red", 300, 200, 14)]

    found = run(perception(), [frame(seq, at(seq)) for seq in range(24)])
    assert found[4].track_id.tolist() == [1]
    assert found[23].track_id.tolist() == [2]


def test_two_objects_of_one_colour_keep_their_identities_when_passing():
    def at(seq):
        return [("red", 100 + 12 * seq, 200, 13), ("red", 400 - 12 * seq, 250, 13)]

    found = run(perception(), [frame(seq, at(seq)) for seq in range(25)])
    assert {len(tracks.name) for tracks in found} == {2}
    start = dict(zip(found[0].track_id.tolist(), found[0].centre_px[:, 1]))
    end = dict(zip(found[-1].track_id.tolist(), found[-1].centre_px[:, 1]))
    assert all(abs(start[i] - end[i]) <= 2.0 for i in start)


def test_new_object_is_noticed_while_others_are_followed():
    def at(seq):
        return [("red", 200, 200, 14)] + ([("blue", 500, 400, 14)] if seq >= 7 else [])

    found = run(perception(search_every=3), [frame(seq, at(seq)) for seq in range(12)])
    first = next(i for i, t in enumerate(found) if "blue" in t.name)
    assert first <= 7 + 2


def test_object_that_leaps_out_of_its_window_is_found_again_at_once():
    frames = [frame(seq, [("red", 100, 100, 14)]) for seq in range(6)]
    frames.append(frame(6, [("red", 560, 420, 14)]))
    found = run(perception(search_every=1000), frames)
    seen = found[-1].status == TrackStatus.SEEN
    assert np.allclose(found[-1].centre_px[seen], [[560, 420]], atol=0.5)


def test_object_cut_in_two_stays_one_track():
    def picture(seq):
        f = frame(seq, [("red", 300, 200, 20)])
        if seq >= 6:
            f.colour_bgr[:, 296:305] = 60
        return f

    found = run(perception(), [picture(seq) for seq in range(12)])
    assert {tuple(t.track_id) for t in found} == {(1,)}


def test_repeated_frame_adds_no_sample():
    stage = perception()
    tracks = run(stage, [frame(seq, [("red", 300, 200, 14)]) for seq in range(6)])[-1]
    again = frame(6, [("red", 300, 200, 14)], seed=5, is_repeated=True)
    detections, repeated = stage.step(again)
    same_stamp = frame(7, [("red", 300, 200, 14)], t_s=again.t_s)
    _, stamped = stage.step(same_stamp)
    assert detections.name == ()
    assert repeated.n_samples.tolist() == stamped.n_samples.tolist() == tracks.n_samples.tolist()
    assert repeated.status.tolist() == [TrackStatus.PREDICTED]


def test_frozen_camera_loses_everything():
    stage = perception()
    run(stage, [frame(seq, [("red", 300, 200, 14)]) for seq in range(6)])
    found = run(
        stage, [frame(seq, [("red", 300, 200, 14)], is_repeated=True) for seq in range(6, 20)]
    )
    assert any(TrackStatus.LOST in t.status for t in found)
    assert found[-1].name == ()


def test_clock_that_runs_backwards_loses_all_tracks_and_starts_anew():
    stage = perception()
    run(stage, [frame(seq, [("red", 300, 200, 14)]) for seq in range(6)])
    _, tracks = stage.step(frame(6, [("red", 300, 200, 14)], t_s=0.01))
    assert tracks.status.tolist() == [TrackStatus.LOST, TrackStatus.SEEN]
    assert tracks.n_samples[1] == 1


def test_reset_forgets_all():
    stage = perception()
    run(stage, [frame(seq, [("red", 300, 200, 14)]) for seq in range(6)])
    stage.reset()
    _, tracks = stage.step(frame(0, []))
    assert tracks.name == ()


def test_same_frames_give_the_same_tracks():
    frames = [ball_frame(seq, (0.2, 0.01 * seq, 0.015), 0.015) for seq in range(6)]
    one, two = run(perception(), frames)[-1], run(perception(), frames)[-1]
    assert one.pos_m.tobytes() == two.pos_m.tobytes() and one.cov.tobytes() == two.cov.tobytes()


# --- bad input -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "bad",
    [
        Frame(1, 0.0, np.zeros((480, 640), np.uint8)),
        Frame(1, 0.0, np.zeros((0, 0, 3), np.uint8)),
        Frame(1, 0.0, np.zeros((480, 640, 3), np.float32)),
        Frame(1, float("nan"), np.zeros((480, 640, 3), np.uint8)),
        Frame(1, 0.0, np.zeros((480, 640, 3), np.uint8), np.zeros((240, 320), np.uint16)),
        Frame(1, 0.0, np.zeros((480, 640, 3), np.uint8), np.full((480, 640), np.nan)),
    ],
)
def test_unusable_frame_is_a_typed_error(bad):
    with pytest.raises(InputError, match="frame 1"):
        perception().step(bad)


@given(
    seed=st.integers(0, 2**31 - 1),
    shape=st.tuples(st.integers(3, 60), st.integers(3, 60)),
    has_depth=st.booleans(),
    steps=st.lists(st.floats(-0.1, 0.5), min_size=1, max_size=5),
)
@settings(max_examples=60, deadline=None)
def test_random_pictures_never_break_it(seed, shape, has_depth, steps):
    rng = np.random.RandomState(seed)
    stage, t = perception(min_area_px2=4.0), 0.0
    for seq, dt in enumerate(steps):
        t += dt
        patch = rng.randint(0, 256, (4, 4, 3)).astype(np.uint8)
        picture = cv2.resize(patch, shape, interpolation=cv2.INTER_NEAREST)
        depth = rng.randint(0, 65536, picture.shape[:2]).astype(np.uint16) if has_depth else None
        detections, tracks = stage.step(Frame(seq, t, picture, depth, CAMERA))
        live = tracks.status != TrackStatus.LOST
        assert np.all(np.isfinite(tracks.pos_m[live])) and np.all(np.isfinite(tracks.cov[live]))
        assert np.all(np.isnan(tracks.pos_m[~live]))
        assert np.all(detections.area_px2 >= 4.0)


def test_projection_of_a_placed_ball_is_its_blob():
    f = ball_frame(3, (0.15, -0.08, 0.015), 0.015)
    detections, _ = perception().step(f)
    pixels, _ = project(CAMERA, detections.pos_m)
    assert np.hypot(*(pixels[0] - detections.centre_px[0])) <= 0.2


def test_scrap_left_when_the_object_has_gone_is_not_the_object():
    stage = perception()
    run(stage, [frame(seq, [("orange", 300.0, 200.0, 38.0)]) for seq in range(10)])
    tracks = run(stage, [frame(seq, [("orange", 636.0, 250.0, 5.0)]) for seq in range(10, 40)])
    assert not any((t.status == TrackStatus.SEEN).any() for t in tracks)


def test_small_object_stays_itself_beside_a_large_one_of_its_colour():
    stage, small = perception(), ("orange", 500.0, 300.0, 6.0)
    run(stage, [frame(seq, [small]) for seq in range(10)])
    (track_id,) = stage.step(frame(10, [small]))[1].track_id
    both = run(
        stage, [frame(seq, [small, ("orange", 200.0, 200.0, 40.0)]) for seq in range(11, 30)]
    )
    alone = run(stage, [frame(seq, [small]) for seq in range(30, 50)])
    for tracks in both + alone:
        assert tracks.status[list(tracks.track_id).index(track_id)] == TrackStatus.SEEN
