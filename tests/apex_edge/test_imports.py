import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DEVICE = ("apex_edge", "firmware_bridge", "calib")
FORBIDDEN = ("offline_train", "sklearn", "scipy", "mujoco", "torch", "matplotlib", "joblib")
FORBIDDEN += ("torch_geometric", "distributed", "optuna")


def run_python(code, *arguments):
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=100,
    )


def modules_of(package):
    found = pkgutil.walk_packages([str(ROOT / package)], package + ".")
    return [package, *(info.name for info in found)]


def test_the_tree_is_found():
    assert "apex_edge.types" in modules_of("apex_edge")


@pytest.mark.parametrize("package", DEVICE)
def test_every_module_imports_and_pulls_in_no_training_stack(package):
    # one process for a whole package: what any module pulls in stays in sys.modules
    code = (
        "import importlib, sys\n"
        "names, forbidden = (text.split(',') for text in sys.argv[1:])\n"
        "for name in names:\n"
        "    importlib.import_module(name)\n"
        "    bad = [name for name in forbidden if name in sys.modules]\n"
        "    assert not bad, name + ' pulls in ' + ', '.join(bad)\n"
    )
    done = run_python(code, ",".join(modules_of(package)), ",".join(FORBIDDEN))
    assert done.returncode == 0, done.stdout.decode()


@pytest.mark.parametrize("package", DEVICE)
def test_every_module_imports_alone(package):
    # a module that only imports after another one hides a circle
    code = (
        "import importlib, sys\n"
        "names, own = (text.split(',') for text in sys.argv[1:])\n"
        "for name in names:\n"
        "    for loaded in [n for n in sys.modules if n.split('.')[0] in own]:\n"
        "        del sys.modules[loaded]\n"
        "    importlib.import_module(name)\n"
    )
    done = run_python(code, ",".join(modules_of(package)), ",".join(DEVICE))
    assert done.returncode == 0, done.stdout.decode()


def test_importing_prints_nothing_and_starts_no_thread():
    code = (
        "import importlib, sys, threading\n"
        "for name in sys.argv[1].split(','):\n"
        "    importlib.import_module(name)\n"
        "assert threading.active_count() == 1, threading.enumerate()\n"
    )
    names = [name for package in DEVICE for name in modules_of(package)]
    done = run_python(code, ",".join(names))
    assert done.returncode == 0, done.stdout.decode()
    assert done.stdout == b""


def test_device_packages_ask_for_no_training_package():
    metadata = run_python(
        "import importlib_metadata as m; print(*m.requires('apex-edge'), sep='\\n')"
    ).stdout.decode()
    always = [line.lower() for line in metadata.splitlines() if "extra ==" not in line]
    assert any(line.startswith("numpy") for line in always)
    for name in ("scikit-learn", "scipy", "mujoco", "torch", "matplotlib", "joblib"):
        assert not any(line.startswith(name) for line in always)


def test_source_of_device_packages_is_utf8_with_unix_line_ends():
    for package in DEVICE:
        for path in sorted((ROOT / package).rglob("*.py")):
            assert b"\r" not in path.read_bytes(), path
            path.read_text(encoding="utf-8")
