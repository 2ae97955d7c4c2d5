"""Several objects of one colour: touching, crossing, covered, and up to fifty of them."""

import cv2
import numpy as np
import pytest
from test_perception import CAMERA, DT, PALETTE, ball_frame, disc, frame, perception

from apex_edge.geometry import project
from apex_edge.perception.matching import match
from apex_edge.types import Frame, TrackStatus


def crossing(paths, n_frames, radius, seed=0, **settings):
    """Follow green discs on paths (functions of time), the later ones drawn over the earlier."""
    stage, log = perception(**settings), []
    for seq in range(n_frames):
        things = [("green", *path(seq * DT), radius) for path in paths]
        log.append(stage.step(frame(seq, things, seed=1000 * seed + seq))[1])
    return log


def owners(log, paths, radius):
    """Return per path the track ids seen at its place, and the RMS distance to it."""
    ids, gaps = [[] for _ in paths], []
    for seq, tracks in enumerate(log):
        is_seen = tracks.status == TrackStatus.SEEN
        for path, own in zip(paths, ids):
            away = np.hypot(*(tracks.centre_px[is_seen] - np.array(path(seq * DT))).T)
            if len(away) and away.min() < 0.8 * radius:
                own.append(int(tracks.track_id[is_seen][np.argmin(away)]))
                gaps.append(away.min())
    return ids, float(np.sqrt(np.mean(np.square(gaps))))


@pytest.mark.parametrize(
    "speed, other, angle_deg, offset",
    [
        (120.0, 110.0, 180.0, 0.2),
        (70.0, 90.0, 90.0, 0.0),
        (100.0, 60.0, 150.0, -0.5),
        (150.0, 140.0, 60.0, 0.4),
    ],
)
def test_two_balls_of_one_colour_keep_their_names_through_a_crossing(
    speed, other, angle_deg, offset
):
    radius, turn = 13.0, np.deg2rad(angle_deg)

    def first(t):
        return 320.0 + speed * (t - 1.0), 240.0 + offset * radius

    def second(t):
        return 320.0 + other * np.cos(turn) * (t - 1.0), 240.0 + other * np.sin(turn) * (t - 1.0)

    ids, rms_px = owners(crossing([first, second], 60, radius), [first, second], radius)
    assert [len(set(own)) for own in ids] == [1, 1]
    assert ids[0][0] != ids[1][0]
    assert all(len(own) >= 48 for own in ids)
    assert rms_px <= 0.6


def test_touching_balls_are_two_with_their_own_centres():
    radius = 14.0

    def still(t):
        return 300.0, 240.0

    def comes(t):
        return 300.0 + max(2.0 * radius - 2.0, 100.0 - 150.0 * t), 240.0

    log = crossing([still, comes], 30, radius)
    ids, rms_px = owners(log, [still, comes], radius)
    assert [len(set(own)) for own in ids] == [1, 1]
    assert all(len(own) == 30 for own in ids)
    assert rms_px <= 0.8


def test_ball_behind_another_is_predicted_and_not_made_up():
    radius = 14.0

    def behind(t):
        return 320.0 + 60.0 * (t - 1.0), 240.0

    def front(t):
        return 320.0 - 60.0 * (t - 1.0), 240.0

    log = crossing([behind, front], 60, radius)
    met = log[30]
    assert np.all(met.status == TrackStatus.PREDICTED) and len(met.name) == 2
    ids, _ = owners(log, [behind, front], radius)
    assert [len(set(own)) for own in ids] == [1, 1]


def test_two_pieces_of_one_still_object_become_one_again():
    stage = perception()
    for seq in range(30):
        f = frame(seq, [("red", 300.0, 240.0, 40.0)])
        if seq < 15:
            # a bar in front cuts the disc in two, the smaller piece large enough to be an object
            f.colour_bgr[:, 296:330] = (60, 60, 60)
        _, tracks = stage.step(f)
    assert list(tracks.status) == [TrackStatus.SEEN]
    assert np.hypot(*(tracks.centre_px[0] - (300.0, 240.0))) <= 1.0


def test_ghost_of_a_missed_track_does_not_hide_the_object_found_now():
    stage = perception()
    for seq in range(10):
        stage.step(frame(seq, [("green", 300.0, 200.0, 20.0)]))
    seen = []
    for seq in range(10, 30):
        # gone in one frame, and elsewhere at once: a new object, then back at the old place
        x = 420.0 if seq < 14 else 300.0
        _, tracks = stage.step(frame(seq, [("green", x, 200.0, 20.0)]))
        is_seen = tracks.status == TrackStatus.SEEN
        seen.append([round(float(c)) for c in tracks.centre_px[is_seen, 0]])
    assert all(len(centres) == 1 for centres in seen)


def test_covered_part_does_not_shift_a_ball_whose_size_is_known():
    stage, centre = perception(), (0.20, 0.0, 0.03)
    x, y = project(CAMERA, np.array([centre]))[0][0]
    for seq in range(25):
        f = ball_frame(seq, centre, 0.03)
        if seq >= 12:
            f.colour_bgr[:, int(x) + 8 :] = (60, 60, 60)  # a third of the ball
        detections, tracks = stage.step(f)
    assert detections.is_part[0]
    assert np.hypot(*(tracks.centre_px[0] - (x, y))) <= 1.0
    assert np.linalg.norm(tracks.pos_m[0] - centre) <= 0.004


def test_ball_that_only_goes_away_is_not_taken_for_a_covered_one():
    stage = perception()
    for seq in range(25):
        detections, _ = stage.step(frame(seq, [("green", 300.0, 240.0, 30.0 - 0.8 * seq)]))
        assert not detections.is_part[0]


def test_covered_block_is_less_believed_than_a_whole_one():
    def sd_after(is_covered):
        stage = perception()
        for seq in range(25):
            f = frame(seq, [])
            cv2.rectangle(f.colour_bgr, (270, 220), (330, 260), PALETTE["red"], -1)
            if is_covered and seq >= 12:
                f.colour_bgr[:, 296:] = (60, 60, 60)
            stage.step(f)
        (track,) = stage._tracker._tracks
        return track.pos_sd

    assert sd_after(True) >= 8.0 * sd_after(False)


def test_smeared_ball_is_flagged_and_a_long_still_block_is_not():
    stage, flags = perception(), []
    for seq in range(20):
        f = frame(seq, [])
        cv2.rectangle(f.colour_bgr, (100, 300), (180, 320), PALETTE["red"], -1)
        x = 200.0 + 3.0 * seq if seq < 12 else 233.0 + 20.0 * (seq - 11)
        for part in np.linspace(-0.5, 0.5, 9) * (0.0 if seq < 12 else 20.0):
            disc(f.colour_bgr, "green", x + part, 200.0, 10.0)
        _, tracks = stage.step(f)
        flags.append(dict(zip(tracks.name, tracks.is_blurred)))
    assert not any(f["red"] for f in flags)
    assert not any(f["green"] for f in flags[:12])
    assert all(f["green"] for f in flags[14:])


def test_sighting_of_quite_another_size_is_not_the_same_object():
    stage = perception()
    for seq in range(10):
        stage.step(frame(seq, [("green", 300.0, 240.0, 10.0)]))
    _, tracks = stage.step(frame(10, [("green", 305.0, 240.0, 40.0)]))
    sizes = dict(zip(tracks.track_id, tracks.status))
    assert sizes[1] != TrackStatus.SEEN


def test_fifty_objects_are_followed_each_under_its_own_name():
    stage, n = perception(), 50
    place = np.array([(60 + 58 * (i % 10), 60 + 85 * (i // 10)) for i in range(n)], dtype=float)
    names = ["red", "green", "blue", "orange", "purple"]
    for seq in range(12):
        at = place + 1.5 * seq * np.array([(1.0, 0.0) if i % 2 else (0.0, 1.0) for i in range(n)])
        things = [(names[i % 5], *at[i], 9.0) for i in range(n)]
        _, tracks = stage.step(frame(seq, things))
    assert len(tracks.name) == n
    assert np.all(tracks.status == TrackStatus.SEEN)
    gaps = np.linalg.norm(tracks.centre_px[:, None] - at[None], axis=2)
    assert sorted(np.argmin(gaps, axis=1).tolist()) == list(range(n))
    assert gaps.min(axis=1).max() <= 0.5
    assert tracks.track_id.max() == n


def test_object_that_leaves_and_comes_back_later_is_a_new_one():
    stage, ids = perception(), set()
    for seq in range(60):
        things = [] if 20 <= seq < 45 else [("green", 300.0, 240.0, 12.0)]
        _, tracks = stage.step(frame(seq, things))
        ids |= set(tracks.track_id[tracks.status == TrackStatus.SEEN].tolist())
    assert len(ids) == 2


def test_matching_prefers_the_least_total_gap_over_the_nearest_pair():
    gaps = np.array([[1.0, 2.0], [2.5, 9.0]])
    assert match(gaps, np.full(2, 10.0), np.zeros(2, bool)) == {0: 1, 1: 0}


def test_matching_never_uses_a_pair_outside_its_gate_or_twice():
    gaps = np.array([[1.0, np.inf, 30.0], [1.5, np.inf, 40.0]])
    assert match(gaps, np.full(2, 10.0), np.zeros(2, bool)) == {0: 0}


def test_track_out_of_sight_chooses_last():
    gaps = np.array([[1.0], [5.0]])
    assert match(gaps, np.full(2, 10.0), np.array([True, False])) == {1: 0}


def test_paper_mode_is_two_frames_late_and_needs_ten_sightings():
    late = {}
    for mode in ("adaptive", "paper"):
        stage = perception(motion=mode)
        for seq in range(14):
            _, tracks = stage.step(frame(seq, [("green", 100.0 + 13.0 * seq, 200.0, 10.0)]))
        state = stage._tracker._tracks[0].motion.predict(13 * DT)
        late[mode] = (100.0 + 13.0 * 13) - state.x[0]
        assert abs(state.v[0] - 390.0) <= 12.0
    assert abs(late["adaptive"]) <= 0.5
    assert abs(late["paper"] - 26.0) <= 0.5


def test_frame_without_any_coloured_pixel_gives_no_detection_in_any_light():
    for level in (0, 40, 128, 255):
        picture = np.full((240, 320, 3), level, dtype=np.uint8)
        detections, tracks = perception().step(Frame(0, 0.0, picture))
        assert detections.name == () and tracks.name == ()
