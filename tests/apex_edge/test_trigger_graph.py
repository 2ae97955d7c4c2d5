import numpy as np
import pytest
import slow_graph_net
from trigger_scene import difference, tracks

from apex_edge import plugins
from apex_edge.errors import WeightsError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.analytic import AnalyticTrigger
from apex_edge.triggers.approach import Pairs
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.graph_trigger import GraphTrigger
from apex_edge.triggers.stars import NODE_NAMES, NODE_UNITS, nodes_as, stars
from offline_train.benchmarks.trigger import damages

MADE = damages.made_graph(model_file.read(weights.SHIPPED), 3)


@pytest.fixture
def model_path(tmp_path):
    model_file.write(MADE, tmp_path / "graph.npz")
    return tmp_path / "graph.npz"


def some_pairs(n, seed=0):
    rng = np.random.default_rng(seed)
    return Pairs(
        offset_m=rng.normal(size=(n, 2)),
        mover_vel_m_s=rng.normal(size=(n, 2)),
        target_vel_m_s=rng.normal(size=(n, 2)),
        decel_m_s2=np.zeros(n),
        radius_m=rng.uniform(0.02, 0.06, n),
        cov=np.tile(1e-6 * np.eye(4), (n, 1, 1)),
    )


def column(found, name):
    return found.nodes[:, NODE_NAMES.index(name)]


def test_each_mover_is_the_centre_of_one_star_with_an_edge_to_each_of_its_targets():
    pairs = some_pairs(5)
    mover = np.array([9, 4, 9, 4, 7])
    found = stars(pairs, mover)
    assert found.nodes.shape == (3 + 5, len(NODE_NAMES)) and len(NODE_UNITS) == len(NODE_NAMES)
    assert column(found, "is_mover").tolist() == [1.0] * 3 + [0.0] * 5
    centre, target = found.edges
    assert [centre[mover == who].tolist() for who in (4, 7, 9)] == [[0, 0], [1], [2, 2]]
    assert target.tolist() == [3, 4, 5, 6, 7]
    assert np.array_equal(column(found, "radius")[3:], pairs.radius_m)
    assert not column(found, "radius")[:3].any()


def test_nodes_are_seen_along_the_movers_velocity():
    pairs = Pairs(
        offset_m=np.array([[0.0, 0.3]]),
        mover_vel_m_s=np.array([[0.0, 0.2]]),
        target_vel_m_s=np.array([[0.1, 0.0]]),
        decel_m_s2=np.zeros(1),
        radius_m=np.array([0.04]),
        cov=np.zeros((1, 4, 4)),
    )
    mover, target = stars(pairs, np.array([1])).nodes
    assert mover == pytest.approx([1.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    assert target == pytest.approx([0.0, 0.3, 0.0, 0.0, -0.1, 0.04])


def test_turning_the_table_changes_nothing():
    pairs = some_pairs(6)
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    turned = Pairs(
        pairs.offset_m @ turn,
        pairs.mover_vel_m_s @ turn,
        pairs.target_vel_m_s @ turn,
        pairs.decel_m_s2,
        pairs.radius_m,
        pairs.cov,
    )
    mover = np.arange(6)
    assert np.allclose(stars(turned, mover).nodes, stars(pairs, mover).nodes, rtol=0, atol=1e-12)


def test_pairs_of_other_frames_are_other_stars_but_look_the_same():
    pairs, mover = some_pairs(6), np.array([1, 1, 2, 1, 2, 2])
    group = np.array([70, 70, 70, 5, 5, 5])
    together = stars(pairs, mover, group)
    assert len(together.nodes) == 4 + 6
    for frame in (5, 70):
        rows = np.flatnonzero(group == frame)
        alone = stars(pairs.take(rows), mover[rows])
        for end in (0, 1):
            assert np.array_equal(
                together.nodes[together.edges[end][rows]], alone.nodes[alone.edges[end]]
            )


def test_a_mover_at_rest_and_no_pairs_at_all_do_no_harm():
    still = Pairs(*(np.zeros_like(value) for value in vars(some_pairs(2)).values()))
    assert np.isfinite(stars(still, np.array([1, 1])).nodes).all()
    none = stars(some_pairs(3).take(np.zeros(3, dtype=bool)), np.zeros(0, dtype=int))
    assert none.nodes.shape == (0, len(NODE_NAMES)) and none.edges.shape == (2, 0)


def test_a_model_reads_the_node_features_it_names_in_its_order():
    found = stars(some_pairs(2), np.array([1, 2])).nodes
    assert nodes_as(found, NODE_NAMES) is found
    assert np.array_equal(nodes_as(found, ("radius", "x")), found[:, [5, 1]])


def test_golden_vectors_are_what_the_formulas_give():
    model = weights.check(MADE, "made")
    for case in MADE["golden"]:
        nodes = model.node_columns(np.array(case["nodes"]))
        features = model.columns(np.array(case["features"]))
        edges = np.array(case["edges"])
        net = model.net
        expected = slow_graph_net.logits(net.spec, net.layers, nodes, edges, features)
        assert case["logit"] == pytest.approx(expected, abs=1e-9)


def crowd(**changes):
    """Two movers among five objects, all within the domain of the model."""
    return tracks(
        [[0, 0], [0.25, 0], [0.1, 0.2], [-0.1, 0.2], [0.3, 0.3]],
        [[0, 0], [-0.1, 0], [0, 0], [0.05, -0.1], [0, 0]],
        **changes,
    )


def test_the_graph_trigger_scores_every_star_of_a_frame_as_if_it_were_alone(model_path):
    trigger, now = GraphTrigger(weights_path=model_path), crowd()
    found = trigger.score(difference(now), 5.0)
    assert not found.is_fallback.any()
    judged = np.flatnonzero(found.probability > 0.0)
    assert len(judged) >= 3 and len(set(found.mover_id[judged].tolist())) == 2
    for row in judged:
        keep = np.isin(now.track_id, [found.mover_id[row], found.target_id[row]])
        two = tracks(
            now.pos_m[keep, :2],
            now.vel_m_s[keep, :2],
            track_id=now.track_id[keep],
            name=tuple(np.array(now.name)[keep]),
        )
        alone = GraphTrigger(weights_path=model_path).score(difference(two), 5.0)
        assert alone.probability[0] == pytest.approx(found.probability[row], abs=1e-12)


def test_the_threshold_and_the_vote_decide_who_fires(tmp_path):
    fired = {}
    for name, logit in (("low", -1e6), ("high", 1e6)):
        fields = dict(MADE, threshold=dict(MADE["threshold"], logit=logit))
        model_file.write(fields, tmp_path / f"{name}.npz")
        trigger = GraphTrigger(weights_path=tmp_path / f"{name}.npz")
        frames = [trigger.score(difference(crowd(seq=seq)), 5.0) for seq in range(1, 6)]
        fired[name] = [frame.is_fired.any() for frame in frames]
    assert fired == {"low": [False, False, True, True, True], "high": [False] * 5}


def test_outside_its_domain_the_graph_trigger_says_so_and_falls_back(model_path):
    trigger, rule = GraphTrigger(weights_path=model_path), AnalyticTrigger()
    for odd in (crowd(n_samples=np.full(5, 3)), crowd(radius_m=np.full(5, 0.09))):
        found, expected = (each.score(difference(odd), 5.0) for each in (trigger, rule))
        assert found.is_fallback.any()
        assert np.array_equal(found.probability, expected.probability)


def test_the_settings_choose_the_graph_trigger_and_its_file(model_path):
    made = plugins.load("triggers", "graph")(TriggerConfig(type="graph", weights=str(model_path)))
    assert isinstance(made, GraphTrigger)
    with pytest.raises(WeightsError, match="trigger.type = linear"):
        GraphTrigger(TriggerConfig(weights=str(weights.SHIPPED)))


def test_a_missing_shipped_graph_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr("apex_edge.triggers.graph_trigger.SHIPPED_GRAPH", tmp_path / "no.npz")
    with pytest.raises(WeightsError, match="no.npz"):
        GraphTrigger()
