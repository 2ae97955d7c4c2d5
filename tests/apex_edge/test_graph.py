from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from trigger_scene import difference, tracks

from apex_edge import graph
from apex_edge.triggers.analytic import AnalyticTrigger
from apex_edge.triggers.base import TriggerConfig
from apex_edge.types import TrackStatus


def ids_of(scene, rows):
    return [tuple(sorted(scene.tracks.track_id[edge])) for edge in scene.edges[rows]]


def test_every_pair_is_one_edge_with_its_offset_and_motion():
    scene = graph.build(tracks([[0, 0], [0.3, 0], [0.3, 0.4]], [[0.1, 0], [0, 0], [0, -0.2]]))
    assert scene.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert np.allclose(scene.distance_m, [0.3, 0.5, 0.4])
    assert np.allclose(scene.offset_m[1], [0.3, 0.4, 0.0])
    assert np.allclose(scene.rel_vel_m_s[1], [-0.1, -0.2, 0.0])


def test_lost_and_unplaced_tracks_are_left_out_everywhere():
    found = tracks([[0, 0], [0.1, 0], [0.2, 0], [np.nan, 0]])
    status = np.array([TrackStatus.SEEN, TrackStatus.LOST, TrackStatus.PREDICTED, TrackStatus.SEEN])
    scene = graph.build(replace(found, status=status))
    assert scene.tracks.name == ("red", "blue")
    assert scene.tracks.track_id.tolist() == [1, 3]
    assert scene.tracks.cov.shape == (2, 6, 6)
    assert scene.edges.tolist() == [[0, 1]]


@pytest.mark.parametrize("n", [0, 1])
def test_a_table_without_pairs_gives_a_graph_without_edges(n):
    scene = graph.build(tracks(np.zeros((n, 2))))
    assert scene.edges.shape == (0, 2)
    diff = graph.difference(scene, scene)
    assert diff.displacement_m.shape == (0, 3)
    assert diff.vanished == ()
    scores = AnalyticTrigger(TriggerConfig()).score(diff, 5.0)
    assert graph.summarise(diff, scores, 3, 5.0) == graph.NOTHING
    assert len(scores.is_fired) == 0


def test_the_difference_follows_tracks_and_not_their_order():
    older = graph.build(tracks([[0, 0], [0.3, 0], [0, 0.5]], track_id=np.array([7, 3, 9]), t_s=1.0))
    newer = graph.build(
        tracks([[0, 0.4], [0.01, 0], [0.3, 0.02]], track_id=np.array([9, 7, 3]), t_s=1.5)
    )
    diff = graph.difference(older, newer)
    for row, (i, j) in enumerate(newer.edges):
        ids = newer.tracks.track_id[[i, j]]
        before = [older.tracks.pos_m[older.tracks.track_id.tolist().index(k)] for k in ids]
        after = newer.tracks.pos_m[[i, j]]
        assert np.allclose(
            diff.displacement_m[row], (after[1] - after[0]) - (before[1] - before[0])
        )
    assert diff.dt_s == pytest.approx(0.5)
    assert not diff.is_new.any()


def test_relations_that_begin_and_end_are_told_apart():
    older = graph.build(tracks([[0, 0], [0.3, 0], [0, 0.5]], track_id=np.array([1, 2, 3])))
    newer = graph.build(
        tracks([[0, 0], [0.3, 0], [0.1, 0.1]], track_id=np.array([1, 2, 4]), t_s=2.0)
    )
    diff = graph.difference(older, newer)
    assert ids_of(newer, diff.is_new) == [(1, 4), (2, 4)]
    assert sorted(diff.vanished) == [(1, 3), (2, 3)]
    assert np.all(diff.displacement_m[diff.is_new] == 0.0)


def test_from_nothing_everything_is_new_and_to_nothing_everything_has_vanished():
    empty, full = graph.build(tracks(np.zeros((0, 2)))), graph.build(tracks([[0, 0], [1, 0]]))
    assert graph.difference(empty, full).is_new.all()
    assert graph.difference(full, empty).vanished == ((1, 2),)


@given(st.integers(0, 10_000))
def test_displacement_over_time_is_the_closing_speed_of_straight_motion(seed):
    rng = np.random.RandomState(seed)
    now = tracks(rng.uniform(-0.3, 0.3, (5, 2)), rng.uniform(-0.2, 0.2, (5, 2)))
    diff = difference(now, dt_s=0.001)
    assert np.allclose(diff.displacement_m[:, :2], 0.001 * diff.rel_vel_m_s[:, :2], atol=1e-12)
    before = np.linalg.norm(diff.graph.offset_m - diff.displacement_m, axis=1)
    assert np.allclose(before - diff.graph.distance_m, 0.001 * diff.closing_m_s, atol=1e-5)


def scores_for(probability, ttc_s):
    now = tracks(np.zeros((3, 2)) + np.arange(3)[:, None])
    scores = AnalyticTrigger(TriggerConfig()).score(difference(now), 5.0)
    return replace(scores, probability=np.array(probability), ttc_s=np.array(ttc_s))


def test_top_k_takes_the_most_likely_then_the_soonest():
    scores = scores_for([0.2, 0.9, 0.9], [1.0, 3.0, 2.0])
    assert graph.top_k(scores, 2).tolist() == [2, 1]
    assert graph.top_k(scores, 9).tolist() == [2, 1, 0]
    assert graph.top_k(scores, 0).tolist() == []


def test_a_score_that_is_not_a_number_comes_last():
    assert graph.top_k(scores_for([np.nan, 0.1, 0.0], [np.nan, 3.0, np.inf]), 1).tolist() == [1]


def said(now, k=3, horizon_s=5.0):
    diff = difference(now)
    trigger = AnalyticTrigger(TriggerConfig(persist_hits=1, k_sigma=3.0))
    return graph.summarise(diff, trigger.score(diff, horizon_s), k, horizon_s)


def test_a_contact_is_named_with_its_time():
    # centres 0.25 m apart, radii 0.03 together, 0.1 m/s: 2.2 s
    assert said(tracks([[0, 0], [0.25, 0]], [[0, 0], [-0.1, 0]])) == "green will touch red in 2.2 s"


def test_a_near_miss_is_named_with_its_gap_from_edge_to_edge():
    # passes 0.042 m from the centre, 0.012 m from the edge
    found = said(tracks([[0, 0], [0.21, 0.042]], [[0, 0], [-0.1, 0]]))
    assert found == "green will pass within 1.2 cm of red in 2.1 s"


def test_an_approach_that_outlasts_the_horizon_is_said_to_be_nearing():
    # 0.305 m of the 0.315 m gap in 5 s
    found = said(tracks([[0, 0], [0.345, 0.0]], [[0, 0], [-0.061, 0]]))
    assert found == "green is nearing red and will be 1.0 cm away in 5.0 s"


def test_a_touch_now_is_said_to_be_now():
    assert said(tracks([[0, 0], [0.029, 0]], [[0, 0], [-0.1, 0]])) == "green touches red now"


def test_a_quiet_table_is_said_to_be_quiet():
    assert said(tracks([[0, 0], [0.25, 0], [0.1, 0.1]])) == graph.NOTHING
    assert said(tracks([[0, 0], [0.25, 0]], [[0, 0], [0.1, 0]])) == graph.NOTHING


def test_the_summary_keeps_to_k_relations_and_leads_with_the_surest():
    now = tracks([[0, 0], [0.25, 0], [0, 0.2]], [[0, 0], [-0.1, 0], [0.0, -0.1]])
    assert said(now, k=1) == "blue will touch red in 1.7 s"
    assert said(now, k=2) == "blue will touch red in 1.7 s; green will touch red in 2.2 s"


def test_objects_of_one_name_are_told_apart_by_track():
    now = tracks([[0, 0], [0.25, 0], [0.1, 0.3]], [[0, 0], [-0.1, 0], [0, 0]])
    assert said(replace(now, name=("red", "green", "green"))) == "green #2 will touch red in 2.2 s"


@given(st.text(max_size=60), st.text(max_size=60))
def test_no_character_from_outside_reaches_the_summary(first, second):
    now = replace(tracks([[0, 0], [0.25, 0]], [[0, 0], [-0.1, 0]]), name=(first, second))
    found = said(now)
    assert set(found) <= set("abcdefghijklmnopqrstuvwxyz0123456789 _-#.")
    assert len(found) < 120
