import json
import subprocess
import sys
import threading

import numpy as np
import pytest
import record_steps
from mcap.reader import make_reader

from apex_edge.errors import RecordingError
from apex_edge.record import topics
from apex_edge.record.mcap_io import RecordingReader, RecordingWriter


def write(path, steps, **options):
    with RecordingWriter(path, {"scene": "collision"}, **options) as writer:
        for step in steps:
            writer.write(step)
    return path


def test_lossless_recording_gives_back_every_pixel_depth_and_state(tmp_path):
    camera = record_steps.camera_model()
    steps = record_steps.run(30, camera)
    reader = RecordingReader(write(tmp_path / "a.mcap", steps, picture_format="png"))
    assert reader.metadata == {"scene": "collision"}
    back = list(reader)
    assert len(back) == 30
    for step, recorded in zip(steps, back):
        assert recorded.frame.seq == step.frame.seq
        assert recorded.frame.t_s == step.frame.t_s
        assert np.array_equal(recorded.frame.colour_bgr, step.frame.colour_bgr)
        assert np.array_equal(recorded.frame.depth_mm, step.frame.depth_mm)
        assert np.array_equal(recorded.arm.joints_rad, step.arm.joints_rad)
        assert recorded.proposal == step.proposal
        model = recorded.frame.camera
        assert np.allclose(model.table_from_cam, camera.table_from_cam, rtol=0, atol=1e-14)
        assert np.array_equal(model.dist, camera.dist)
        assert (model.fx_px, model.cy_px, model.width_px) == (
            camera.fx_px,
            camera.cy_px,
            camera.width_px,
        )


def test_jpeg_quality_trades_size_for_faithfulness(tmp_path):
    steps = record_steps.run(3)
    error, size = {}, {}
    for quality in (40, 95):
        path = write(tmp_path / f"{quality}.mcap", steps, jpeg_quality=quality)
        back = list(RecordingReader(path))[1].frame.colour_bgr
        error[quality] = np.abs(back.astype(int) - steps[1].frame.colour_bgr).mean()
        size[quality] = path.stat().st_size
    assert 0 < error[95] < error[40] < 10
    assert size[40] < size[95]


def test_every_message_can_be_read_with_the_plain_library(tmp_path):
    path = write(tmp_path / "a.mcap", record_steps.run(30, record_steps.camera_model()))
    with path.open("rb") as file:
        found = {}
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append(message)
            if channel.message_encoding == "json":
                known = set(json.loads(schema.data)["properties"])
                assert set(json.loads(message.data)) <= known
    assert len(found[topics.COLOUR]) == len(found["/decision"]) == 30
    assert len(found[topics.CALIBRATION]) == 1, "an unchanged camera is written once"
    assert len(found["/candidates"]) == 1
    assert set(found) == set(topics.SCHEMAS) | {
        topics.COLOUR,
        topics.DEPTH,
        topics.CALIBRATION,
        topics.TRANSFORM,
    }


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_cut_recording_is_refused_and_says_how_many_frames_could_be_read(tmp_path, share):
    path = write(tmp_path / "a.mcap", record_steps.run(60), picture_format="png")
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    kept = RecordingReader(path, is_partial_ok=True)
    assert kept.is_truncated
    n = len(list(kept))
    assert 60 * share * 0.7 < n <= 60 * share
    with pytest.raises(RecordingError, match=rf"cut short; {n} frames could be read"):
        RecordingReader(path)


def test_flipped_byte_is_found_and_counted(tmp_path):
    path = write(tmp_path / "a.mcap", record_steps.run(60), picture_format="png")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x40
    path.write_bytes(bytes(data))
    reader = RecordingReader(path)
    with pytest.raises(RecordingError, match=r"damaged after \d+ frames"):
        list(reader)
    assert 0 < reader.n_read < 60


def test_damage_anywhere_is_one_kind_of_error(tmp_path):
    path = write(tmp_path / "a.mcap", record_steps.run(3))
    whole = path.read_bytes()
    rng = np.random.RandomState(0)
    n_refused = 0
    for _ in range(150):
        data = bytearray(whole)
        for at in rng.randint(8, len(data) - 8, 8):
            data[at] = rng.randint(256)
        path.write_bytes(bytes(data))
        try:
            assert len(list(RecordingReader(path))) <= 3
        except RecordingError:
            n_refused += 1
    assert n_refused > 100


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"not a recording at all" * 9])
def test_what_is_no_recording_is_refused(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"a\.mcap"):
        RecordingReader(path)


def test_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(RecordingError, match="nowhere.mcap"):
        RecordingReader(tmp_path / "nowhere.mcap")


def test_recording_without_frames_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no complete frame"):
        list(RecordingReader(write(tmp_path / "a.mcap", [])))


def test_unwritable_folder_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="gone"):
        RecordingWriter(tmp_path / "gone" / "a.mcap", {})


def test_unknown_picture_format_is_refused_before_a_file_exists(tmp_path):
    with pytest.raises(RecordingError, match="bmp"):
        RecordingWriter(tmp_path / "a.mcap", {}, picture_format="bmp")
    assert not list(tmp_path.iterdir())


def test_killed_process_leaves_a_readable_part_and_no_whole_file(tmp_path):
    path = tmp_path / "a.mcap"
    program = (
        "import os, sys; sys.path.insert(0, sys.argv[2]); import record_steps\n"
        "from apex_edge.record.mcap_io import RecordingWriter\n"
        "writer = RecordingWriter(sys.argv[1], {}, picture_format='png')\n"
        "for step in record_steps.run(60): writer.write(step)\n"
        "os._exit(9)\n"
    )
    here = str(record_steps.__file__).rsplit("/", 1)[0]
    done = subprocess.run([sys.executable, "-c", program, str(path), here], check=False)
    assert done.returncode == 9
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap.part"]
    kept = list(RecordingReader(tmp_path / "a.mcap.part", is_partial_ok=True))
    assert 40 < len(kept) < 60
    assert [r.frame.seq for r in kept] == list(range(len(kept)))


def test_exception_keeps_the_part_and_publishes_nothing(tmp_path):
    path = tmp_path / "a.mcap"
    with pytest.raises(ZeroDivisionError), RecordingWriter(path, {}) as writer:
        writer.write(record_steps.step(0))
        raise ZeroDivisionError
    assert not path.exists()
    assert len(list(RecordingReader(f"{path}.part"))) == 1


def test_threaded_writer_records_the_same_frames(tmp_path):
    steps = record_steps.run(30)
    write(tmp_path / "a.mcap", steps)
    write(tmp_path / "b.mcap", steps, is_threaded=True, queue_length=64)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_full_queue_drops_and_counts_instead_of_waiting(tmp_path, monkeypatch):
    gate = threading.Event()
    encode = topics.encode_picture
    monkeypatch.setattr(topics, "encode_picture", lambda *a: gate.wait(30) and encode(*a))
    writer = RecordingWriter(tmp_path / "a.mcap", {}, is_threaded=True, queue_length=4)
    accepted = sum(writer.write(record_steps.step(seq)) for seq in range(20))
    assert 4 <= accepted <= 5
    assert writer.n_dropped == 20 - accepted
    gate.set()
    writer.close()
    assert writer.n_written == accepted
    assert len(list(RecordingReader(tmp_path / "a.mcap"))) == accepted


def test_full_disk_never_reaches_the_loop_but_the_close(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(28, "No space left on device")

    writer = RecordingWriter(tmp_path / "a.mcap", {}, is_threaded=True)
    monkeypatch.setattr(writer._encoder, "write", refuse)
    for seq in range(5):
        writer.write(record_steps.step(seq))
    with pytest.raises(RecordingError, match="No space left"):
        writer.close()
    assert not (tmp_path / "a.mcap").exists()


def test_closed_writer_refuses_more(tmp_path):
    writer = RecordingWriter(tmp_path / "a.mcap", {})
    writer.close()
    writer.close()
    with pytest.raises(RecordingError, match="closed"):
        writer.write_frame(record_steps.frame(0))
