import numpy as np
import pytest

from apex_edge.triggers.approach import closest
from apex_edge.triggers.features import FEATURE_NAMES, edge_features
from offline_train.scenes import star


@pytest.fixture(scope="module")
def paper():
    return star.paper_stars("test", 3, 20000)


@pytest.fixture(scope="module")
def hard():
    return star.hard_stars("test", 3, 8000)


def recall(found, truth):
    return (found & truth).sum() / truth.sum()


def roc_auc(score, truth):
    rank = np.argsort(np.argsort(score.ravel())) + 1.0
    truth = truth.ravel()
    n = truth.sum()
    return (rank[truth].sum() - n * (n + 1) / 2) / n / (len(truth) - n)


def test_speed_alone_gives_the_planted_targets_of_the_paper_away(paper):
    fast = np.linalg.norm(paper.node_t[:, 1:, 4:], axis=2) > 1.0 + 1e-9
    assert recall(fast, paper.designed) == pytest.approx(0.989, abs=0.004)
    assert not (fast & ~paper.designed).any()


def test_every_second_star_has_one_planted_target_that_meets_the_master_at_three_seconds(paper):
    assert paper.designed.sum(axis=1).tolist() == [0, 1] * 10000
    later = paper.node_t[..., 1:4] + 3.0 * paper.node_t[..., 4:]
    gap = np.linalg.norm(later[:, 1:] - later[:, :1], axis=2)
    assert gap[paper.designed].max() < 1e-9
    assert paper.truth[paper.designed].all()


def test_the_risk_as_released_is_upside_down_and_never_reaches_its_own_threshold(paper):
    assert paper.risk.max() < 0.7 < star.RISK_TAU
    assert roc_auc(paper.risk, paper.designed) < 0.02


def test_the_risk_put_right_finds_the_planted_but_misses_a_quarter_of_the_contacts(paper):
    assert paper.risk_fixed.max() == pytest.approx(0.834, abs=0.002)
    assert roc_auc(paper.risk_fixed, paper.designed) == pytest.approx(0.9988, abs=0.001)
    high = paper.risk_fixed > star.RISK_TAU
    assert high.mean() == pytest.approx(0.076, abs=0.003)
    assert recall(high, paper.truth) == pytest.approx(0.743, abs=0.012)
    assert not (high & ~paper.truth).any()


def test_the_hard_stars_have_no_leak_in_the_speed(hard):
    speed = np.linalg.norm(hard.node_t[:, 1:, 4:], axis=2)
    assert hard.truth.mean() == pytest.approx(0.115, abs=0.006)
    assert speed.min() >= 0.5
    assert speed.max() <= 6.0
    assert speed[hard.designed].mean() == pytest.approx(speed[~hard.designed].mean(), rel=0.02)
    high = hard.risk_fixed > star.RISK_TAU
    assert recall(high, hard.truth) == pytest.approx(0.757, abs=0.02)
    assert recall(hard.truth, high) == pytest.approx(0.29, abs=0.02)


def test_an_aimed_target_without_a_miss_meets_the_master(monkeypatch):
    monkeypatch.setattr(star, "_HARD_MISS", (0.0, 0.0))
    stars = star.hard_stars("test", 0, 500)
    found = closest(star.star_pairs(stars), 1000.0)
    speed = np.linalg.norm(stars.node_t[:, 1:, 4:], axis=2)
    sure = (stars.designed & (speed > 1.0)).ravel()
    assert sure.sum() > 500
    assert found.dca_m[sure].max() < 1e-6


def test_the_same_seed_gives_the_same_stars_and_another_purpose_gives_others():
    first, again = star.hard_stars("train", 1, 20), star.hard_stars("train", 1, 20)
    assert np.array_equal(first.node_t, again.node_t)
    assert not np.array_equal(first.node_t, star.hard_stars("bench", 1, 20).node_t)


def test_pairs_of_a_star_have_features_in_three_dimensions(hard):
    part = hard.take(slice(0, 50))
    pairs = star.star_pairs(part)
    found = closest(pairs, star.HORIZON_S)
    features = edge_features(pairs, found, star.HORIZON_S)
    assert features.shape == (250, len(FEATURE_NAMES))
    inside = features[:, FEATURE_NAMES.index("dca")] <= 1.0
    assert np.array_equal(inside, part.truth.ravel())


def test_paper_edges_are_distance_cosine_and_speed(paper):
    edges = star.paper_edges(paper.take(slice(0, 40)))
    raw = star.paper_edges(paper.take(slice(0, 40)), is_raw_displacement=True)
    speed = np.linalg.norm(paper.node_t[:40, 1:, 4:], axis=2)
    assert np.allclose(edges[..., 2], speed)
    assert np.allclose(raw[..., 2], star.DT_S * speed)
    assert np.array_equal(edges[..., :2], raw[..., :2])
    # only the direction of motion enters the cosine
    ways = (paper.node_dt[:40, :1] - paper.node_dt[:40, 1:])[..., 1:4]
    velocity = paper.node_t[:40, 1:, 4:]
    cosine = (ways * velocity).sum(-1) / np.linalg.norm(ways, axis=-1) / speed
    assert np.allclose(edges[..., 1], cosine)
