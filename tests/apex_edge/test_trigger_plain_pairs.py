"""The device's rows against the formulas written down one pair at a time."""

import numpy as np
import pytest

from apex_edge.triggers.approach import Pairs, closest, early_contact, first_contact
from apex_edge.triggers.features import edge_features
from offline_train.benchmarks.trigger import plain_pairs

HORIZON_S = 5.0
N_PAIRS = 400


def draw(seed, n_dims, n=N_PAIRS):
    """Return random pairs of a table, correlated noise included."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, 2 * n_dims, 2 * n_dims))
    root *= np.repeat([0.003, 0.02], n_dims)[:, None]
    return {
        "offset_m": rng.normal(size=(n, n_dims)) * 0.3,
        "mover_vel_m_s": rng.normal(size=(n, n_dims)) * 0.15,
        "target_vel_m_s": rng.normal(size=(n, n_dims)) * 0.1 * (rng.random(n) < 0.5)[:, None],
        "decel_m_s2": np.zeros(n),
        "radius_m": rng.uniform(0.01, 0.08, n),
        "cov": root @ root.transpose(0, 2, 1),
    }


def steady(values):
    return values


def slowing(values):
    n = len(values["radius_m"])
    values["decel_m_s2"][::3] = np.random.default_rng(n).uniform(0.01, 0.3, n)[::3]
    return values


def touching(values):
    values["offset_m"] *= 0.03
    values["offset_m"][::5] = 0.0
    return values


def resting(values):
    values["mover_vel_m_s"][::2] = values["target_vel_m_s"][::2] = 0.0
    values["mover_vel_m_s"][1::4] = 0.0
    return values


def side_by_side(values):
    values["target_vel_m_s"][:] = values["mover_vel_m_s"]
    values["target_vel_m_s"][::2] *= 1.0 + 1e-3
    return values


def receding(values):
    values["target_vel_m_s"][:] = 0.0
    values["mover_vel_m_s"][:] = -0.4 * values["offset_m"]
    return values


def head_on(values):
    values["target_vel_m_s"][:] = 0.0
    values["mover_vel_m_s"][:] = 0.4 * values["offset_m"]
    return values


def certain(values):
    values["cov"][:] = 0.0
    return values


def far_and_fast(values):
    values["offset_m"] *= 100.0
    values["mover_vel_m_s"] *= 1000.0
    return values


@pytest.mark.parametrize("n_dims", [2, 3])
@pytest.mark.parametrize(
    "change",
    [
        steady,
        slowing,
        touching,
        resting,
        side_by_side,
        receding,
        head_on,
        certain,
        far_and_fast,
    ],
)
def test_rows_agree_with_one_pair_at_a_time(change, n_dims):
    pairs = Pairs(**change(draw(sum(map(ord, change.__name__)), n_dims)))
    found = closest(pairs, HORIZON_S)
    wanted, early, features = [], [], []
    for pair in plain_pairs.pairs_in(pairs):
        plain = plain_pairs.closest(pair, HORIZON_S)
        wanted.append(plain)
        early.append(plain_pairs.early_contact(pair, plain, HORIZON_S))
        features.append(plain_pairs.features(pair, plain, HORIZON_S))
    ttc = first_contact(pairs, found, HORIZON_S)
    columns = [found.dca_m, found.tca_s, ttc, found.near_m[1], found.sd_m[0], found.sd_m[1]]
    close = {"rtol": 1e-9, "atol": 1e-9}
    for name, column, expected in zip(plain_pairs.PlainApproach._fields, columns, zip(*wanted)):
        np.testing.assert_allclose(column, expected, err_msg=name, **close)
    np.testing.assert_allclose(early_contact(pairs, found, HORIZON_S), early, **close)
    np.testing.assert_allclose(edge_features(pairs, found, HORIZON_S), features, **close)


@pytest.mark.parametrize("name", ["offset_m", "mover_vel_m_s", "decel_m_s2", "cov"])
def test_a_row_with_a_hole_leaves_every_other_row_as_it_was(name):
    values = slowing(draw(8, 2, n=30))
    whole = Pairs(**{key: column.copy() for key, column in values.items()})
    values[name][7] = np.nan
    holed = Pairs(**values)
    others = np.arange(30) != 7
    results = []
    for pairs in (whole, holed):
        found = closest(pairs, HORIZON_S)
        early = early_contact(pairs, found, HORIZON_S)
        results.append(np.column_stack([edge_features(pairs, found, HORIZON_S), early]))
    assert np.array_equal(results[0][others], results[1][others])
    assert np.isnan(results[1][7, :12]).any()
