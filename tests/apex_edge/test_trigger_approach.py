import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apex_edge.triggers.approach import Pairs, closest, early_contact, first_contact
from apex_edge.triggers.base import proven_decel
from apex_edge.triggers.features import FEATURE_NAMES, FEATURE_UNITS, edge_features

HORIZON_S = 5.0


def pairs(offset, mover=(0.0, 0.0), target=(0.0, 0.0), radius=0.03, decel=0.0, cov=None):
    offset = np.atleast_2d(np.asarray(offset, dtype=float))
    n, d = offset.shape
    return Pairs(
        offset_m=offset,
        mover_vel_m_s=np.broadcast_to(np.asarray(mover, dtype=float), (n, d)).copy(),
        target_vel_m_s=np.broadcast_to(np.asarray(target, dtype=float), (n, d)).copy(),
        decel_m_s2=np.broadcast_to(np.asarray(decel, dtype=float), (n,)).copy(),
        radius_m=np.broadcast_to(np.asarray(radius, dtype=float), (n,)).copy(),
        cov=np.zeros((n, 2 * d, 2 * d)) if cov is None else np.broadcast_to(cov, (n, 2 * d, 2 * d)),
    )


def contact(case, horizon_s=HORIZON_S):
    """Return the time to contact of each pair."""
    return first_contact(case, closest(case, horizon_s), horizon_s)


def stepped(case, step_s=0.001):
    """Walk both bodies in small steps: smallest distance, its time, first contact."""
    mover, target = np.zeros(case.offset_m.shape[1]), case.offset_m[0].copy()
    velocity = case.mover_vel_m_s[0].copy()
    best, when, touch = np.inf, 0.0, np.inf
    for i in range(int(HORIZON_S / step_s) + 1):
        gap = np.sqrt(((target - mover) ** 2).sum())
        if gap < best:
            best, when = gap, i * step_s
        if gap <= case.radius_m[0] and touch == np.inf:
            touch = i * step_s
        speed = np.sqrt((velocity**2).sum())
        slower = max(0.0, speed - case.decel_m_s2[0] * step_s)
        ahead = velocity * (slower / speed) if speed > 0 else velocity
        mover, velocity = mover + 0.5 * (velocity + ahead) * step_s, ahead
        target = target + case.target_vel_m_s[0] * step_s
    return best, when, touch


metre = st.floats(-0.5, 0.5)
speed = st.floats(-0.3, 0.3)


@settings(max_examples=40)
@given(
    st.tuples(metre, metre),
    st.tuples(speed, speed),
    st.tuples(speed, speed),
    st.sampled_from([0.0, 0.01, 0.05, 0.3]),
)
def test_closest_approach_agrees_with_walking_there(offset, mover, target, decel):
    case = pairs(offset, mover, target, decel=decel)
    found = closest(case, HORIZON_S)
    ttc = contact(case)[0]
    best, _, touch = stepped(case)
    # chords of a slowing path with a moving target are off by up to 1 mm, steps by half of one
    assert found.dca_m[0] == pytest.approx(best, abs=2.5e-3 if decel else 1e-3)
    assert 0.0 <= found.tca_s[0] <= HORIZON_S
    if best < case.radius_m[0] - 3e-3:
        assert np.isfinite(ttc)
        assert ttc <= found.tca_s[0] + 1e-9
    if best > case.radius_m[0] + 3e-3:
        assert ttc == np.inf
    if not decel and touch < np.inf and ttc < np.inf:
        where = case.offset_m[0] + (case.target_vel_m_s[0] - case.mover_vel_m_s[0]) * ttc
        gap = np.linalg.norm(where)
        assert gap == pytest.approx(case.radius_m[0], abs=1e-6) or ttc == 0.0


def test_head_on_contact_is_when_the_edges_meet():
    case = pairs([0.33, 0.0], [0.1, 0.0], radius=0.03)
    found = closest(case, HORIZON_S)
    assert contact(case)[0] == pytest.approx(3.0)
    assert found.dca_m[0] == pytest.approx(0.0, abs=1e-12)
    assert found.tca_s[0] == pytest.approx(3.3)


def test_a_ball_that_rolls_out_before_the_target_is_no_hazard():
    # rests after v^2 / 2a = 0.2 m, 0.1 m before the target's edge
    case = pairs([0.33, 0.0], [0.2, 0.0], decel=0.1)
    stops = closest(case, HORIZON_S)
    assert contact(case)[0] == np.inf
    assert stops.dca_m[0] == pytest.approx(0.13)
    assert stops.tca_s[0] == pytest.approx(2.0)
    assert np.isfinite(contact(pairs([0.33, 0.0], [0.2, 0.0]))[0])


def test_a_slowing_ball_arrives_later_than_a_steady_one_but_at_the_true_time():
    # 0.3 m = 0.2 t - 0.025 t^2 at t = 2 s
    assert contact(pairs([0.33, 0.0], [0.2, 0.0], decel=0.05))[0] == pytest.approx(2.0, abs=0.01)


def test_a_target_runs_into_a_mover_that_came_to_rest():
    # the mover rests after 0.05 m; the target covers the other 0.32 m at 0.05 m/s
    case = pairs([0.4, 0.0], [0.1, 0.0], [-0.05, 0.0], decel=0.1)
    assert contact(case)[0] == np.inf
    assert contact(case, 8.0)[0] == pytest.approx(6.4)


@pytest.mark.parametrize("offset", [[0.0, 0.0], [0.02, 0.0]])
def test_what_touches_now_has_no_time_left(offset):
    assert contact(pairs(offset))[0] == 0.0


def test_nothing_moving_means_no_contact_and_no_warning():
    case = pairs([[0.2, 0.0], [0.0, 0.0]])
    assert contact(case).tolist() == [np.inf, 0.0]
    assert closest(case, HORIZON_S).tca_s.tolist() == [0.0, 0.0]


def test_a_row_that_is_not_a_number_harms_no_other_row():
    case = pairs([[np.nan, 0.0], [0.33, 0.0]], [0.1, 0.0])
    with np.errstate(all="raise", invalid="ignore"):
        found, ttc = closest(case, HORIZON_S), contact(case)
    assert np.isnan(found.dca_m[0])
    assert ttc[0] == np.inf
    assert ttc[1] == pytest.approx(3.0)


def test_no_pairs_give_no_answers():
    case = pairs(np.zeros((0, 2)))
    found = closest(case, HORIZON_S)
    assert found.dca_m.shape == contact(case).shape == (0,)
    assert early_contact(case, found, HORIZON_S).shape == (0,)
    assert edge_features(case, found, HORIZON_S).shape == (0, 12)


def test_geometry_holds_in_three_dimensions():
    case = pairs([0.3, 0.0, 0.04], [0.1, 0.0, 0.0], (0.0, 0.0, 0.0))
    assert closest(case, HORIZON_S).dca_m[0] == pytest.approx(0.04)
    assert contact(case)[0] == np.inf


def noisy(n=20000):
    """Return a believed pair and n draws of what might be true, from the same covariance."""
    sd = np.array([0.002, 0.002, 0.004, 0.004])
    mixing = np.eye(4)
    mixing[2, 0] = mixing[3, 1] = 0.6
    root = mixing * sd[:, None]
    draws = np.random.RandomState(4).normal(size=(n, 4)) @ root.T
    return root @ root.T, draws


def test_the_sd_of_the_miss_agrees_with_monte_carlo():
    cov, draws = noisy()
    believed = pairs([0.3, 0.02], [0.1, 0.0], cov=cov)
    true = pairs(believed.offset_m[0] + draws[:, :2], believed.mover_vel_m_s[0] - draws[:, 2:])
    heading = true.mover_vel_m_s / np.linalg.norm(true.mover_vel_m_s, axis=1, keepdims=True)
    miss = heading[:, 0] * true.offset_m[:, 1] - heading[:, 1] * true.offset_m[:, 0]
    assert closest(believed, HORIZON_S).miss_sd_m[0] == pytest.approx(miss.std(), rel=0.03)


@pytest.mark.parametrize("lateral", [0.0, 0.02])
def test_contact_is_earlier_than_the_pessimistic_time_in_few_cases(lateral):
    cov, draws = noisy()
    believed = pairs([0.3, lateral], [0.1, 0.0], cov=cov)
    early = early_contact(believed, closest(believed, HORIZON_S), HORIZON_S)[0]
    true = pairs(believed.offset_m[0] + draws[:, :2], believed.mover_vel_m_s[0] - draws[:, 2:])
    ttc = contact(true)
    assert np.mean(ttc < early) < 0.05
    # pessimistic, but not by more than a few sd of the arrival time
    assert early > 0.7 * np.median(ttc[np.isfinite(ttc)])


def test_the_pessimistic_time_comes_first_and_without_noise_is_the_time_itself():
    sure = pairs([0.33, 0.0], [0.1, 0.0])
    assert early_contact(sure, closest(sure, HORIZON_S), HORIZON_S)[0] == pytest.approx(3.0)
    unsure = pairs([0.33, 0.0], [0.1, 0.0], cov=noisy(1)[0])
    assert early_contact(unsure, closest(unsure, HORIZON_S), HORIZON_S)[0] < 3.0


def test_more_noise_never_turns_a_possible_contact_into_an_impossible_one():
    last = np.inf
    for scale in (0.0, 1.0, 4.0, 16.0):
        case = pairs([0.3, 0.04], [0.1, 0.0], cov=scale * noisy(1)[0])
        early = early_contact(case, closest(case, HORIZON_S), HORIZON_S)[0]
        assert early <= last
        last = early
    assert np.isfinite(last)


def test_what_moves_apart_has_no_early_contact_even_side_by_side():
    case = pairs([0.031, 0.0], [-0.1, 0.0], cov=noisy(1)[0])
    assert early_contact(case, closest(case, HORIZON_S), HORIZON_S)[0] == np.inf


def test_only_a_proven_slowing_down_counts():
    velocity, acc = np.array([[0.2, 0.0]]), np.array([[-0.1, 0.0]])
    sure, unsure = np.zeros((1, 2, 2)), np.eye(2)[None] * 0.05**2
    window = np.array([0.6])
    assert proven_decel(velocity, acc, sure, window)[0] == pytest.approx(0.1)
    assert proven_decel(velocity, acc, unsure, window)[0] == 0.0
    assert proven_decel(velocity, -acc, sure, window)[0] == 0.0
    assert proven_decel(velocity, acc * np.nan, sure, window)[0] == 0.0
    assert proven_decel(0.0 * velocity, acc, sure, window)[0] == 0.0


def test_features_are_twelve_finite_numbers_even_for_odd_pairs():
    cases = pairs([[0.3, 0.0], [0.0, 0.0], [0.2, 0.1]], [0.0, 0.0])
    found = edge_features(cases, closest(cases, HORIZON_S), HORIZON_S)
    assert found.shape == (3, 12) == (3, len(FEATURE_NAMES)) == (3, len(FEATURE_UNITS))
    assert np.isfinite(found).all()


def test_features_do_not_change_with_the_unit_of_length_or_the_heading():
    cov = noisy(1)[0]
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    both = np.kron(np.eye(2), turn)
    one = pairs([0.3, 0.02], [0.1, 0.01], [0.0, 0.02], cov=cov)
    other = pairs(
        2.0 * turn @ [0.3, 0.02],
        2.0 * turn @ [0.1, 0.01],
        2.0 * turn @ [0.0, 0.02],
        radius=0.06,
        cov=4.0 * both @ cov @ both.T,
    )
    features = [edge_features(case, closest(case, HORIZON_S), HORIZON_S) for case in (one, other)]
    assert np.allclose(features[0], features[1], rtol=1e-9)
