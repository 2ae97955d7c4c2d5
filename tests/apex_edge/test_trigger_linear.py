import logging

import numpy as np
import pytest
from trigger_scene import difference, tracks

from apex_edge.triggers.analytic import AnalyticTrigger
from apex_edge.triggers.approach import closest
from apex_edge.triggers.base import TriggerConfig, pairs_of
from apex_edge.triggers.features import edge_features
from apex_edge.triggers.linear import LinearTrigger


def approaching(**changes):
    return tracks([[0, 0], [0.25, 0]], [[0, 0], [-0.1, 0]], **changes)


def score(trigger, now):
    return trigger.score(difference(now), 5.0)


def test_the_probability_is_that_of_the_weights_on_the_shared_features():
    trigger, now = LinearTrigger(), approaching()
    pairs = pairs_of(now, np.array([[1, 0]]), 1.0 / 30.0)
    logit = trigger.weights.logit(edge_features(pairs, closest(pairs, 5.0), 5.0))[0]
    found = score(trigger, now)
    assert found.probability[0] == pytest.approx(
        trigger.weights.probability(np.array([logit]))[0], abs=1e-12
    )
    assert not found.is_fallback[0]


def test_outside_its_domain_the_linear_trigger_says_so_and_falls_back():
    linear, rule = LinearTrigger(), AnalyticTrigger()
    assert not score(linear, approaching()).is_fallback[0]
    young = approaching(n_samples=np.array([15, 3]))
    large = approaching(radius_m=np.array([0.06, 0.06]))
    for odd in (young, large):
        found, expected = score(linear, odd), score(rule, odd)
        assert found.is_fallback[0]
        assert found.probability[0] == expected.probability[0]
    # another horizon than the trained one
    assert linear.score(difference(approaching()), 3.0).is_fallback[0]


def test_settings_that_void_the_certificate_are_named(caplog):
    with caplog.at_level(logging.WARNING):
        LinearTrigger()
        assert not caplog.records
        LinearTrigger(TriggerConfig(persist_hits=1))
    assert "certified" in caplog.text
