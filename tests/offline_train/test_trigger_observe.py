from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.wide import WIDE_NAMES, wide_features
from apex_edge.triggers.windows import WINDOWS, History, line_pairs
from offline_train.scenes import committed
from offline_train.trigger import observe, seeds

WATCHING = observe.Watching(
    noise_m=(0.002, 0.002), fps=(20.0, 20.0), window=(7, 7), n_frames=60, is_wide=True
)
N = 12


class NoNoise:
    def normal(self, size):
        return np.zeros(size)


def look(watching=WATCHING, rng=None, n=N):
    source = seeds.rng("train", 4)
    sensing = observe.draw_sensing(source, n, watching)
    truth = committed.draw(source, sensing.frame_s, watching.n_frames)
    config = TriggerConfig()
    return truth, sensing, observe.look(rng or source, truth, sensing, watching, config)


def test_the_wide_features_are_those_the_device_works_out_frame_by_frame():
    truth, sensing, seen = look(rng=NoNoise())
    checked = 0
    for scene in range(N):
        history = History(WINDOWS)
        bodies = np.concatenate([truth.centre_m[scene][None], truth.other_m[scene]])
        for frame in range(WATCHING.n_frames):
            t_s = frame * truth.frame_s[scene]
            sighting = np.pad(bodies[:, frame], ((0, 0), (0, 1)))
            told = np.full(len(bodies), sensing.told_sd_m[scene])
            history.update(
                SimpleNamespace(
                    track_id=np.arange(len(bodies)), t_s=t_s, seen_m=sighting, seen_sd_m=told
                )
            )
            rows = np.flatnonzero((seen.scene[seen.pair] == scene) & (seen.frame == frame))
            lines = history.lines(t_s)
            radius = seen.geometry.radius_m[rows]
            views = [line_pairs(line, seen.bodies[rows], radius) for line in lines]
            expected = wide_features(views, WATCHING.horizon_s)
            assert np.allclose(seen.wide[rows], expected, rtol=1e-6, atol=1e-6)
            checked += len(rows)
    assert checked > 100
    assert (seen.frame < max(WINDOWS) - 1).any()
    assert seen.wide.shape[1] == len(WIDE_NAMES)


def test_without_wide_there_are_no_wide_columns_and_the_rest_is_the_same():
    _, _, with_wide = look()
    _, _, without = look(replace(WATCHING, is_wide=False))
    assert without.wide.shape == (len(without.pair), 0)
    assert np.array_equal(with_wide.features, without.features)


def test_without_the_gate_every_judged_pair_is_a_row_and_gated_rows_are_among_them():
    _, _, gated = look()
    _, _, free = look(replace(WATCHING, is_gated=False))
    assert len(free.pair) == free.is_judged.sum() > len(gated.pair) > 0
    at = {key: i for i, key in enumerate(zip(free.pair.tolist(), free.frame.tolist()))}
    rows = [at[key] for key in zip(gated.pair.tolist(), gated.frame.tolist())]
    assert np.array_equal(free.features[rows], gated.features)
    assert np.array_equal(free.label[rows], gated.label)


def test_a_stride_keeps_the_last_frame_and_changes_no_row():
    _, _, every = look()
    _, _, some = look(replace(WATCHING, stride=7))
    assert np.all((WATCHING.n_frames - 1 - some.frame) % 7 == 0)
    kept = (WATCHING.n_frames - 1 - every.frame) % 7 == 0
    assert 0 < len(some.pair) == kept.sum()
    assert np.array_equal(every.features[kept], some.features)


def test_taking_rows_leaves_the_pairs():
    _, _, seen = look()
    some = seen.take(seen.label)
    assert len(some.pair) == len(some.wide) == len(some.geometry.radius_m) == seen.label.sum()
    assert np.all(some.label) and len(some.kind) == len(seen.kind)


@pytest.mark.parametrize("n_scenes", [1, 3])
def test_scenes_without_contact_can_all_be_left_out(n_scenes):
    seen = observe.observe(
        seeds.rng("calibration", 1),
        "tabletop-cv",
        n_scenes,
        replace(WATCHING, n_frames=8),
        TriggerConfig(),
        only_contacts=True,
    )
    left = seen.contact_s.reshape(-1, 4)
    assert np.all(np.isfinite(left).any(axis=1))
