"""``apex bench perception``: what it measures is real, and what is bad makes a line fail."""

import argparse
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from apex_edge.errors import ConfigError, InputError
from apex_edge.perception import ColourTable, PerceptionConfig, tracking
from apex_edge.perception.motion import MotionEstimator
from offline_train.benchmarks import lines
from offline_train.benchmarks import perception as bench
from offline_train.benchmarks.perception import (
    clips,
    cost,
    honesty,
    motion,
    peer,
    twin_clips,
)
from offline_train.benchmarks.perception import truth as truths

CONFIG = PerceptionConfig()


def options(*words):
    parser = argparse.ArgumentParser()
    bench.add_arguments(parser)
    return parser.parse_args([str(w) for w in words])


def line(found, what):
    (one,) = [ln for ln in found if what in ln.what]
    return one


@pytest.fixture(scope="module")
def own_clips(tmp_path_factory):
    """The twin's clips: name -> truth."""
    paths = twin_clips.write_all(tmp_path_factory.mktemp("clips"))
    return {path.parent.name: truths.load(path) for path in paths}


class TestLines:
    def test_a_figure_that_is_not_a_number_misses_its_goal(self):
        assert lines.at_most("s", "w", float("nan"), 1.0).is_ok is False
        assert lines.at_least("s", "w", float("nan"), 1.0).is_ok is False

    def test_nothing_promised_is_not_all_kept(self):
        assert not lines.are_all_ok([lines.note("s", "w", 1.0)])
        assert lines.are_all_ok([lines.note("s", "w", 1.0), lines.at_most("s", "w", 1.0, 1.0)])


class TestMotion:
    def test_the_papers_windows_err_as_the_facts_say(self):
        trials = motion.draw(np.random.RandomState(3), motion.bounce, 400)
        assert motion.peer_speed_error(trials, peer.two_windows) == pytest.approx(606.0, rel=0.03)
        trials = motion.draw(np.random.RandomState(3), motion.steady, 400)
        assert motion.peer_pos_error(trials) == pytest.approx(26.7, rel=0.03)

    def test_least_squares_reaches_the_limit_it_is_measured_by(self):
        trials = motion.draw(np.random.RandomState(3), motion.steady, 3000)
        found = motion.peer_speed_error(trials, peer.line_fit)
        limit = motion.limit_px_s(trials.t_s, 10, motion.N_SIGHTINGS)
        assert found / limit == pytest.approx(1.0, abs=0.05)

    def test_ours_finds_position_and_speed_in_steady_motion(self):
        found = motion.measure(seed=2, n_trials=40, is_quiet=True)
        assert line(found, "position now at 400 px/s").is_ok
        assert line(found, "sightings until the first speed").measured == "3"

    def test_an_estimator_that_lags_makes_lines_fail(self, monkeypatch):
        class Late(MotionEstimator):
            def predict(self, t_s):
                return super().predict(t_s - 2.0 / 30.0)

        monkeypatch.setattr(motion, "MotionEstimator", Late)
        found = motion.measure(seed=2, n_trials=40, is_quiet=True)
        assert line(found, "position now at 400 px/s").is_ok is False
        assert not lines.are_all_ok(found)


class TestCost:
    def test_ours_and_the_papers_pipeline_find_the_same_two_balls(self):
        found = cost.measure(n_repeats=1, is_quiet=True)
        assert line(found, "ours off the true centres").is_ok
        assert line(found, "paper's pipeline off by").figures["value"] < 4.0

    def test_a_ratio_comes_from_the_clock(self):
        """Each reading of this clock is one more, so every form takes exactly as long."""
        ticks = iter(range(1_000_000))
        found = cost.measure(n_repeats=1, clock=lambda: next(ticks), is_quiet=True)
        assert line(found, "full 640x480").figures["value"] == 1.0
        assert line(found, "full 640x480").is_ok is False

    def test_the_number_of_opencv_threads_is_put_back(self):
        before = cv2.getNumThreads()
        cost.measure(n_repeats=1, is_quiet=True)
        assert cv2.getNumThreads() == before


class TestHonesty:
    def errors(self, scale, n=400, seed=1, dof=2):
        rng = np.random.RandomState(seed)
        squared = scale * np.square(rng.standard_normal((n, dof))).sum(axis=1)
        return [honesty.Errors(squared, dof)]

    @pytest.mark.parametrize("scale, is_inside", [(1.0, True), (1.5, False), (0.6, False)])
    def test_only_an_honest_covariance_lies_in_the_band(self, scale, is_inside):
        assert honesty.consistency(self.errors(scale)).is_inside is is_inside

    def test_five_of_a_hundred_lie_beyond_when_it_is_honest(self):
        found = honesty.consistency(self.errors(1.0, n=20_000))
        assert found.beyond == pytest.approx(0.05, abs=0.01)

    def test_neighbours_that_are_alike_count_less(self):
        once = self.errors(1.0, n=200)[0]
        alike = honesty.Errors(np.repeat(once.squared, 5), 2)
        plain, repeated = honesty.consistency([once]), honesty.consistency([alike])
        assert repeated.n == 5 * plain.n
        assert repeated.n_independent < 2.0 * plain.n_independent
        assert repeated.high - repeated.low > 0.7 * (plain.high - plain.low)

    def test_an_estimator_that_claims_too_much_is_found_out(self, own_clips, monkeypatch):
        class Boaster(MotionEstimator):
            def predict(self, t_s):
                state = super().predict(t_s)
                return state._replace(cov=1e-4 * state.cov)

            def noise_sd(self, sd):
                return 0.01 * super().noise_sd(sd)

        truth = own_clips["three_of_one"]
        monkeypatch.setattr(honesty, "MIN_SEEN", 3)
        monkeypatch.setattr(tracking, "MotionEstimator", Boaster)
        monkeypatch.setattr("offline_train.benchmarks.perception.recorder.MotionEstimator", Boaster)
        run = clips.play(truth, clips.colours_of(truth), CONFIG)
        found = honesty.measure_clip("boaster", truth, run)
        assert found[0].is_ok is False
        assert found[0].figures["mean"] > 10.0

    def test_listening_puts_the_trackers_estimator_back(self):
        original = tracking.MotionEstimator
        with honesty.listening():
            assert tracking.MotionEstimator is not original
        assert tracking.MotionEstimator is original


class TestClips:
    def play(self, truth, table=None):
        run = clips.play(truth, table or clips.colours_of(truth), CONFIG)
        return clips.lines_of("clip", truth, run)

    @pytest.mark.parametrize("name", ["crossing", "leaving"])
    def test_the_twins_own_clips_are_judged_right(self, own_clips, name):
        found = self.play(own_clips[name])
        assert all(ln.is_ok is not False for ln in found), found

    def test_a_clip_has_labels_absences_and_runs_to_judge(self, own_clips):
        assert own_clips["leaving"].absent
        assert own_clips["three_of_one"].straight_runs
        assert len({c.identity for c in own_clips["eleven"].centres}) == 11

    def test_a_colour_that_is_not_there_makes_the_clip_fail(self, own_clips):
        truth = own_clips["crossing"]
        purple = [m for m in ColourTable.builtin().models if m.name == "purple"]
        found = self.play(truth, ColourTable([replace(purple[0], name="green")]))
        assert line(found, "labelled centres").is_ok is False

    def test_a_wrong_label_a_wrong_absence_and_a_wrong_speed_are_told(self, own_clips):
        truth = own_clips["three_of_one"]
        far = [replace(c, x_px=c.x_px + 30.0) for c in truth.centres[:8]]
        run = truth.straight_runs[0]
        wrong = replace(
            truth,
            centres=(*far, *truth.centres[8:]),
            absent=((4, ("blue",)),),
            straight_runs=(replace(run, vx_px_s=run.vx_px_s + 40.0),),
        )
        found = self.play(wrong)
        assert line(found, "labelled centres").is_ok is False
        assert line(found, "reports in 1 labelled").figures["value"] == 3.0
        assert line(found, "velocities").is_ok is False

    def test_a_switch_of_identity_is_counted(self, own_clips):
        truth = own_clips["crossing"]
        run = clips.play(truth, clips.colours_of(truth), CONFIG)
        late = len(run.seen) // 2
        seen = tuple(
            s if i < late else s._replace(track_id=3 - s.track_id) for i, s in enumerate(run.seen)
        )
        assert clips.score(truth, run).n_switches == 0
        assert clips.score(truth, replace(run, seen=seen)).n_switches == 2

    def test_identity_is_not_judged_where_labels_do_not_tell_it(self, own_clips):
        truth = own_clips["crossing"]
        nameless = replace(truth, centres=tuple(replace(c, identity="") for c in truth.centres))
        run = clips.play(truth, clips.colours_of(truth), CONFIG)
        assert clips.score(nameless, run).n_switches is None

    def test_teach_names_the_frames_that_teach(self, own_clips):
        truth = own_clips["two_colours"]
        assert {c.frame for c in clips.teachers(replace(truth, teach=(8,)))} == {8}
        assert {c.name for c in clips.teachers(truth)} == {"red", "green"}
        with pytest.raises(InputError, match=r"teach names frames \[7\]"):
            clips.teachers(replace(truth, teach=(7,)))

    def test_a_video_of_another_size_or_too_short_is_refused(self, own_clips):
        truth = own_clips["two_colours"]
        with pytest.raises(InputError, match="pictures are 640x480"):
            list(clips.frames_of(replace(truth, size_px=(320, 240))))
        late = replace(truth, absent=((500, ("red",)),))
        with pytest.raises(InputError, match="labels frame 500"):
            list(clips.frames_of(late))


def sound_truth():
    return {
        "video": "clip.avi",
        "size_px": [640, 480],
        "n_frames": 30,
        "nominal_fps": 29.97,
        "tolerance_px": 4,
        "centres": [{"frame": 3, "name": "red", "x_px": 5.5, "y_px": 6, "area_px2": 80}],
        "absent": [{"frame": 5, "names": ["red"]}],
        "straight_runs": [
            {"name": "red", "first": 3, "last": 9, "vx_px_s": 1, "vy_px_s": 2, "tolerance_px_s": 3}
        ],
        "notes": "other keys are left alone",
    }


class TestTruth:
    def load(self, folder, document):
        path = folder / "truth.json"
        path.write_text(document if isinstance(document, str) else json.dumps(document))
        return truths.load(path)

    def test_a_sound_file_is_read(self, tmp_path):
        truth = self.load(tmp_path, sound_truth())
        assert truth.video == tmp_path / "clip.avi"
        assert truth.names == ("red",)
        assert truth.centres[0].tolerance_px == 4.0
        assert truth.last_frame == 9

    @pytest.mark.parametrize(
        "change, message",
        [
            ({"video": None}, "video: expected a text, found None"),
            ({"video": "../other.mp4"}, "video: expected a file or folder beside"),
            ({"size_px": [640]}, r"size_px: expected \[width, height\]"),
            ({"tolerance_px": "4"}, "tolerance_px: expected a number"),
            ({"tolerance_px": float("nan")}, "tolerance_px: expected a number"),
            ({"nominal_fps": 0}, "nominal_fps: expected a number"),
            ({"centres": []}, "centres: expected at least one"),
            ({"centres": [3]}, "centres: expected a list of objects"),
            ({"centres": [{"frame": 3}]}, r"centres\[0\].name: expected a text, found nothing"),
            ({"absent": [{"frame": -1, "names": []}]}, r"absent\[0\].frame: expected a whole"),
            ({"absent": [{"frame": 1, "names": "red"}]}, r"absent\[0\].names: expected a list"),
            ({"n_frames": 9}, "n_frames: expected more than 9"),
            ({"n_frames": True}, "n_frames: expected a whole number"),
            ({"teach": [1.5]}, "teach: expected a list of frame numbers"),
        ],
    )
    def test_what_is_wrong_is_named_by_file_and_key(self, tmp_path, change, message):
        with pytest.raises(InputError, match=message) as caught:
            self.load(tmp_path, {**sound_truth(), **change})
        assert "truth.json" in str(caught.value)

    def test_a_run_of_an_unlabelled_object_or_of_two_frames_is_refused(self, tmp_path):
        document = sound_truth()
        document["straight_runs"][0]["name"] = "blue"
        with pytest.raises(InputError, match="not 'blue'"):
            self.load(tmp_path, document)
        document = sound_truth()
        document["straight_runs"][0]["last"] = 4
        with pytest.raises(InputError, match=r"straight_runs\[0\].last: expected at least 5"):
            self.load(tmp_path, document)

    @pytest.mark.parametrize("text, message", [("{", "not JSON"), ("[]", "expected an object")])
    def test_a_file_that_holds_no_truth_is_refused(self, tmp_path, text, message):
        with pytest.raises(InputError, match=message):
            self.load(tmp_path, text)

    def test_a_folder_without_clips_is_refused(self, tmp_path):
        with pytest.raises(InputError, match="holds no labelled clip"):
            truths.find_clips(tmp_path)
        with pytest.raises(InputError, match="no such folder"):
            truths.find_clips(tmp_path / "gone")


class TestCommand:
    def test_a_missed_goal_gives_exit_code_1_and_stands_in_the_report(
        self, own_clips, tmp_path, monkeypatch, capsys
    ):
        bad = lines.at_most("clips", "what", 2.0, 1.0)
        monkeypatch.setattr(clips, "measure", lambda found, config: [bad])
        folder, file = own_clips["crossing"].folder, tmp_path / "lines.json"
        assert bench.run(options("--clips", folder, "--json", file)) == 1
        report = json.loads(file.read_text())
        assert report["is_ok"] is False
        assert report["lines"][0]["figures"] == {"value": 2.0}
        assert " NO" in capsys.readouterr().out

    def test_clips_alone_are_judged_when_clips_are_given(self, own_clips, capsys):
        assert bench.run(options("--clips", own_clips["crossing"].folder)) == 0
        out = capsys.readouterr().out
        assert "crossing: labelled centres" in out
        assert "Cramer-Rao" not in out

    @pytest.mark.parametrize("words", [("--n", 0), ("--seed", -1), ("--json", "gone/x.json")])
    def test_options_without_sense_are_refused(self, words):
        with pytest.raises(ConfigError):
            bench.run(options(*words))
