import json
import socket
import sys
from types import ModuleType, SimpleNamespace

import pytest

from apex_edge.verbs import doctor
from apex_edge.verbs.doctor import FAIL, NOTE, OK, WARN

SECRET = "sk-canary-0123456789"


def statuses(checks):
    return [check.status for check in checks]


def reachable(host, port):
    return True


def unreachable(host, port):
    return False


def test_report_on_this_machine_lets_the_demo_run(capsys):
    assert doctor.run(SimpleNamespace(config=None, json=None)) == 0
    out = capsys.readouterr().out
    assert "apex demo can run here" in out
    assert "FAIL" not in out


def test_json_goes_to_a_file_and_the_screen_stays_readable(tmp_path, capsys):
    path = tmp_path / "doctor.json"
    assert doctor.run(SimpleNamespace(config=None, json=str(path))) == 0
    report = json.loads(path.read_text())
    assert report["can_run_demo"] is True
    assert {"name", "status", "found", "cure", "is_needed"} == set(report["checks"][0])
    assert "numpy" in capsys.readouterr().out


def test_json_on_the_screen_is_json_only(capsys):
    doctor.run(SimpleNamespace(config=None, json="-"))
    assert json.loads(capsys.readouterr().out)["can_run_demo"] is True


def test_missing_needed_package_fails_and_says_how_to_get_it():
    ghost = doctor.Package("no_such_module", "no-such-package", lowest="1.2")
    check = doctor.check_package(ghost, is_needed=True)
    assert check.status == FAIL
    assert check.is_needed
    assert "-m pip install 'no-such-package>=1.2'" in check.cure


def test_missing_package_makes_the_exit_code_1(monkeypatch, capsys):
    ghost = doctor.Package("no_such_module", "no-such-package")
    monkeypatch.setattr(doctor, "NEEDED", (ghost,))
    assert doctor.run(SimpleNamespace(config=None, json=None)) == 1
    assert "apex demo cannot run here yet" in capsys.readouterr().out


def test_missing_optional_package_is_a_note_that_says_what_for():
    ghost = doctor.Package("no_such_module", "no-such-package", why="apex train")
    check = doctor.check_package(ghost, is_needed=False)
    assert check.status == NOTE
    assert "apex train" in check.found


def test_opencv_5_is_a_warning_not_a_failure():
    tried = doctor.Package("cv2", "opencv-python-headless", lowest="4.5", too_new="4.6")
    check = doctor.check_package(tried, is_needed=True)
    assert check.status == WARN
    assert "newer than supported" in check.found


def test_other_package_too_new_fails():
    tried = doctor.Package("numpy", "numpy", too_new="1.2")
    assert doctor.check_package(tried, is_needed=True).status == FAIL


def test_old_package_is_a_warning():
    tried = doctor.Package("numpy", "numpy", lowest="99")
    assert doctor.check_package(tried, is_needed=True).status == WARN


def test_versions_compare_by_number_not_by_letter():
    assert doctor._parts("4.14.0.94") > doctor._parts("4.7")
    assert doctor._parts("1.5.0rc1") >= doctor._parts("1.5")


def test_cameras_are_listed_by_name(tmp_path):
    (tmp_path / "video0").touch()
    (tmp_path / "video0.d").mkdir()
    names = tmp_path / "names"
    (names / "video0").mkdir(parents=True)
    (names / "video0" / "name").write_text("Cheap Cam\n")
    found = [check.found for check in doctor.check_cameras(tmp_path, names)]
    assert any(text.endswith("video0 Cheap Cam") for text in found)


def test_driver_of_a_depth_camera_is_looked_for(monkeypatch):
    monkeypatch.setitem(sys.modules, "depthai", None)
    [check] = doctor.check_driver("oak")
    assert check.status == FAIL and "depthai" in check.found
    monkeypatch.setitem(sys.modules, "depthai", ModuleType("depthai"))
    assert statuses(doctor.check_driver("oak")) == [OK]
    assert doctor.check_driver("live") == doctor.check_driver("twin") == []


def test_no_camera_is_a_note_with_a_way_on(tmp_path):
    checks = doctor.check_cameras(tmp_path, tmp_path)
    assert statuses(checks) == [NOTE]
    assert "replay" in checks[0].cure


def test_no_endpoint_is_a_note():
    assert statuses(doctor.check_llm({}, unreachable)) == [NOTE]


def test_endpoint_that_answers_is_ok_and_one_that_does_not_is_a_warning():
    env = {"APEX_LLM_BASE_URL": "http://127.0.0.1:8080/v1", "APEX_LLM_MODEL": "small"}
    assert statuses(doctor.check_llm(env, reachable)) == [OK]
    check = doctor.check_llm(env, unreachable)[0]
    assert check.status == WARN
    assert "http://127.0.0.1:8080, model small, no key" in check.found


def test_port_asked_is_the_one_of_the_scheme():
    asked = []
    env = {"APEX_LLM_BASE_URL": "https://host.example/v1"}
    doctor.check_llm(env, lambda host, port: asked.append((host, port)) or True)
    assert asked == [("host.example", 443)]


@pytest.mark.parametrize("url", ["127.0.0.1:8080", "ftp://host/v1", "http://", "http://h:nan/v1"])
def test_url_that_can_never_work_stops_the_demo(url):
    check = doctor.check_llm({"APEX_LLM_BASE_URL": url}, reachable)[0]
    assert check.status == FAIL
    assert check.is_needed


def test_no_secret_is_ever_shown(tmp_path):
    key_file = tmp_path / "key"
    key_file.write_text(SECRET)
    key_file.chmod(0o600)
    good, bad = "https://host.example/v1", f"https://user:{SECRET}@host.example/v1?key={SECRET}"
    for extra in ({"APEX_LLM_API_KEY": SECRET}, {"APEX_LLM_API_KEY_FILE": str(key_file)}):
        for url in (good, bad):
            checks = doctor.check_llm({"APEX_LLM_BASE_URL": url, **extra}, reachable)
            assert SECRET not in repr(checks)
        assert (
            "with a key"
            in doctor.check_llm({"APEX_LLM_BASE_URL": good, **extra}, reachable)[0].found
        )


def test_key_file_that_others_can_read_is_refused_with_the_cure(tmp_path):
    key_file = tmp_path / "key"
    key_file.write_text(SECRET)
    key_file.chmod(0o644)
    env = {"APEX_LLM_BASE_URL": "https://h/v1", "APEX_LLM_API_KEY_FILE": str(key_file)}
    check = doctor.check_llm(env, reachable)[0]
    assert check.status == FAIL
    assert "chmod 600" in check.found


def test_answers_tells_a_listening_port_from_a_closed_one():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        port = server.getsockname()[1]
        assert not doctor.answers("127.0.0.1", port)
        server.listen(1)
        assert doctor.answers("127.0.0.1", port)


def test_settings_file_with_a_wrong_key_fails_and_names_it(tmp_path):
    path = tmp_path / "apex.toml"
    path.write_text("[camra]\ntype = 'live'\n")
    config, checks = doctor.read_settings(str(path))
    assert config is None
    assert statuses(checks) == [FAIL]
    assert "camra" in checks[0].found


def test_good_settings_file_is_ok_and_its_files_are_checked(tmp_path):
    path = tmp_path / "apex.toml"
    path.write_text("[camera]\ncalibration = 'nowhere.json'\n")
    config, checks = doctor.read_settings(str(path))
    assert statuses(checks) == [OK]
    checks = doctor.check_files(config)
    assert [(check.name, check.status) for check in checks] == [
        ("colours", OK),
        ("calibration", FAIL),
    ]
    assert "nowhere.json" in checks[-1].found


def test_settings_that_fail_make_the_exit_code_1(tmp_path, capsys):
    path = tmp_path / "apex.toml"
    path.write_text("[camera]\ncalibration = 'nowhere.json'\n")
    assert doctor.run(SimpleNamespace(config=str(path), json=None)) == 1
    assert "FAIL  calibration" in capsys.readouterr().out


def test_machine_that_is_no_pi_says_nothing_of_throttling():
    assert doctor.check_throttling(None) == []


@pytest.mark.parametrize(
    ("bits", "status", "word"),
    [
        (0x0, OK, "never"),
        (0x1, WARN, "now: under-voltage"),
        (0x50005, WARN, "now: under-voltage, throttled"),
        (0x20000, WARN, "since boot: frequency capped"),
    ],
)
def test_throttling_bits_are_put_into_words(bits, status, word):
    checks = doctor.check_throttling(bits)
    assert statuses(checks) == [status]
    assert word in checks[0].found


def test_weights_and_a_port_that_cannot_be_used_are_named(tmp_path):
    path = tmp_path / "apex.toml"
    (tmp_path / "weights.json").write_text("{}")
    path.write_text(
        f"[trigger]\nweights = '{tmp_path / 'weights.json'}'\n[arm]\nport = '/dev/ttyNOPE9'\n"
    )
    config, _ = doctor.read_settings(str(path))
    trigger = doctor.check_trigger(config.trigger)
    assert trigger.status == FAIL
    assert "weights.json" in trigger.found
    arm = doctor.check_arm(config.arm)
    assert [(check.name, check.status) for check in arm] == [("arm", OK), ("arm port", FAIL)]
    assert "/dev/ttyNOPE9" in arm[1].found
