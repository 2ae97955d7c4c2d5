"""The motion estimator against known paths."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apex_edge.perception.estimator import MotionRules
from apex_edge.perception.motion import MotionEstimator

DT = 1.0 / 30.0
PX = MotionRules(speed_sd=2000.0, acc_sd=600.0, stamp_sd_s=0.0)


def follow(points, sd=0.5, rules=PX, times=None):
    estimator = MotionEstimator(rules)
    times = np.arange(len(points)) * DT if times is None else times
    for t, point in zip(times, points):
        estimator.add(float(t), point, sd)
    return estimator


def line(n, velocity, noise, rng):
    t = np.arange(n)[:, None] * DT
    return t * np.asarray(velocity) + rng.normal(0.0, noise, (n, 2))


def errors(make_points, truth, n_trials=80, at=None):
    found, stated = [], []
    for seed in range(n_trials):
        points = make_points(np.random.RandomState(seed))
        estimator = follow(points)
        state = estimator.predict(estimator.last_t_s)
        found.append(state.v - truth)
        stated.append(np.sqrt(np.diag(state.cov)[2:]))
    return np.array(found), np.array(stated)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize("n", [5, 10, 20])
def test_steady_speed_is_near_the_cramer_rao_limit(n):
    truth = np.array([400.0, -100.0])
    found, _ = errors(lambda rng: line(n, truth, 0.5, rng), truth, 120)
    limit = 0.5 / DT * np.sqrt(12.0 / (n * (n * n - 1.0)))
    assert rms(found) <= 1.15 * limit


def test_position_now_is_better_than_one_sighting():
    truth = np.array([400.0, 0.0])
    misses = []
    for seed in range(80):
        rng = np.random.RandomState(seed)
        estimator = follow(line(15, truth, 0.5, rng))
        misses.append(estimator.predict(14 * DT).x - truth * 14 * DT)
    assert rms(misses) <= 0.4


def test_resting_object_has_no_speed_and_says_how_sure_it_is():
    found, stated = errors(lambda rng: line(20, (0.0, 0.0), 0.5, rng), np.zeros(2))
    assert rms(found) <= 1.0
    assert np.mean(np.abs(found) <= 2.0 * stated) >= 0.93
    assert np.median(stated) <= 3.0


def test_first_speed_comes_with_the_third_sighting():
    rng = np.random.RandomState(0)
    two = follow(line(2, (400.0, 0.0), 0.5, rng)).predict(DT)
    three = follow(line(3, (400.0, 0.0), 0.5, rng)).predict(2 * DT)
    assert np.all(two.v == 0.0) and np.sqrt(two.cov[2, 2]) >= 1000.0
    assert abs(three.v[0] - 400.0) <= 4.0 * np.sqrt(three.cov[2, 2]) <= 60.0


def test_outliers_do_not_disturb_the_speed():
    truth = np.array([400.0, 0.0])

    def points(rng):
        path = line(20, truth, 0.5, rng)
        hit = rng.uniform(size=20) < 0.05
        path[hit] += rng.choice([-40.0, 40.0], (int(hit.sum()), 2))
        return path

    # the last sighting may itself be the outlier: judged by what 95 % of the runs reach
    found, _ = errors(points, truth, 120)
    assert np.percentile(np.abs(found), 95.0) <= 3.0


def bounce(n_after):
    def points(rng):
        t = np.arange(10 + n_after) * DT
        kink = 9 * DT
        x = np.where(t <= kink, 400.0 * t, 800.0 * kink - 400.0 * t)
        return np.column_stack([x, 100.0 * t]) + rng.normal(0.0, 0.5, (len(t), 2))

    return points


def test_speed_is_right_100_ms_after_a_bounce():
    found, _ = errors(bounce(3), np.array([-400.0, 100.0]), 120)
    assert rms(found) <= 15.0


def test_bounce_is_flagged_while_it_is_young_and_not_later():
    young = follow(bounce(3)(np.random.RandomState(1)))
    old = follow(bounce(12)(np.random.RandomState(1)))
    before = follow(line(20, (400.0, 0.0), 0.5, np.random.RandomState(1)))
    assert young.is_manoeuvre
    assert not old.is_manoeuvre
    assert not before.is_manoeuvre


@pytest.mark.parametrize("phase", [0.1, 0.3, 0.5, 0.7])
def test_bounce_between_two_frames_is_no_parabola(phase):
    def points(rng):
        t = np.arange(14) * DT
        x = 400.0 * np.abs(t - (10 + phase) * DT)
        return np.column_stack([x, 100.0 * t]) + rng.normal(0.0, 0.5, (len(t), 2))

    found, _ = errors(points, np.array([400.0, 100.0]), 60)
    assert rms(found) <= 25.0


def test_outlier_in_a_young_track_is_dropped_again():
    truth = np.array([400.0, -100.0])
    for where in range(4):

        def points(rng, where=where):
            path = line(9, truth, 0.5, rng)
            path[where] += (40.0, -40.0)
            return path

        found, _ = errors(points, truth, 60)
        assert rms(found) <= 8.0


def test_gravity_is_remembered_over_a_bounce():
    def fall(t):
        # bounces every 0.4 s under 4000 px/s^2, as a ball close to a camera does
        within = np.mod(t, 0.4)
        return np.column_stack([100.0 * t, 2000.0 * within**2 - 800.0 * within])

    misses = []
    for seed in range(40):
        rng = np.random.RandomState(seed)
        estimator = MotionEstimator(PX._replace(curve_sd=3000.0))
        start_s = rng.uniform(0.0, 0.4)
        for i in range(40):
            t_s = start_s + i * DT
            if np.mod(t_s, 0.4) > 4.2 * DT and i > 20:
                misses.append(estimator.predict(t_s).x - fall(np.array([t_s]))[0])
            estimator.add(t_s, fall(np.array([t_s]))[0] + rng.normal(0.0, 0.5, 2), 0.5)
    # a line through three of them is off by 1.7 a dt^2 = 7.5 px one frame on
    assert rms(misses) <= 3.0


def test_first_miss_is_doubted_and_an_outlier_forgotten_again():
    estimator = follow(line(12, (400.0, 0.0), 0.5, np.random.RandomState(0)))
    sure = np.sqrt(estimator.predict(11 * DT).cov[0, 0])
    estimator.add(12 * DT, np.array([400.0 * 12 * DT + 40.0, 0.0]), 0.5)
    doubt = np.sqrt(estimator.predict(12 * DT).cov[0, 0])
    estimator.add(13 * DT, np.array([400.0 * 13 * DT, 0.0]), 0.5)
    again = np.sqrt(estimator.predict(13 * DT).cov[0, 0])
    assert doubt >= 15.0 and again <= 3.0 * sure


def test_noise_smaller_than_stated_is_said_so():
    estimator = follow(line(30, (50.0, 20.0), 0.05, np.random.RandomState(0)))
    assert 0.025 <= estimator.noise_sd(0.5) <= 0.12
    assert follow(line(4, (50.0, 20.0), 0.05, np.random.RandomState(0))).noise_sd(0.5) == 0.5


def test_sightings_that_disagree_with_their_noise_widen_the_covariance():
    def sd(wobble):
        rng = np.random.RandomState(3)
        path = line(40, (50.0, 20.0), 0.5, rng)
        # slower than the noise is looked for, so that only the innovations can tell
        path[:, 0] += wobble * np.sin(np.arange(40) * 1.3)
        return float(np.sqrt(follow(path).predict(39 * DT).cov[0, 0]))

    assert sd(6.0) >= 3.0 * sd(0.0)


def test_curved_path_gives_acceleration_and_the_slope_at_its_end():
    def points(rng):
        t = np.arange(15) * DT
        path = np.column_stack([400.0 * t - 300.0 * t * t, 50.0 * t])
        return path + rng.normal(0.0, 0.5, (15, 2))

    end = 400.0 - 600.0 * 14 * DT
    found, stated = errors(points, np.array([end, 50.0]))
    assert rms(found) <= 8.0
    acc = [follow(points(np.random.RandomState(s))).predict(14 * DT).a[0] for s in range(50)]
    assert abs(np.mean(acc) + 600.0) <= 60.0


def test_gap_clears_what_was_before():
    rng = np.random.RandomState(0)
    estimator = follow(line(10, (400.0, 0.0), 0.5, rng))
    estimator.add(9 * DT + 0.3, np.array([900.0, 0.0]), 0.5)
    assert estimator.n_samples == 1
    state = estimator.predict(9 * DT + 0.3)
    assert np.allclose(state.x, [900.0, 0.0])
    assert np.all(state.v == 0.0)


def test_sighting_that_is_not_newer_is_ignored():
    estimator = follow(line(6, (400.0, 0.0), 0.1, np.random.RandomState(0)))
    before = estimator.predict(5 * DT)
    estimator.add(5 * DT, np.array([0.0, 0.0]), 0.5)
    estimator.add(2 * DT, np.array([0.0, 0.0]), 0.5)
    after = estimator.predict(5 * DT)
    assert estimator.n_samples == 6
    assert np.array_equal(before.x, after.x)


def test_uncertainty_grows_while_unseen():
    estimator = follow(line(10, (400.0, 0.0), 0.5, np.random.RandomState(0)))
    sds = [np.sqrt(estimator.predict(9 * DT + wait).cov[0, 0]) for wait in (0.0, 0.05, 0.1, 0.25)]
    assert sds == sorted(sds) and sds[-1] > 10.0 * sds[0]


def test_smooth_is_the_mean_of_the_last_five():
    points = np.array([[float(i * i), -float(i)] for i in range(8)])
    assert np.allclose(follow(points).smooth(), points[-5:].mean(axis=0))


def test_irregular_stamps_do_not_bias_the_speed():
    rng = np.random.RandomState(5)
    times = np.cumsum(rng.choice([DT, 2 * DT, 3 * DT], 15))
    points = np.column_stack([400.0 * times, 0.0 * times]) + rng.normal(0, 0.2, (15, 2))
    state = follow(points, times=times).predict(times[-1])
    assert abs(state.v[0] - 400.0) <= 3.0


def test_one_step_innovations_fit_the_stated_covariance():
    ratios = []
    for seed in range(30):
        path = line(40, (200.0, 80.0), 0.5, np.random.RandomState(seed))
        estimator = MotionEstimator(PX)
        for i, point in enumerate(path):
            if i >= 10:
                state = estimator.predict(i * DT)
                gap = point - state.x
                ratios.append(float(np.sum(gap**2 / (np.diag(state.cov)[:2] + 0.25))))
            estimator.add(i * DT, point, 0.5)
    assert 1.2 <= np.mean(ratios) <= 2.4  # 2 when perfectly calibrated


@given(st.lists(st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)), min_size=1, max_size=40))
@settings(max_examples=60, deadline=None)
def test_any_sightings_give_a_finite_state_with_a_valid_covariance(points):
    estimator = follow(np.array(points))
    state = estimator.predict(estimator.last_t_s + 0.1)
    assert np.all(np.isfinite(state.x)) and np.all(np.isfinite(state.v))
    assert np.linalg.eigvalsh(state.cov).min() > -1e-6 * np.abs(state.cov).max()
    assert 1 <= estimator.n_samples <= PX.window


def test_asking_before_the_first_sighting_is_an_error():
    with pytest.raises(ValueError):
        MotionEstimator(PX).predict(0.0)
