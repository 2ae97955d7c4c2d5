import itertools
from dataclasses import replace

import numpy as np
import pytest
import slow_graph_net
from hypothesis import given, settings
from hypothesis import strategies as st

from apex_edge.triggers.graph_net import GraphNet, GraphSpec, layer_shapes

PLAIN = GraphSpec(
    architecture="diffgraphormer",
    hidden=8,
    heads=2,
    activation="relu",
    head="concat",
    edge_mode="full",
    is_bidirectional=False,
    node_names=("x", "y", "speed"),
    edge_names=("distance", "closing"),
)
KINDS = [("diffgraphormer", mode) for mode in ("none", "value", "full")]
KINDS += [("diffgat", "none"), ("diffgcn", "none")]
SHAPES = {
    "a star": (5, [[0, 0, 0, 0], [1, 2, 3, 4]]),
    "a star pointing inward": (4, [[1, 2, 3], [0, 0, 0]]),
    "one edge": (2, [[1], [0]]),
    "a chain with one edge into each": (4, [[0, 1, 2], [1, 2, 3]]),
    "a complete digraph": (4, list(zip(*itertools.permutations(range(4), 2)))),
    "two stars and isolated nodes": (9, [[2, 2, 7, 7], [0, 1, 5, 6]]),
    "the same edge twice and a self-loop": (3, [[0, 0, 1, 2], [1, 1, 1, 0]]),
}


def drawn(spec, n_nodes, edges, seed=0):
    rng = np.random.default_rng(seed)
    nodes = rng.normal(size=(n_nodes, len(spec.node_names)))
    features = rng.normal(size=(edges.shape[1], len(spec.edge_names)))
    return GraphNet(spec, slow_graph_net.random_layers(layer_shapes(spec), rng)), nodes, features


def assert_agrees(spec, n_nodes, edges, seed=0):
    net, nodes, features = drawn(spec, n_nodes, edges, seed)
    expected = slow_graph_net.logits(spec, net.layers, nodes, edges, features)
    assert np.max(np.abs(net.logits(nodes, edges, features) - expected), initial=0.0) < 1e-10


@pytest.mark.parametrize("shape", sorted(SHAPES))
@pytest.mark.parametrize(("architecture", "mode"), KINDS)
def test_every_architecture_follows_its_formulas(architecture, mode, shape):
    n_nodes, edges = SHAPES[shape]
    for activation, head, both in itertools.product(
        ("none", "relu", "elu"), ("sum", "concat"), (False, True)
    ):
        spec = replace(
            PLAIN,
            architecture=architecture,
            edge_mode=mode,
            activation=activation,
            head=head,
            is_bidirectional=both,
        )
        assert_agrees(spec, n_nodes, np.array(edges))


@settings(deadline=None, max_examples=40)
@given(
    kind=st.sampled_from(KINDS),
    activation=st.sampled_from(["none", "relu", "elu"]),
    both=st.booleans(),
    ends=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=1, max_size=12),
    seed=st.integers(0, 1000),
)
def test_any_graph_follows_the_formulas(kind, activation, both, ends, seed):
    spec = replace(
        PLAIN,
        architecture=kind[0],
        edge_mode=kind[1],
        activation=activation,
        is_bidirectional=both,
    )
    assert_agrees(spec, 6, np.array(ends).T, seed)


@pytest.mark.parametrize(("architecture", "mode"), KINDS)
def test_graphs_of_one_batch_do_not_see_each_other(architecture, mode):
    spec = replace(PLAIN, architecture=architecture, edge_mode=mode)
    edges = np.array(SHAPES["a complete digraph"][1])
    net, nodes, features = drawn(spec, 8, np.concatenate([edges, edges + 4], axis=1))
    together = net.logits(nodes, np.concatenate([edges, edges + 4], axis=1), features)
    alone = net.logits(nodes[4:], edges, features[12:])
    assert np.allclose(together[12:], alone, rtol=0, atol=1e-12)
    nodes[:4] = np.nan
    still = net.logits(nodes, np.concatenate([edges, edges + 4], axis=1), features)
    assert np.allclose(still[12:], alone, rtol=0, atol=1e-12)
    assert np.isnan(still[:12]).all()


@pytest.mark.parametrize(("architecture", "mode"), KINDS)
@pytest.mark.parametrize("n_nodes", [0, 1, 3])
def test_a_graph_without_edges_has_no_logits(architecture, mode, n_nodes):
    spec = replace(PLAIN, architecture=architecture, edge_mode=mode)
    edges = np.zeros((2, 0), dtype=int)
    net, nodes, features = drawn(spec, n_nodes, edges)
    assert net.logits(nodes, edges, features).shape == (0,)


def test_attention_in_a_star_is_one_whatever_the_keys_and_queries_say():
    edges = np.array(SHAPES["a star"][1])
    net, nodes, features = drawn(PLAIN, 5, edges)
    layers = dict(net.layers)
    for name in layers:
        if "lin_key" in name or "lin_query" in name:
            layers[name] = -3.0 * layers[name]
    other = GraphNet(PLAIN, layers)
    assert np.array_equal(other.logits(nodes, edges, features), net.logits(nodes, edges, features))
    # and in a graph that is no star they do count
    full = np.array(SHAPES["a complete digraph"][1])
    net, nodes, features = drawn(PLAIN, 4, full)
    assert not np.allclose(other.logits(nodes, full, features), net.logits(nodes, full, features))


@pytest.mark.parametrize("mode", ["none", "value", "full"])
def test_without_an_activation_a_star_is_an_affine_map_of_nodes_and_edge(mode):
    spec = replace(PLAIN, activation="none", edge_mode=mode)
    edges = np.array(SHAPES["a star"][1])
    net, nodes, features = drawn(spec, 5, edges)
    other_nodes, other = drawn(spec, 5, edges, seed=1)[1:]
    middle = net.logits(0.5 * (nodes + other_nodes), edges, 0.5 * (features + other))
    ends = net.logits(nodes, edges, features) + net.logits(other_nodes, edges, other)
    assert np.allclose(middle, 0.5 * ends, rtol=0, atol=1e-12)
    # with one it is not
    bent, nodes, features = drawn(PLAIN, 5, edges)
    middle = bent.logits(0.5 * (nodes + other_nodes), edges, 0.5 * (features + other))
    ends = bent.logits(nodes, edges, features) + bent.logits(other_nodes, edges, other)
    assert not np.allclose(middle, 0.5 * ends, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"architecture": "transformer"}, "architecture"),
        ({"activation": "tanh"}, "activation"),
        ({"head": "dot"}, "head"),
        ({"edge_mode": "keys"}, "edge_mode"),
        ({"heads": 3}, "divide"),
        ({"heads": 0}, "heads"),
        ({"hidden": 8.0}, "hidden"),
        ({"hidden": 10**6}, "hidden"),
        ({"architecture": "diffgat"}, "knows no edges"),
        ({"node_names": ()}, "node_names"),
        ({"edge_names": ()}, "edge_names"),
    ],
)
def test_a_net_that_cannot_be_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(PLAIN, **change)


def test_layers_that_do_not_fit_are_named():
    layers = drawn(PLAIN, 2, np.array([[0], [1]]))[0].layers
    for change, message in (
        ({"head.weight": np.zeros((1, 8))}, "head.weight has shape"),
        ({"conv.lin_edge.weight": np.full((8, 8), np.nan)}, "conv.lin_edge.weight holds"),
        ({"conv.lin_beta.weight": np.zeros(1)}, "unknown .*lin_beta"),
    ):
        with pytest.raises(ValueError, match=message):
            GraphNet(PLAIN, dict(layers, **change))
    del layers["conv.lin_skip.bias"]
    with pytest.raises(ValueError, match="missing .*lin_skip.bias"):
        GraphNet(PLAIN, layers)
