import pytest

from offline_train.benchmarks.trigger import committed, tabletop

pytest.importorskip("sklearn")


def value(lines, what):
    (found,) = [line for line in lines if line.what == what]
    return found.figures["value"]


@pytest.fixture(scope="module")
def table():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tabletop, "N_TRAIN", 1000)
        patch.setattr(tabletop, "N_BENCH", 1000)
        yield tabletop.measure(7)


@pytest.fixture(scope="module")
def moves():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(committed, "N_TRAIN", 120)
        patch.setattr(committed, "N_BENCH", 120)
        yield committed.measure(7)


def test_each_goal_of_the_tabletop_is_a_line_with_a_verdict(table):
    judged = {line.what: line.goal for line in table if line.is_ok is not None}
    assert judged == {
        "15 frames, 5 s, linear: false alarms at .99 recall": "<= 0.07",
        "20 frames, 5 s, linear: false alarms at .99 recall": "<= 0.045",
        "15 frames, 3 s, linear: false alarms at .99 recall": "<= 0.03",
        "15 frames, 5 s, linear: ECE, 15 bins": "<= 0.01",
        "15 frames, 5 s, linear: Brier": "<= 0.022",
        "5 frames, 5 s, linear: ECE, 15 bins": "<= 0.01",
        "5 frames, 5 s, linear: Brier": "<= 0.065",
    }


def test_a_longer_window_and_a_model_pay(table):
    short, long = (
        value(table, f"{frames} frames, 5 s, linear: false alarms at .99 recall")
        for frames in (5, 20)
    )
    assert long < 0.5 * short
    for rule in ("speed only", "paper risk"):
        assert value(table, f"20 frames, 5 s, {rule}: false alarms at .99 recall") > 3.0 * long


def test_what_the_gate_drops_can_never_fire(table):
    where = "5 frames, 5 s, behind the gate"
    assert value(table, f"{where}: recall lost to it") > 0.05
    assert value(table, f"{where}, linear: false alarms at .99 recall") == 1.0
    assert value(table, f"{where}: share of harmless pairs judged") < 0.3


def test_each_goal_of_committed_motion_is_a_line_with_a_verdict(moves):
    judged = {line.what: line.goal for line in moves if line.is_ok is not None}
    assert judged == {
        "all windows, linear: average precision": ">= 0.77",
        "all windows: boosting ahead of linear by": "<= 0.02",
        "all windows, linear: false alarms at .90 recall": "<= 0.12",
        "all windows, linear: false alarms at .99 recall": "<= 0.25",
    }


def test_several_windows_beat_each_single_one(moves):
    together = value(moves, "all windows, linear: average precision")
    for window in (5, 11, 20):
        assert together > value(moves, f"{window} frames, linear: average precision")
    assert together > value(moves, "speed only: average precision") + 0.2
