from dataclasses import replace

import numpy as np
import pytest

from apex_edge.triggers.base import TriggerConfig
from offline_train.trigger import baselines, metrics, seeds
from offline_train.trigger.observe import Watching, observe

WATCHING = Watching(noise_m=(0.003, 0.003), window=(15, 15), n_frames=30, stride=5)


@pytest.fixture(scope="module")
def seen():
    return observe(seeds.rng("test", 1), "tabletop-cv", 600, WATCHING, TriggerConfig())


def row(seen, offset, mover_vel, target_vel=(0.0, 0.0), centre_moves=False):
    one = seen.take(np.array([0]))
    geometry = replace(
        one.geometry,
        offset_m=np.array([offset]),
        mover_vel_m_s=np.array([mover_vel]),
        target_vel_m_s=np.array([target_vel]),
    )
    return replace(one, geometry=geometry, centre_moves=np.array([centre_moves]))


def test_paper_risk_is_the_formula_of_the_paper(seen):
    def sigmoid(x):
        return 1.0 / (1.0 + np.exp(-x))

    near, fast = sigmoid(1.0 / 0.2), sigmoid(1.5 * (0.1 - 2.5))
    towards = baselines.paper_risk(row(seen, (0.2, 0.0), (0.1, 0.0)))
    away = baselines.paper_risk(row(seen, (0.2, 0.0), (-0.1, 0.0)))
    assert towards[0] == pytest.approx(0.34 * near + 0.33 + 0.33 * fast, abs=1e-5)
    assert away[0] == pytest.approx(0.34 * near + 0.33 * fast, abs=1e-5)


def test_paper_risk_is_of_the_other_body_even_when_the_centre_moves(seen):
    # the centre comes from the left; the other body rests, then runs into it
    rests = baselines.paper_risk(row(seen, (0.2, 0.0), (0.1, 0.0), centre_moves=True))
    meets = baselines.paper_risk(row(seen, (0.2, 0.0), (0.1, 0.0), (-0.05, 0.0), True))
    assert meets[0] - rests[0] == pytest.approx(0.165, abs=0.01)


def test_paper_risk_never_reaches_its_threshold_on_a_tabletop(seen):
    assert baselines.paper_risk(seen).max() < 0.75


def test_analytic_is_how_deep_the_pass_is_and_speed_is_the_movers(seen):
    hit = baselines.analytic(seen) >= -TriggerConfig().k_sigma
    assert np.array_equal(hit, seen.rule_hit)
    assert np.array_equal(
        baselines.speed_only(seen), np.linalg.norm(seen.geometry.mover_vel_m_s, axis=1)
    )


def test_gradient_boosting_is_repeatable_and_beats_speed(seen):
    pytest.importorskip("sklearn")
    is_half = seen.pair % 2 == 0
    train, test = seen.take(is_half), seen.take(~is_half)
    one, same = (
        baselines.gradient_boosting(train.features, train.label, test.features, 3) for _ in range(2)
    )
    assert np.array_equal(one, same)
    boosted = metrics.frame_figures(test.label, one)["pr_auc"]
    speed = metrics.frame_figures(test.label, baselines.speed_only(test))["pr_auc"]
    assert boosted > speed + 0.1
