import dataclasses

import numpy as np
import pytest

pytest.importorskip("torch_geometric")
import torch

from apex_edge import plugins
from apex_edge.errors import PluginError
from apex_edge.triggers.graph_net import ARCHITECTURES, GRAPHORMER, GraphNet
from offline_train import extras
from offline_train.benchmarks.trigger import graph_parity
from offline_train.extras import MissingExtraError
from offline_train.graph_models import models
from offline_train.graph_models.base import Batch, EdgeModel
from offline_train.graph_models.batches import Graphs, batches, star_graphs
from offline_train.graph_models.fitted import from_layers
from offline_train.graph_models.specs import full_spec, paper_spec
from offline_train.graph_models.training import Options, fit, tensors
from offline_train.scenes import star


@pytest.fixture(scope="module")
def stars():
    return star.paper_stars("train", 1, 200)


@pytest.fixture(scope="module")
def graphs(stars):
    return star_graphs(stars, stars.designed, star.paper_edges(stars))


def paper(architecture, **changes):
    spec = paper_spec(architecture, star.NODE_NAMES, star.EDGE_NAMES)
    return dataclasses.replace(spec, **changes)


def make(spec):
    return lambda: models.from_spec(spec, 0.3)


@pytest.mark.parametrize(
    ("architecture", "n_parameters"),
    [("diffgraphormer", 4641), ("diffgat", 1441), ("diffgcn", 1377)],
)
def test_the_papers_models_have_the_released_sizes(architecture, n_parameters):
    model = models.from_spec(paper(architecture), 0.3)
    assert sum(p.numel() for p in model.parameters()) == n_parameters


def test_numpy_and_pytorch_agree_on_random_graphs_of_every_kind():
    single, double = graph_parity.differences("test", 5, 2 * len(graph_parity.variants()))
    assert 0.0 < single <= graph_parity.GOAL
    assert double <= 1e-12


def test_the_parity_graphs_cover_stars_complete_graphs_and_lone_nodes():
    random = np.random.default_rng(0)
    shapes = [graph_parity.random_graph(random) for _ in range(300)]
    sizes = {len(nodes) for nodes, _, _ in shapes}
    assert sizes == set(range(1, 21))
    n_edges = {(len(nodes), edges.shape[1]) for nodes, edges, _ in shapes}
    assert (1, 0) in n_edges
    assert (20, 19) in n_edges
    assert (20, 380) in n_edges


@pytest.mark.parametrize("edge_mode", ["value", "full"])
def test_training_moves_the_edge_encoder_and_ranks_the_planted_targets(graphs, edge_mode):
    spec = paper(GRAPHORMER, edge_mode=edge_mode)
    options = Options(seed=1, n_epochs=10, batch_size=8)
    before = fit(make(spec), graphs, dataclasses.replace(options, n_epochs=0))
    after = fit(make(spec), graphs, options)
    moved = np.abs(after.layers["edge_encoder.weight"] - before.layers["edge_encoder.weight"])
    assert moved.min() > 0.0
    score, is_hit = after.logit(graphs), graphs.labels > 0.5
    assert np.median(score[is_hit]) > np.quantile(score[~is_hit], 0.95)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_the_same_seed_gives_the_same_weights_and_another_seed_others(graphs, architecture):
    few = graphs.take(np.arange(40))
    options = Options(seed=3, n_epochs=2, batch_size=8, is_balanced=True)
    first, again, other = (
        fit(make(paper(architecture)), few, chosen)
        for chosen in (options, options, dataclasses.replace(options, seed=4))
    )
    for name, layer in first.layers.items():
        assert np.array_equal(layer, again.layers[name]), name
    assert not np.array_equal(first.layers["head.weight"], other.layers["head.weight"])


def test_training_leaves_the_random_state_of_pytorch_alone(graphs):
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    fit(make(paper("diffgcn")), graphs.take(np.arange(4)), Options(seed=1, n_epochs=1))
    assert torch.equal(torch.rand(3), expected)


def test_soft_labels_pull_the_probability_to_their_mean(graphs):
    soft = dataclasses.replace(graphs, labels=np.full(len(graphs.labels), 0.3))
    model = fit(make(paper("diffgcn")), soft, Options(seed=1, n_epochs=15, batch_size=8))
    probability = 1.0 / (1.0 + np.exp(-model.logit(soft)))
    assert probability.mean() == pytest.approx(0.3, abs=0.05)


def test_a_balanced_loss_raises_the_logits(graphs):
    options = Options(seed=1, n_epochs=5, batch_size=8)
    plain = fit(make(paper("diffgcn")), graphs, options)
    balanced = fit(make(paper("diffgcn")), graphs, dataclasses.replace(options, is_balanced=True))
    assert balanced.logit(graphs).mean() > plain.logit(graphs).mean() + 0.5


def test_graphs_taken_apart_score_as_in_one_batch(graphs):
    model = fit(make(paper(GRAPHORMER)), graphs, Options(seed=1, n_epochs=1))
    whole = model.logit(graphs)
    for row in (0, 7, 199):
        assert np.allclose(model.logit(graphs.take(np.array([row]))), whole[5 * row : 5 * row + 5])
    shuffled = np.random.default_rng(0).permutation(200)
    expected = whole.reshape(200, 5)[shuffled].ravel()
    assert np.allclose(model.logit(graphs.take(shuffled)), expected)


def test_graphs_of_unequal_sizes_are_cut_right():
    sizes = np.array([1, 4, 2, 3])
    start = np.r_[0, np.cumsum(sizes)]
    pairs = [(start[i], start[i] + k) for i in range(4) for k in range(1, sizes[i])]
    edges = np.array(pairs).T
    whole = Graphs(
        nodes=np.arange(10.0)[:, None],
        edges=edges,
        edge_features=np.arange(6.0)[:, None],
        labels=np.zeros(6),
        node_start=start,
        edge_start=np.r_[0, np.cumsum(sizes - 1)],
        node_names=("number",),
        edge_names=("number",),
    )
    part = whole.take(np.array([3, 0, 1]))
    assert part.nodes[:, 0].tolist() == [7, 8, 9, 0, 1, 2, 3, 4]
    assert part.edges.tolist() == [[0, 0, 4, 4, 4], [1, 2, 5, 6, 7]]
    assert part.edge_features[:, 0].tolist() == [4, 5, 0, 1, 2]
    assert len(part) == 3


def test_batches_hold_every_graph_once():
    seen = np.concatenate(list(batches(10, 4, np.random.default_rng(0))))
    assert sorted(seen.tolist()) == list(range(10))


def test_on_a_star_the_attention_is_one_and_the_papers_model_an_affine_map(graphs):
    model = models.from_spec(paper(GRAPHORMER), 0.3).eval()
    net = GraphNet(*model.export())
    logit = net.logits(graphs.nodes, graphs.edges, graphs.edge_features)
    source, target = graphs.edges
    inputs = np.c_[graphs.nodes[source], graphs.nodes[target], graphs.edge_features]
    design = np.c_[inputs, np.ones(len(inputs))]
    solved = np.linalg.lstsq(design, logit, rcond=None)[0]
    assert np.allclose(design @ solved, logit, atol=1e-8)


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_models_come_in_by_name(name, graphs):
    make_model = plugins.load("graph_models", name)
    model = make_model(star.NODE_NAMES, star.EDGE_NAMES, 0.0)
    assert model.export()[0] == full_spec(name, star.NODE_NAMES, star.EDGE_NAMES)
    assert model.logits(tensors(graphs)[0]).shape == (1000,)


def test_an_unknown_model_is_named_with_the_nearest():
    with pytest.raises(PluginError, match="did you mean 'diffgat'"):
        plugins.load("graph_models", "difgat")


class Homemade(EdgeModel):
    """Reads the edges alone and cannot be exported."""

    def __init__(self):
        super().__init__()
        self.only = torch.nn.Linear(3, 1)

    def logits(self, batch: Batch):
        return self.only(batch.edge_features)[:, 0]


def test_a_model_the_device_cannot_run_can_still_be_trained_and_asked(graphs):
    model = fit(Homemade, graphs, Options(seed=1, n_epochs=30, batch_size=8, learning_rate=0.03))
    assert model.spec is None
    score, is_hit = model.logit(graphs), graphs.labels > 0.5
    assert np.median(score[is_hit]) > np.median(score[~is_hit]) + 1.0


def test_layers_that_do_not_fit_the_spec_are_refused(graphs):
    model = fit(make(paper("diffgcn")), graphs, Options(seed=1, n_epochs=0))
    wrong = dict(model.layers, **{"head.bias": np.zeros(2)})
    with pytest.raises(ValueError, match="head.bias"):
        from_layers(model.spec, wrong, model.node_scaler, model.edge_scaler)


def test_without_pytorch_it_says_what_to_install(monkeypatch):
    def missing(name):
        raise ImportError(f"No module named {name!r}", name="torch_geometric.nn")

    monkeypatch.setattr(extras.importlib, "import_module", missing)
    with pytest.raises(MissingExtraError, match=r"pip install 'apex-edge\[graph\]'"):
        graph_parity.differences("test", 1, 1)
