import numpy as np
import pytest

from apex_edge.errors import ApexError
from apex_edge.triggers.approach import Pairs, closest
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import FEATURE_NAMES
from offline_train.scenes import mujoco_world
from offline_train.trigger import metrics, seeds, soft
from offline_train.trigger.fit import fit_rows, thin
from offline_train.trigger.observe import Watching, observe

pytest.importorskip("mujoco")


def pairs(n, offset, velocity, sd=1e-5, decel=0.0):
    cov = np.zeros((n, 4, 4))
    cov[:, np.arange(4), np.arange(4)] = np.array([sd, sd, 3 * sd, 3 * sd]) ** 2
    return Pairs(
        offset_m=np.tile(np.array(offset, dtype=float), (n, 1)),
        mover_vel_m_s=np.tile(np.array(velocity, dtype=float), (n, 1)),
        target_vel_m_s=np.zeros((n, 2)),
        decel_m_s2=np.full(n, decel),
        radius_m=np.full(n, 0.03),
        cov=cov,
    )


def launches(n, seed=0):
    rng = np.random.default_rng(seed)
    is_free, is_still = rng.random(n) < 0.5, rng.random((n, 1)) < 0.5
    return soft.Launches(
        speed_m_s=rng.uniform(0.02, 0.4, n),
        decel_m_s2=np.where(is_free, 0.0, rng.uniform(0.005, 0.3, n)),
        target_m=rng.uniform(-0.3, 0.6, (n, 2)) * [1.0, 0.4],
        target_vel_m_s=np.where(is_still, 0.0, rng.uniform(-0.1, 0.1, (n, 2))),
        radius_m=rng.uniform(0.025, 0.06, n),
        horizon_s=np.full(n, 5.0),
    )


def test_roll_outs_touch_where_the_closed_form_says():
    many = launches(1500)
    ahead = np.column_stack([many.speed_m_s, np.zeros(1500)])
    still = np.zeros((1500, 4, 4))
    straight = Pairs(
        many.target_m, ahead, many.target_vel_m_s, many.decel_m_s2, many.radius_m, still
    )
    expected = closest(straight, 5.0)
    found = soft.touches(many)
    is_other = found != (expected.dca_m <= many.radius_m)
    assert 0.05 < found.mean() < 0.5
    assert is_other.mean() < 0.005
    # what differs are grazes
    assert np.all(np.abs(expected.dca_m - many.radius_m)[is_other] < 0.004)


def test_the_rail_is_the_motion_of_a_ball_on_the_table():
    for speed, slow in ((0.1, 0.02), (0.25, 0.1)):
        body = mujoco_world.Body(True, mujoco_world.FLICKED, 0.0, 0.0, 0.0, 0.015, slow, speed)
        far = body._replace(x_m=9.0, y_m=9.0, speed_m_s=0.0)
        way = mujoco_world.run([far, body], 6.0).pos_m[1, -1, 0]
        for reach, is_hit in ((way - 0.006, True), (way + 0.006, False)):
            one = soft.Launches(
                np.array([speed]),
                np.array([slow]),
                np.array([[reach + 0.03, 0.0]]),
                np.zeros((1, 2)),
                np.array([0.03]),
                np.array([6.0]),
            )
            assert soft.touches(one)[0] == is_hit


def test_a_sure_hit_a_sure_miss_and_a_toss_up():
    rng = np.random.default_rng(0)
    horizon = np.full(3, 5.0)
    sure = pairs(1, (0.05, 0.0), (0.3, 0.0))
    away = pairs(1, (0.2, 0.0), (-0.3, 0.0))
    edge = pairs(1, (0.05, 0.03), (0.3, 0.0), sd=0.003)
    chances = [soft.probability(p, horizon[:1], rng, 64)[0] for p in (sure, away, edge)]
    assert chances[0] > 0.8 and chances[1] == 0.0 and 0.25 < chances[2] < 0.75


def test_a_proven_slowing_down_lowers_the_chance():
    rng, horizon = np.random.default_rng(0), np.full(1, 5.0)
    stops = pairs(1, (0.3, 0.0), (0.1, 0.0), sd=1e-4, decel=0.05)
    runs = pairs(1, (0.3, 0.0), (0.1, 0.0), sd=1e-4)
    assert soft.probability(stops, horizon, rng, 64)[0] < 0.02
    assert soft.probability(runs, horizon, rng, 64)[0] > 0.5


def test_the_horizon_ends_a_roll_out():
    rng = np.random.default_rng(0)
    late = pairs(2, (0.33, 0.0), (0.1, 0.0), sd=1e-5)
    chance = soft.probability(late, np.array([2.9, 5.0]), rng, 64)
    assert chance[0] == 0.0 and chance[1] > 0.4


@pytest.fixture(scope="module")
def softened():
    seen = observe(seeds.rng("train", 40), "tabletop-pairs", 400, Watching(), TriggerConfig())
    rows = thin(seen.pair, 3, 0)
    return soft.soften(seen, rows, seeds.rng("train", 41), 16), rows


def test_soft_labels_say_about_how_often_contact_comes(softened):
    seen, rows = softened
    label, chance = seen.label[rows], seen.soft[rows]
    assert np.isnan(np.delete(seen.soft, rows)).all()
    assert metrics.calibration_error(label, chance) < 0.15
    assert label[chance > 0.9].mean() > 0.85
    assert label[chance < 0.1].mean() < 0.15


def test_the_same_seed_gives_the_same_labels(softened):
    seen, rows = softened
    few = rows[:40]
    one, again = (soft.soften(seen, few, np.random.default_rng(3), 8).soft for _ in range(2))
    assert one.tobytes() == again.tobytes()


def test_soft_labels_teach_a_linear_student_that_stands_hard_truth(softened):
    seen, rows = softened
    few = seen.take(rows[: len(rows) // 4])
    rest = seen.take(rows[len(rows) // 4 :])
    student = fit_rows(few.features, few.soft, FEATURE_NAMES)
    found = metrics.frame_figures(rest.label, student.logit(rest.features))
    assert found["roc_auc"] > 0.8


def test_a_fit_on_certain_soft_labels_is_the_fit_on_hard_ones(softened):
    seen, rows = softened
    kept = seen.take(rows)
    certain = np.where(kept.label, 1.0 - 1e-9, 1e-9)
    hard, same, other = (
        fit_rows(kept.features, target, FEATURE_NAMES)
        for target in (kept.label, certain, kept.soft)
    )
    assert np.allclose(hard.weight, same.weight, rtol=1e-3, atol=1e-3)
    assert not np.allclose(hard.weight, other.weight, rtol=1e-2)


def test_rows_without_a_soft_label_are_refused(softened):
    seen, _ = softened
    with pytest.raises(ApexError, match="no label between 0 and 1"):
        fit_rows(seen.features, seen.soft, FEATURE_NAMES)
