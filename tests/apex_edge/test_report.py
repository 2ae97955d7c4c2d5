import base64
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
import record_steps

from apex_edge.errors import RecordingError
from apex_edge.record.charts import latency_chart, spread_of, stage_spreads, timeline
from apex_edge.record.report import write_report
from apex_edge.record.story import SceneStory
from apex_edge.record.summary import RunSummary, SceneResult
from apex_edge.record.video import AnnotatedVideo

VOID = {"meta", "img", "br", "link", "rect", "line", "circle"}


class Checker(HTMLParser):
    """Collect addresses and complain about tags that do not match."""

    def __init__(self):
        super().__init__()
        self.open, self.addresses, self.tags, self.texts = [], [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.addresses += [v for k, v in attributes if k in ("src", "href", "action", "data")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def scene(n=60, **changes):
    story = SceneStory()
    camera = record_steps.camera_model()
    for step in record_steps.run(n, camera):
        story.write(step)
    values = {
        "seed": 7,
        "is_intervention": True,
        "source": "reflex",
        "t_free_contact_s": 2.4,
        "visible_s": 2.0,
        "t_trigger_s": 0.33,
        "t_reflex_s": 0.33,
        "t_command_s": 0.84,
        "t_arrived_s": 1.6,
        "counters": {"grabbed": 61, "dropped": 1},
    }
    return SceneResult("collision", story.notes(), **{**values, **changes})


def write(tmp_path, *scenes, **settings):
    path = tmp_path / "report.html"
    write_report(path, RunSummary("A run", scenes, command="apex demo", **settings))
    checker = Checker()
    text = path.read_text(encoding="utf-8")
    checker.feed(text)
    assert not checker.open
    return text, checker


def test_report_stands_alone(tmp_path):
    text, checker = write(tmp_path, scene())
    assert "http:" not in text and "https:" not in text
    assert not {"script", "link", "iframe", "object"} & set(checker.tags)
    assert checker.addresses and all(a.startswith("data:image/") for a in checker.addresses)
    assert "@import" not in text and "url(" not in text


def test_pictures_inside_the_report_can_be_decoded(tmp_path):
    _, checker = write(tmp_path, scene())
    shapes = []
    for address in checker.addresses:
        data = base64.b64decode(address.split(",", 1)[1])
        shapes.append(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape)
    assert [shape[1] for shape in shapes] == [1280, 1280]


def test_report_says_what_happened(tmp_path):
    failed = scene(is_collision=True)
    calm = scene(9, is_intervention=False, t_free_contact_s=math.nan, t_arrived_s=math.nan)
    text, checker = write(tmp_path, scene(), failed, calm, about={"Python": "3.7 <x>"})
    words = " ".join(checker.texts)
    assert "1 of 2 collisions prevented" in words
    assert "0 of 1 false interventions" in words
    for expected in ("prevented", "collision", "left alone", "0.84", "late", "deadline reached"):
        assert expected in words
    assert "3.7 &lt;x&gt;" in text


def test_words_from_outside_cannot_become_markup(tmp_path):
    evil = "<script>alert(1)</script>"
    result = scene()
    event = result.notes.events[0]._replace(text=evil)
    result = replace(result, kind=evil, notes=replace(result.notes, events=(event,)))
    _, checker = write(tmp_path, result)
    assert "script" not in checker.tags
    assert evil in checker.texts


def test_small_playable_video_is_inside_and_linked(tmp_path):
    with AnnotatedVideo(tmp_path / "a.webm", 30.0) as video:
        for seq in range(5):
            video.write(record_steps.step(seq))
    _, checker = write(tmp_path, scene(video=video.path))
    assert "a.webm" in checker.addresses
    if video.path.suffix == ".webm":
        assert any(a.startswith("data:video/webm;base64,") for a in checker.addresses)


def test_video_no_browser_plays_is_only_linked(tmp_path):
    (tmp_path / "sub").mkdir()
    with AnnotatedVideo(tmp_path / "sub" / "a.avi", 30.0) as video:
        video.write(record_steps.step(0))
    _, checker = write(tmp_path, scene(video=video.path))
    assert "video" not in checker.tags
    assert "sub/a.avi" in checker.addresses


def test_missing_video_is_an_error_and_no_half_report_appears(tmp_path):
    with pytest.raises(RecordingError, match="gone.webm"):
        write(tmp_path, scene(video=tmp_path / "gone.webm"))
    assert not list(tmp_path.iterdir())


def test_replay_is_reported_without_judging_it(tmp_path):
    _, checker = write(tmp_path, scene(), is_judged=False)
    words = " ".join(checker.texts)
    assert "60 frames" in words
    assert "collisions prevented" not in words


def test_run_without_scenes_is_still_a_page(tmp_path):
    text, _ = write(tmp_path)
    assert "A run" in text


def test_many_scenes_stay_in_the_table_but_not_all_at_length(tmp_path):
    result = scene()
    result = replace(result, notes=replace(result.notes, montage=None, safe_points=None))
    text, _ = write(tmp_path, *[result] * 40)
    assert text.count("<section") == 24
    assert text.count("collision, seed 7") == 40 + 24


def test_spread_is_the_median_and_the_95th_percentile():
    found = spread_of("x", [t / 1000.0 for t in range(101)] + [math.nan])
    assert (found.median_ms, found.p95_ms, found.n) == (pytest.approx(50), pytest.approx(95), 101)


def test_idle_frames_do_not_dilute_a_stage():
    spreads = stage_spreads({"simulate": [0.0] * 90 + [0.006] * 10})
    assert spreads[0].median_ms == pytest.approx(6.0)


def test_longer_bar_for_the_slower_stage():
    chart = latency_chart([spread_of("a", [0.002]), spread_of("b", [0.008])], 33.3)
    widths = [float(w) for w in re.findall(r'width="([\d.]+)" height="14"', chart)]
    assert widths[2] == pytest.approx(4 * widths[0], rel=0.05)


def test_arm_that_came_too_late_had_no_time_to_spare():
    assert scene().margin_s == pytest.approx(0.8)
    assert math.isnan(scene(is_collision=True).margin_s)


def test_timeline_has_no_mark_for_what_never_happened():
    assert "arm there" in timeline(scene())
    assert "arm there" not in timeline(scene(t_arrived_s=math.nan))
    calm = dict.fromkeys(
        ["t_trigger_s", "t_reflex_s", "t_command_s", "t_arrived_s", "t_free_contact_s"], math.nan
    )
    assert timeline(scene(9, **calm)) == ""
