import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from twin_recordings import frames, record

from apex_edge import graph
from apex_edge.assemble import ApexConfig
from apex_edge.cli import main
from apex_edge.errors import RecordingError
from apex_edge.perception import ColourTable, Perception
from apex_edge.record.mcap_io import RecordingReader
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.linear import LinearTrigger
from apex_edge.twin.scenarios import make
from apex_edge.twin.world import TwinWorld
from offline_train.scenes import recordings
from offline_train.trigger import calibrate, certify, recorded, scoring

N_COLLISIONS = 8
FROM_S = 1.0
RIG = recorded.Rig(ApexConfig(), 5.0)
EXAMPLE = Path(__file__).parents[2] / "examples" / "small-collision.mcap"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder of collisions and the true times of contact by file name."""
    home = tmp_path_factory.mktemp("runs")
    truth = {}
    for seed in range(N_COLLISIONS):
        path = home / f"run-{seed:02d}.mcap"
        world = record("collision", 300 + seed, path, FROM_S)
        truth[path.name] = min(world.contacts.values())
    return home, truth


@pytest.fixture(scope="module")
def seen(folder):
    return recorded.read_folder(folder[0], RIG)[0]


@pytest.fixture(scope="module")
def near_miss():
    world = TwinWorld(make("near-miss", 204))
    return recordings.follow(frames(world, 0.5), RIG.config, RIG.horizon_s, "near miss")


def test_contacts_are_found_where_the_twin_had_them(folder, seen):
    truth = np.array([folder[1][name] for name in sorted(folder[1])])
    first = np.full(N_COLLISIONS, np.inf)
    np.minimum.at(first, seen.scene, seen.contact_s)
    is_found = np.isfinite(first)
    assert is_found.sum() >= N_COLLISIONS - 1
    early = truth[is_found] - FROM_S - first[is_found]
    assert np.all(early > -0.2) and np.all(early < 0.6)


def test_a_near_miss_is_no_contact_and_its_end_is_left_out(near_miss):
    rows = recorded.observed(near_miss, RIG)
    assert not np.isfinite(rows.contact_s).any()
    assert len(rows.pair) and not rows.label.any()
    end = near_miss.t_s[-1]
    assert np.all(rows.frame * rows.frame_s[rows.pair] + RIG.horizon_s <= end + 1e-6)


def test_labels_beside_a_recording_are_the_whole_truth(near_miss):
    other = next(n for n in near_miss.name.values() if n != "red")
    said = [recordings.Contact((other, "red"), 3.0)]
    rows = recorded.observed(near_miss, RIG, said)
    touched = np.isfinite(rows.contact_s)
    assert touched.sum() == 1
    assert rows.contact_s[touched][0] == pytest.approx(3.0 - near_miss.t_s[0], abs=0.1)
    assert rows.label.any()
    nobody = [recordings.Contact(("purple", "red"), 3.0)]
    with pytest.raises(RecordingError, match="purple"):
        recorded.observed(near_miss, RIG, nobody)


def test_a_labels_file_is_read_and_a_wrong_one_refused(tmp_path):
    path = tmp_path / "run.mcap"
    assert recordings.read_contacts(path) is None
    labels = tmp_path / "run.contacts.json"
    labels.write_text(json.dumps({"contacts": [{"names": ["a", "b"], "t_s": 1.5}]}))
    assert recordings.read_contacts(path) == [recordings.Contact(("a", "b"), 1.5)]
    for wrong in ("{", '{"contacts": [{"names": ["a"], "t_s": 1}]}', "[1]", '{"contacts": 3}'):
        labels.write_text(wrong)
        with pytest.raises(RecordingError, match="labels file"):
            recordings.read_contacts(path)


def test_a_recording_ends_where_the_arm_first_moves():
    whole = list(RecordingReader(EXAMPLE))
    part = list(recordings.until_arm_moves(EXAMPLE))
    assert 0 < len(part) < len(whole)
    following = whole[len(part)].arm
    assert following is not None and following.is_moving


def test_the_rows_are_what_the_device_judges(tmp_path):
    world = TwinWorld(make("collision", 300))
    pictures = list(frames(world, FROM_S))
    followed = recordings.follow(pictures, RIG.config, RIG.horizon_s)
    rows = recorded.observed(followed, RIG)
    # Without chances a probability says which logit it was; level ones would hide a difference.
    shipped = model_file.read(weights.SHIPPED)
    fields = {key: value for key, value in shipped.items() if key != "chances"}
    model_file.write(fields, tmp_path / "plain.json")
    chance = 1.0 / (1.0 + np.exp(-scoring.scorer(fields)(rows)))
    perception = Perception(RIG.config.perception, ColourTable.builtin())
    trigger = LinearTrigger(weights_path=tmp_path / "plain.json")
    older, said, number = None, {}, -1
    for picture in pictures:
        _, tracks = perception.step(picture)
        if picture.is_repeated:
            continue
        newer, number = graph.build(tracks), number + 1
        if older is not None:
            scores = trigger.score(graph.difference(older, newer), RIG.horizon_s)
            names = {int(i): n for i, n in zip(tracks.track_id, tracks.name)}
            for edge, pair in enumerate(zip(scores.mover_id, scores.target_id)):
                if not scores.is_fallback[edge] and "red" in {names[int(i)] for i in pair}:
                    said.setdefault(number, []).append(float(scores.probability[edge]))
        older = newer
    n_same = 0
    for frame, value in zip(rows.frame.tolist(), chance.tolist()):
        n_same += any(abs(value - other) < 1e-9 for other in said.get(frame, []))
    assert n_same > 15 and n_same >= 0.9 * len(chance)


def followed_by_hand(places):
    """Return two tracks, 30 mm and 20 mm wide, at places {id: (f, 2)} at 20 Hz."""
    followed = recordings.Followed("by hand")
    followed.t_s = [0.05 * frame for frame in range(len(places[1]))]
    for track, path in places.items():
        followed.name[track] = {1: "red", 2: "green ball"}[track]
        followed.place[track] = dict(enumerate(path))
        followed.radius_m[track] = [{1: 0.015, 2: 0.01}[track]] * len(path)
        followed.speed_sd[track] = dict.fromkeys(range(len(path)), 0.001)
        followed.n_samples[track] = dict.fromkeys(range(len(path)), 20)
    return followed


def along_x(x_m, y_m=0.0):
    return np.column_stack([x_m, np.full(len(x_m), y_m)])


def test_a_way_cut_short_by_either_end_is_no_change_of_speed():
    red = along_x(np.zeros(60))
    # Past at 1.1 times the reach (29 mm), at constant speed, the nearest at one end.
    leaving = 0.1 * 0.05 * np.arange(60)
    for x_m in (leaving, leaving[::-1]):
        followed = followed_by_hand({1: red, 2: along_x(x_m, 0.032)})
        assert recordings.contact_times(followed, [(1, 2)]).tolist() == [np.inf]


def test_what_is_struck_and_runs_ahead_was_not_the_mover():
    t_s = 0.05 * np.arange(80)
    hit_s = 3.0
    ball = along_x(np.where(t_s < hit_s, -0.03 - 0.1 * (hit_s - t_s), -0.03))
    red = along_x(0.3 * np.maximum(t_s - hit_s, 0.0))
    rows = recorded.observed(
        followed_by_hand({1: red, 2: ball}),
        RIG,
        [recordings.Contact(("red", "green ball"), hit_s)],
    )
    assert np.flatnonzero(rows.is_clear[0]).tolist() == list(range(60))
    assert calibrate.is_eligible(rows, 1.0).tolist() == [True]


def test_frames_of_which_nobody_saw_what_came_are_not_judged(near_miss):
    rows = recorded.observed(near_miss, RIG)
    time = np.arange(rows.is_judged.shape[1]) * rows.frame_s[0]
    is_known = time + RIG.horizon_s <= time[-1]
    assert rows.is_judged[:, is_known].any() and not rows.is_judged[:, ~is_known].any()


def command(home, out, *more):
    model = str(weights.SHIPPED)
    arguments = ["--recordings", str(home), "--model", model, "--out", str(out), *more]
    return main(["train", "recalibrate", *arguments])


def test_recalibration_changes_the_threshold_and_nothing_else(folder, seen, tmp_path, capsys):
    out = tmp_path / "mine.json"
    assert command(folder[0], out, "--alpha", "0.5", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    old, new = model_file.read(weights.SHIPPED), model_file.read(out)
    changed = {key for key in old if old[key] != new[key]}
    assert changed == {"threshold", "provenance", "metrics", "sha256"}
    assert shown["logit"] == new["threshold"]["logit"] == weights.load(out).threshold
    assert new["threshold"]["n_pos"] >= 5 and new["threshold"]["alpha"] == 0.5
    origin = new["provenance"]["certified_on"]
    assert sorted(origin["recordings"]) == sorted(folder[1])
    assert all(len(value) == 64 for value in origin["recordings"].values())
    # by construction at most rank - 1 of the events fall below
    config = certify.gate_of(new)
    scores = calibrate.event_scores(seen, scoring.device_scorer(new)(seen), config, 1.0)
    assert np.sum(scores < new["threshold"]["logit"]) == new["threshold"]["k"] - 1


def test_too_few_recordings_are_refused_with_the_number_that_is_needed(folder, tmp_path, capsys):
    few = tmp_path / "few"
    few.mkdir()
    for path in sorted(folder[0].glob("*.mcap"))[:2]:
        (few / path.name).write_bytes(path.read_bytes())
    out = tmp_path / "mine.json"
    assert command(few, out, "--alpha", "0.05") != 0
    assert "59 are needed" in capsys.readouterr().err
    assert not out.exists()


def test_events_outside_the_model_s_domain_certify_nothing(seen):
    fields = model_file.read(weights.SHIPPED)
    narrow = replace(seen, geometry=replace(seen.geometry, radius_m=seen.geometry.radius_m + 9.0))
    with pytest.raises(calibrate.TooFewEventsError, match="outside the model's domain"):
        certify.certify(fields, narrow, calibrate.Promise(alpha=0.5), {})


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no recording"):
        recorded.read_folder(tmp_path, RIG)
