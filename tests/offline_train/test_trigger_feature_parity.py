"""The parity bench finds what differs, and says so when there is no device interpreter."""

import numpy as np
import pytest

from offline_train.benchmarks.trigger import feature_parity


def test_without_a_device_interpreter_nothing_is_claimed(monkeypatch):
    monkeypatch.setattr(feature_parity, "_DEVICE", feature_parity._ROOT / "no" / "python")
    (line,) = feature_parity.feature_parity_lines(1)
    assert line.is_ok is None
    assert "no/python" in line.measured


@pytest.mark.skipif(not feature_parity._DEVICE.exists(), reason="no Python 3.7 in this checkout")
def test_the_device_gives_the_trainers_features(monkeypatch):
    monkeypatch.setattr(feature_parity, "N_PAIRS", 100)
    lines = feature_parity.feature_parity_lines(1)
    assert len(lines) == 3
    assert all(line.is_ok for line in lines)


@pytest.mark.skipif(not feature_parity._DEVICE.exists(), reason="no Python 3.7 in this checkout")
def test_a_difference_misses_the_goal(monkeypatch):
    monkeypatch.setattr(feature_parity, "N_PAIRS", 50)
    answers = feature_parity._answers
    monkeypatch.setattr(
        feature_parity,
        "_answers",
        lambda cases: {name: value + 1e-6 for name, value in answers(cases).items()},
    )
    lines = feature_parity.feature_parity_lines(1)
    assert not any(line.is_ok for line in lines)
    assert all(np.isfinite(line.figures["value"]) for line in lines)
