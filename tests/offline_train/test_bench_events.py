import numpy as np
import pytest

from offline_train.benchmarks.trigger import events
from offline_train.trigger import evaluate, observe, seeds
from offline_train.trigger.calibrate import voted


def test_the_leaky_sum_by_hand():
    seen = observe.observe(
        seeds.rng("test", 4), "committed", 3, events.WATCHING, events.TriggerConfig()
    )
    logit = np.full(len(seen.pair), 1.0)
    sums = events.leaky_sum(seen, logit, start=-1.0, keep=0.5, limit=3.5)
    is_row = np.zeros(seen.is_judged.shape, dtype=bool)
    is_row[seen.pair, seen.frame] = True
    assert is_row.any() and np.all(np.isfinite(sums) == is_row)
    pair, start = np.argwhere(is_row & ~np.roll(is_row, 1, axis=1))[0]
    run = int(np.argmin(is_row[pair, start:])) or is_row.shape[1] - start
    assert run >= 4
    # 2, 0.5 * 2 + 2, and then the limit
    assert sums[pair, start : start + 4].tolist() == [2.0, 3.0, 3.5, 3.5]


def test_a_cut_for_a_recall_gives_that_recall():
    config = events.TriggerConfig()
    seen = observe.observe(seeds.rng("test", 5), "committed", 80, events.WATCHING, config)
    vote = voted(seen, seen.speed_m_s, config)
    for recall in (0.5, 0.9):
        cut = evaluate.cut_for(seen, vote, 1.0, recall)
        fires = np.isfinite(vote) & (vote >= cut)
        found = evaluate.alarms(seen, fires, evaluate.Testing(config))["recall"]
        n = int(evaluate.is_eligible(seen, 1.0).sum())
        assert n > 10 and recall <= found < recall + 1.5 / n


def test_the_bench_states_goals_shares_baselines_and_leads(monkeypatch):
    pytest.importorskip("sklearn")
    monkeypatch.setattr(events, "N_SCENES", 250)
    lines = events.measure(900)
    said = {line.what: line for line in lines}
    assert sum(line.is_ok is not None for line in lines) == 4
    assert 0.2 < said["eligible share of contacts"].figures["value"] < 0.9
    rows = [line for line in lines if line.what.endswith("at this recall")]
    names = {line.what.split(":")[0] for line in rows}
    assert {*events.MODELS, *evaluate.BASELINES, "leaky sum", "vote 3 of 5"} <= names
    recall = {line.what.split(":")[0]: line.figures["recall"] for line in rows}
    first = next(iter(events.MODELS))
    assert all(recall[name] == recall[first] for name in evaluate.BASELINES)
    shares = [value for line in rows for value in line.figures.values()]
    assert all(0.0 <= share <= 1.0 for share in shares)
    assert any(line.what.startswith("announced 3.0 s ahead") for line in lines)
