import numpy as np
import pytest

from offline_train.scenes import committed, tabletop_cv
from offline_train.scenes.truth import LOOK_AHEAD_S, first_contact, passing, scenario
from offline_train.trigger import seeds

FRAME_S = 0.05


def times(n_frames):
    return np.arange(n_frames) * FRAME_S


@pytest.fixture(scope="module")
def uniform():
    return tabletop_cv.draw(seeds.rng("train", 1), np.full(1500, FRAME_S), 20)


@pytest.fixture(scope="module")
def moves():
    return committed.draw_moves(seeds.rng("train", 1), 400)


@pytest.fixture(scope="module")
def hands_and_balls():
    return committed.draw(seeds.rng("train", 1), np.full(400, FRAME_S), 160)


def kind(truth, name):
    return truth.kind == committed.KINDS.index(name)


@pytest.mark.parametrize("module", [tabletop_cv, committed])
def test_a_scenario_is_found_by_its_name_and_is_repeatable(module):
    assert scenario(module.NAME) is module
    one, same, other = (
        module.draw(seeds.rng("train", seed), np.full(20, FRAME_S), 30) for seed in (1, 1, 2)
    )
    assert np.array_equal(one.other_m, same.other_m)
    assert np.array_equal(one.contact_s, same.contact_s)
    assert not np.array_equal(one.other_m, other.other_m)
    assert one.kind.shape == (20, 4) and one.other_m.shape == (20, 4, 30, 2)


def test_uniform_motion_is_uniform_and_one_in_seven_rests(uniform):
    step = np.diff(uniform.other_m, axis=2)
    assert np.allclose(step, step[:, :, :1], atol=1e-12)
    speed = np.linalg.norm(step[:, :, 0], axis=2) / FRAME_S
    is_still = uniform.kind == tabletop_cv.STILL
    assert is_still.mean() == pytest.approx(0.15, abs=0.02)
    assert np.all(speed[is_still] == 0.0)
    assert speed[~is_still].min() >= 0.015 - 1e-9 and speed.max() <= 0.4 + 1e-9


def test_the_share_of_pairs_that_touch_is_that_of_the_study(uniform):
    left = uniform.contact_s - times(20)[-1]
    is_open = left > 0.0
    assert np.mean(left[is_open] <= 5.0) == pytest.approx(0.128, abs=0.012)


def test_the_exact_contact_is_the_one_found_by_stepping(uniform):
    start, step = uniform.other_m[:, :, 0], np.diff(uniform.other_m[:, :, :2], axis=2)[:, :, 0]
    centre, drift = uniform.centre_m[:, 0], np.diff(uniform.centre_m[:, :2], axis=1)[:, 0]

    def place(t_s):
        frames = t_s[..., None] / FRAME_S
        other = start.reshape(-1, 1, 2) + frames * step.reshape(-1, 1, 2)
        middle = (
            np.repeat(centre, 4, axis=0)[:, None] + frames * np.repeat(drift, 4, axis=0)[:, None]
        )
        return other, middle

    until = 0.95 + LOOK_AHEAD_S
    stepped = first_contact(place, uniform.radius_m.ravel(), until)
    exact = uniform.contact_s.ravel()
    both = np.isfinite(stepped) & np.isfinite(exact)
    assert both.sum() > 500
    late = stepped[both] - exact[both]
    assert np.all(late > -1e-9) and np.all(late < 0.0101)
    # stepping misses a grazing contact shorter than its step, and the end of the watch
    assert np.mean(np.isfinite(stepped) != np.isfinite(exact)) < 0.003


def test_a_moving_centre_counts_in_the_contact():
    offset, still = np.array([[0.2, 0.0]]), np.zeros((1, 2))
    assert np.isinf(tabletop_cv.entry_s(offset, still))
    assert tabletop_cv.entry_s(offset, still - [[0.1, 0.0]])[0] == pytest.approx(1.55)
    assert tabletop_cv.entry_s(0.1 * offset, still)[0] == 0.0
    assert np.isinf(tabletop_cv.entry_s(offset, np.array([[0.1, 0.0]])))


def test_kinds_say_what_came_of_the_motion(hands_and_balls):
    truth = hands_and_balls
    is_hit = kind(truth, "hand hit") | kind(truth, "ball hit")
    moves = ~kind(truth, "static")  # a centre that drifts may run into a static body
    assert np.array_equal(is_hit[moves], np.isfinite(truth.contact_s)[moves])
    assert not is_hit[~moves].any()
    nearest = np.linalg.norm(truth.other_m - truth.centre_m[:, None], axis=3).min(axis=2)
    for name in ("hand near miss", "ball near miss"):
        # within the watch, or just after it
        assert np.quantile(nearest[kind(truth, name)], 0.9) < 0.09
        assert np.all(nearest[kind(truth, name)] > truth.radius_m[kind(truth, name)])
    for name in ("hand far", "ball far"):
        assert np.all(nearest[kind(truth, name)] >= 0.09)
    assert np.all([np.any(kind(truth, name)) for name in committed.KINDS])


def test_static_bodies_never_move_and_hands_come_to_rest(hands_and_balls, moves):
    step = np.linalg.norm(np.diff(hands_and_balls.other_m, axis=2), axis=3)
    assert np.all(step[kind(hands_and_balls, "static")] == 0.0)
    hands = moves.take(~moves.is_ball & ~moves.is_still)
    end = (hands.t_start_s + hands.duration_s)[:, None]
    before, at, after = (
        committed.place(hands, when)[0][:, 0] for when in (0.0 * end, end, end + 2.0)
    )
    assert np.allclose(before, hands.start_m)
    assert np.allclose(at, after)
    assert np.allclose(np.linalg.norm(at - before, axis=1), hands.length_m)


def test_balls_only_slow_down(moves):
    balls = moves.take(moves.is_ball)
    when = balls.t_start_s[:, None] + np.linspace(0.0, 8.0, 100)
    step = np.linalg.norm(np.diff(committed.place(balls, when)[0], axis=1), axis=2)
    assert np.all(np.diff(step, axis=1) <= 1e-9)


def test_one_moving_frame_in_nine_comes_before_a_contact(hands_and_balls):
    truth, time = hands_and_balls, times(160)
    moved = np.linalg.norm(truth.other_m[:, :, 10:] - truth.other_m[:, :, :-10], axis=3)
    left = truth.contact_s[:, :, None] - time[10:]
    is_row = (moved > 0.015) & (left > 0.0)
    assert np.mean(left[is_row] <= 5.0) == pytest.approx(0.11, abs=0.02)


def test_passing_finds_contact_and_nearest_distance():
    def place(t_s):
        x = t_s - 1.0
        return np.stack([x, np.full_like(x, 0.05)], axis=-1), np.zeros((*x.shape, 2))

    for radius, expected in ((0.04, np.inf), (0.1, 1.0 - np.sqrt(0.01 - 0.0025))):
        contact, nearest = passing(place, np.array([radius]), 3.0)
        assert nearest[0] == pytest.approx(0.05)
        assert contact[0] == pytest.approx(expected, abs=0.01) or contact[0] == expected
