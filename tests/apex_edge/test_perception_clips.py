"""Real clips, where they are at hand: a colour taught from one frame, then followed."""

from dataclasses import replace

import pytest

from apex_edge.perception import PerceptionConfig
from offline_train.benchmarks.perception import clips
from offline_train.benchmarks.perception import truth as truths


def play(real_data, name, teacher):
    """Follow a clip with a colour taught from the label of that number alone."""
    truth = truths.load(real_data / "clips" / name / truths.FILE)
    truth = replace(truth, teach=(truth.centres[teacher].frame,))
    return truth, clips.play(truth, clips.colours_of(truth), PerceptionConfig())


@pytest.mark.parametrize(
    "name, teacher", [("dark_green", 3), ("orange_bounce", 0), ("orange_bounce", 7)]
)
def test_colour_taught_from_one_frame_follows_the_ball(real_data, name, teacher):
    truth, run = play(real_data, name, teacher)
    found = clips.score(truth, run)
    assert found.n_within >= clips.MIN_WITHIN * len(truth.centres), found.gaps_px
    assert found.n_reports == 0


def test_shadow_of_the_green_ball_is_not_reported(real_data):
    _, run = play(real_data, "dark_green", 3)
    assert max(len(seen.name) for seen in run.seen) == 1
