import argparse
import json
from dataclasses import replace

import numpy as np
import pytest

from apex_edge.errors import PluginError
from apex_edge.triggers.wide import WIDE_NAMES
from offline_train import verb
from offline_train.job_key import JobError
from offline_train.trigger import data
from offline_train.trigger.observe import Watching

pytest.importorskip("joblib")

SMALL = Watching(noise_m=(0.002, 0.002), window=(5, 8), n_frames=30)


def described(purpose="train", seed=1, n=6, watching=SMALL, name="committed"):
    return data.describe(name, purpose, seed, n, watching)


def written(folder, *args, **kwargs):
    description = described(*args, **kwargs)
    assert data.write(description, folder, is_quiet=True).exit_code == 0
    return description


@pytest.fixture(autouse=True)
def small_shards(monkeypatch):
    monkeypatch.setattr(data, "SCENES_EACH", 3)


def run(*arguments):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return verb.run(parser.parse_args(["generate", *map(str, arguments)]))


def test_what_was_written_is_read_with_its_description(tmp_path):
    description = written(tmp_path / "d", n=7)
    seen, found = data.read(tmp_path / "d", "train")
    assert found == description and found.watching == SMALL
    assert len(list((tmp_path / "d").glob("[0-9]*.npz"))) == 3
    assert len(seen.kind) == 4 * 7 and seen.scene.max() == 6
    assert len(seen.pair) == len(seen.features) > 10


def test_the_same_seed_gives_the_same_bytes_in_one_process_or_two(tmp_path):
    written(tmp_path / "a")
    assert data.write(described(), tmp_path / "b", n_jobs=2, is_quiet=True).exit_code == 0
    for path in sorted((tmp_path / "a").iterdir()):
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_no_two_purposes_and_no_two_shards_share_a_scene(tmp_path):
    paths = []
    for purpose in data.STORED_PURPOSES:
        written(tmp_path / purpose, purpose=purpose)
        seen, _ = data.read(tmp_path / purpose)
        paths.append(np.unique(seen.geometry.radius_m))
    together = np.concatenate(paths)
    assert len(np.unique(together)) == len(together)
    _, counts = np.unique(np.round(paths[0], 12), return_counts=True)
    assert np.all(counts == 1)


def test_data_of_another_purpose_is_refused(tmp_path):
    written(tmp_path / "d", purpose="calibration")
    with pytest.raises(data.DataError, match="drawn for calibration, expected train"):
        data.read(tmp_path / "d", "train")


def test_bench_scenes_are_never_stored():
    with pytest.raises(data.DataError, match="'bench': only train, calibration, test"):
        described(purpose="bench")


def test_a_broken_off_job_is_finished_and_only_what_is_missing_is_drawn(tmp_path):
    written(tmp_path / "whole")
    description = written(tmp_path / "d")
    (tmp_path / "d" / "0001.npz").unlink()
    with pytest.raises(JobError, match="0001.npz"):
        data.read(tmp_path / "d")
    summary = data.write(description, tmp_path / "d", is_quiet=True)
    assert (summary.n_kept, summary.n_done) == (1, 1)
    names = ("0000.npz", "0001.npz")
    for name in names:
        assert (tmp_path / "d" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_a_folder_of_other_data_is_left_alone(tmp_path):
    written(tmp_path / "d")
    before = (tmp_path / "d" / data.DESCRIPTION).read_bytes()
    with pytest.raises(data.DataError, match="holds other data"):
        data.write(described(seed=2), tmp_path / "d", is_quiet=True)
    assert (tmp_path / "d" / data.DESCRIPTION).read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"purpose": "test"}, "does not describe the shards"),
        ({"seed": 5}, "does not describe the shards"),
        ({"version": 9}, "does not describe the shards"),
        ({"n_scenes": "many"}, "damaged"),
        ({"surprise": 1}, "damaged"),
        ({"watching": {"fps": 3, "colour": 1}}, "damaged"),
        ({"purpose": "bench"}, "does not describe the shards"),
        ({"purpose": "none"}, "damaged"),
        ({"format": "other"}, "not a description"),
        ({"format_version": 99}, "version 99"),
    ],
)
def test_a_description_that_was_changed_is_refused(tmp_path, change, message):
    written(tmp_path / "d")
    path = tmp_path / "d" / data.DESCRIPTION
    path.write_text(json.dumps(dict(json.loads(path.read_text()), **change)))
    with pytest.raises(data.DataError, match=message):
        data.read(tmp_path / "d")


def test_a_missing_or_garbled_description_says_how_to_make_data(tmp_path):
    with pytest.raises(data.DataError, match="apex train generate"):
        data.read(tmp_path)
    (tmp_path / data.DESCRIPTION).write_bytes(b"\x00\xff{")
    with pytest.raises(data.DataError, match="cannot be read"):
        data.read(tmp_path)


def test_a_damaged_shard_is_refused(tmp_path):
    written(tmp_path / "d")
    path = tmp_path / "d" / "0000.npz"
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(JobError, match="0000.npz"):
        data.read(tmp_path / "d")


@pytest.mark.parametrize("name", sorted(data.STAR_SETS))
def test_star_sets_are_stored_in_the_same_form(tmp_path, name):
    description = data.describe(name, "train", 1, 7)
    data.write(description, tmp_path / "d", is_quiet=True)
    stars, found = data.read_stars(tmp_path / "d", "train")
    assert found == description and found.kind == data.STARS
    assert stars.node_t.shape == (7, 6, 7) and stars.truth.shape == (7, 5)
    assert len(np.unique(stars.node_t[:, 0, 1])) == 7
    with pytest.raises(data.DataError, match="holds stars data, expected watched"):
        data.read(tmp_path / "d")


def test_stars_cannot_be_watched_with_noise():
    with pytest.raises(data.DataError, match="star graphs are exact"):
        data.describe("leak-free", "train", 1, 7, SMALL)


def test_wide_features_are_stored_when_asked_for(tmp_path):
    watching = Watching(window=(5, 5), n_frames=30, is_wide=True)
    description = written(tmp_path / "d", watching=watching)
    seen, _ = data.read(tmp_path / "d")
    assert seen.wide.shape == (len(seen.pair), len(WIDE_NAMES))
    assert np.all(np.isfinite(seen.wide))
    assert "wide" in description.features


def test_generate_makes_a_folder_and_finds_it_done(tmp_path, capsys):
    options = ("--scenario", "tabletop-cv", "--scenes", 4, "--seed", 1, "--purpose", "test")
    seen = ("--noise-mm", "1:3", "--fps", 20, "--window", 5, "--frames", 20, "--horizon", 3)
    code = run(*options, *seen, "--out", tmp_path / "d", "--json")
    assert code == 0
    assert json.loads(capsys.readouterr().out)["n_done"] == 2
    assert run(*options, *seen, "--out", tmp_path / "d") == 0
    assert "2 were there, 0 drawn" in capsys.readouterr().out
    _, found = data.read(tmp_path / "d", "test")
    assert found.watching == Watching(
        noise_m=(0.001, 0.003), fps=(20.0, 20.0), window=(5, 5), n_frames=20, horizon_s=3.0
    )


def test_generate_fails_when_shards_cannot_be_drawn(tmp_path, monkeypatch, capsys):
    def draw(random, n):
        raise ZeroDivisionError("poison")

    monkeypatch.setitem(data.STAR_SETS, "leak-free", draw)
    options = ("--scenario", "leak-free", "--scenes", 4, "--seed", 1, "--purpose", "train")
    assert run(*options, "--out", tmp_path / "d") == 1
    assert "2 failed: see failed.json" in capsys.readouterr().out
    assert "poison" in (tmp_path / "d" / "failed.json").read_text()


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--noise-mm", "3:1", "noise_m"),
        ("--noise-mm", "0", "noise_m"),
        ("--fps", "500", "fps"),
        ("--window", "2", "window"),
        ("--window", "5:40", "window"),
        ("--horizon", "9", "horizon_s"),
        ("--scenes", "0", "0 scenes"),
        ("--seed", "-1", "seed -1"),
    ],
)
def test_options_that_make_no_sense_are_refused_before_anything_is_written(
    tmp_path, option, value, message
):
    options = {"--scenario": "committed", "--scenes": 4, "--seed": 1, "--purpose": "train"}
    options.update({"--frames": 30, "--window": "5", "--out": tmp_path / "d", option: value})
    with pytest.raises(data.DataError, match=message):
        run(*[part for pair in options.items() for part in pair])
    assert not (tmp_path / "d").exists()


def test_a_scenario_nobody_knows_is_refused():
    with pytest.raises(PluginError, match="comitted"):
        described(name="comitted")


def test_scenes_with_soft_labels_keep_the_rows_that_have_one_and_are_for_learning():
    pytest.importorskip("mujoco")
    watching = replace(SMALL, n_rollouts=8)
    seen = data.draw(data.describe("tabletop-pairs", "train", 1, 20, watching))
    assert len(seen.soft) > 20
    assert ((seen.soft >= 0.0) & (seen.soft <= 1.0)).all()
    assert np.abs(seen.soft - seen.label).mean() < 0.4
    with pytest.raises(data.DataError, match="soft labels are for scenes to learn from"):
        data.describe("tabletop-pairs", "test", 1, 20, watching)


@pytest.mark.parametrize("purpose", ["train", "test"])
def test_scenes_picked_by_their_contact_neither_teach_nor_test(tmp_path, purpose):
    picked = data.describe("tabletop-pairs", purpose, 1, 20, SMALL, only_contacts=True)
    data.write(picked, tmp_path / "d", is_quiet=True)
    with pytest.raises(data.DataError, match="only scenes that end in contact"):
        data.read(tmp_path / "d", purpose)
