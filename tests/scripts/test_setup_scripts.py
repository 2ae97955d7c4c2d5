import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def load_script(name):
    spec = importlib.util.spec_from_file_location(name, str(ROOT / "scripts" / f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def setup_venv():
    return load_script("setup_venv")


def fake_interpreter(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def find_python37(tmp_path, **env):
    base = {"PATH": str(tmp_path / "bin"), "HOME": str(tmp_path / "home")}
    return subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "find_python37.py")],
        env={**base, **env},
        stdout=subprocess.PIPE,
        timeout=60,
    )


def test_machine_without_python37_is_told_by_the_exit_code(tmp_path):
    done = find_python37(tmp_path)
    assert done.returncode == 1
    assert done.stdout == b""


def test_shim_that_refuses_to_run_is_passed_over_for_one_that_does(tmp_path):
    fake_interpreter(tmp_path / "bin" / "python3.7", "echo 'command not found' >&2; exit 127")
    real = tmp_path / "home" / ".pyenv" / "versions" / "3.7.16" / "bin" / "python"
    fake_interpreter(real, f"echo CPython 3 7 {real}")
    done = find_python37(tmp_path)
    assert done.returncode == 0
    assert done.stdout.decode().strip() == str(real)


def test_another_version_under_the_name_python37_is_refused(tmp_path):
    fake_interpreter(tmp_path / "bin" / "python3.7", "echo CPython 3 8 /x")
    assert find_python37(tmp_path).returncode == 1


def test_other_implementation_is_refused(tmp_path):
    fake_interpreter(tmp_path / "bin" / "python3.7", "echo PyPy 3 7 /x")
    assert find_python37(tmp_path).returncode == 1


def test_chosen_interpreter_comes_first(tmp_path):
    fake_interpreter(tmp_path / "bin" / "python3.7", "echo CPython 3 7 /on/path")
    chosen = fake_interpreter(tmp_path / "mine", "echo CPython 3 7 /mine")
    done = find_python37(tmp_path, PYTHON37=str(chosen))
    assert done.stdout == b"/mine\n"


def test_debian_python_without_venv_is_told_the_exact_apt_command(setup_venv, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "executable", "/usr/bin/python3")
    with pytest.raises(setup_venv.SetupError, match="sudo apt-get install -y python3-venv"):
        setup_venv.check_interpreter()


def test_python_that_is_too_old_is_refused(setup_venv, monkeypatch):
    monkeypatch.setattr(sys, "version_info", (3, 6, 15, "final", 0))
    with pytest.raises(setup_venv.SetupError, match="is Python 3.6.15; 3.7 or newer"):
        setup_venv.check_interpreter()


def test_arm32_names_only_the_apt_packages_that_are_missing_in_one_line(setup_venv, monkeypatch):
    missing = {"cv2", "lz4"}
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name in missing else object()
    )
    with pytest.raises(setup_venv.SetupError) as caught:
        setup_venv.check_arm32_packages()
    message = str(caught.value)
    assert message.endswith("install -y python3-opencv python3-lz4")
    assert "\n" not in message


def test_arm32_pip_never_builds_numpy_or_opencv(setup_venv, monkeypatch, tmp_path):
    monkeypatch.setattr(setup_venv, "is_arm32", lambda: True)
    command = setup_venv.pip_command(tmp_path, ["test"])
    never = command[command.index("--only-binary") + 1].split(",")
    assert {"numpy", "opencv-python-headless"} <= set(never)


@pytest.mark.parametrize(
    ("machine", "size", "expected"),
    [
        ("armv7l", 4, True),
        ("armv6l", 4, True),
        ("aarch64", 4, True),
        ("aarch64", 8, False),
        ("x86_64", 8, False),
    ],
)
def test_arm32_is_told_by_the_interpreter_not_by_the_kernel(
    setup_venv, monkeypatch, machine, size, expected
):
    monkeypatch.setattr(setup_venv.platform, "machine", lambda: machine)
    monkeypatch.setattr(setup_venv.struct, "calcsize", lambda code: size)
    assert setup_venv.is_arm32() is expected


def test_folder_that_is_no_environment_is_not_deleted(setup_venv, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(setup_venv.SetupError, match="no virtual environment"):
        setup_venv.create(tmp_path)
    assert (tmp_path / "thesis.tex").exists()


def test_set_up_that_is_done_does_nothing(setup_venv, tmp_path, monkeypatch, capsys):
    stamp = {**setup_venv.fingerprint(), "asked": ["lint", "test"]}
    (tmp_path / ".apex-setup.json").write_text(setup_venv.json.dumps(stamp))
    monkeypatch.setattr(sys, "argv", ["setup_venv.py", str(tmp_path), "--extras", "test"])
    monkeypatch.setattr(setup_venv, "create", lambda venv: pytest.fail("made anew"))
    monkeypatch.setattr(setup_venv, "install", lambda *args: pytest.fail("installed again"))
    assert setup_venv.main() == 0
    assert capsys.readouterr().out == ""


def test_extra_that_is_new_is_installed_and_the_old_ones_stay(setup_venv, tmp_path, monkeypatch):
    stamp = {**setup_venv.fingerprint(), "asked": ["lint"]}
    (tmp_path / ".apex-setup.json").write_text(setup_venv.json.dumps(stamp))
    asked = []
    monkeypatch.setattr(sys, "argv", ["setup_venv.py", str(tmp_path), "--extras", "test"])
    monkeypatch.setattr(setup_venv, "create", lambda venv: pytest.fail("made anew"))
    monkeypatch.setattr(setup_venv, "install", lambda venv, *extras: asked.append(extras))
    assert setup_venv.main() == 0
    assert asked == [(["test"], ["lint"])]
    assert setup_venv.read_stamp(tmp_path / ".apex-setup.json")["asked"] == ["lint", "test"]


def test_interpreter_that_changed_makes_the_environment_anew(setup_venv, tmp_path, monkeypatch):
    stamp = {**setup_venv.fingerprint(), "asked": ["test"], "python": "/old 3.6.0"}
    (tmp_path / ".apex-setup.json").write_text(setup_venv.json.dumps(stamp))
    made = []
    monkeypatch.setattr(sys, "argv", ["setup_venv.py", str(tmp_path), "--extras", "test"])
    monkeypatch.setattr(setup_venv, "create", made.append)
    monkeypatch.setattr(setup_venv, "install", lambda *args: None)
    assert setup_venv.main() == 0
    assert made == [tmp_path.resolve()]


def test_failed_install_leaves_no_stamp(setup_venv, tmp_path, monkeypatch, capsys):
    def fail(*args):
        raise setup_venv.SetupError("pip could not install the project")

    monkeypatch.setattr(sys, "argv", ["setup_venv.py", str(tmp_path / "new")])
    monkeypatch.setattr(setup_venv, "create", lambda venv: venv.mkdir())
    monkeypatch.setattr(setup_venv, "install", fail)
    assert setup_venv.main() == 1
    assert "setup: pip could not install" in capsys.readouterr().err
    assert not (tmp_path / "new" / ".apex-setup.json").exists()


def test_optional_extra_without_a_wheel_is_left_out_loudly(
    setup_venv, tmp_path, monkeypatch, capsys
):
    commands = []

    def run(command, **options):
        commands.append(command)
        return subprocess.CompletedProcess(command, 1 if "train" in command[-1] else 0)

    monkeypatch.setattr(setup_venv.subprocess, "run", run)
    setup_venv.install(tmp_path, ["test"], ["train"])
    assert [command[-1].rpartition("[")[2] for command in commands] == ["test,train]", "test]"]
    assert "[train]; going on without" in capsys.readouterr().err
    commands.clear()
    setup_venv.install(tmp_path, ["test"], ["graph", "train"])
    asked = [command[-1].rpartition("[")[2] for command in commands]
    assert asked == ["graph,test,train]", "graph,test]", "test,train]", "test]"]
