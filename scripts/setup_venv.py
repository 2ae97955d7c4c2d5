"""Make a virtual environment inside the checkout and install the project into it.

Run by the interpreter it is for: ``python3 scripts/setup_venv.py .venv --extras test``.
Standard library only. A stamp in the environment remembers what it was made from, so a run that
has nothing to do ends at once; another interpreter or a moved checkout makes it anew.
"""

import argparse
import hashlib
import importlib.util
import json
import platform
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any, Dict, List, Optional

ROOT = Path(__file__).resolve().parent.parent
MIN_PYTHON = (3, 7)
# pip before this refuses an editable install of a project with a pyproject.toml
MIN_PIP = (21, 3)
# No wheels for 32-bit ARM on PyPI: the distribution has them. Import name -> apt package.
APT_ON_ARM32 = {
    "numpy": "python3-numpy",
    "cv2": "python3-opencv",
    "lz4": "python3-lz4",
    "zstandard": "python3-zstandard",
}
NEVER_BUILD_ON_ARM32 = (
    "numpy,opencv-python-headless,lz4,zstandard,scipy,scikit-learn,mujoco,matplotlib"
)


class SetupError(Exception):
    """A thing the user has to do first; the message says how."""


def is_arm32() -> bool:
    """Say whether this interpreter is a 32-bit ARM one (also on a 64-bit kernel)."""
    return struct.calcsize("P") == 4 and platform.machine().startswith(("arm", "aarch64"))


def check_interpreter() -> None:
    """Refuse an interpreter that cannot make the environment.

    Raises
    ------
    SetupError : too old, or without ensurepip (Debian splits it off).
    """
    found = ".".join(str(part) for part in sys.version_info[:3])
    if sys.version_info[:2] < MIN_PYTHON:
        raise SetupError(f"{sys.executable} is Python {found}; 3.7 or newer is needed")
    if importlib.util.find_spec("venv") and importlib.util.find_spec("ensurepip"):
        return
    own = "python3" if sys.executable.startswith("/usr/bin/") else f"python3.{sys.version_info[1]}"
    raise SetupError(
        f"{sys.executable} cannot make virtual environments; install what is missing with: "
        f"sudo apt-get update && sudo apt-get install -y {own}-venv"
    )


def check_arm32_packages() -> None:
    """Refuse to start on 32-bit ARM without the distribution's own compiled packages.

    Raises
    ------
    SetupError : one line with the apt command.
    """
    missing = [apt for name, apt in APT_ON_ARM32.items() if not importlib.util.find_spec(name)]
    if missing:
        raise SetupError(
            "32-bit ARM: PyPI has no wheels, the distribution's packages serve; run: "
            f"sudo apt-get update && sudo apt-get install -y {' '.join(missing)}"
        )


def fingerprint() -> Dict[str, Any]:
    """Return what the environment depends on: interpreter, place and package metadata."""
    digest = hashlib.sha256()
    for name in ("setup.py", "pyproject.toml", "scripts/setup_venv.py"):
        digest.update((ROOT / name).read_bytes())
    # The real prefix, not sys.executable: a pyenv shim and the binary behind it are one.
    base = f"{sys.base_prefix} {platform.python_version()}"
    return {"python": base, "root": str(ROOT), "sha256": digest.hexdigest()}


def read_stamp(stamp: Path) -> Optional[Dict[str, Any]]:
    """Return the stamp's content, or None when there is none that can be read."""
    try:
        content = json.loads(stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def create(venv: Path) -> None:
    """Make an empty environment with a pip that can do editable installs."""
    if (venv / "pyvenv.cfg").is_file():
        shutil.rmtree(str(venv))
    elif venv.exists():
        raise SetupError(f"{venv} exists and is no virtual environment; move it away")
    options = ["--system-site-packages"] if is_arm32() else []
    subprocess.run([sys.executable, "-m", "venv", *options, str(venv)], check=True)
    python = str(venv / "bin" / "python")
    shown = subprocess.run([python, "-m", "pip", "--version"], check=True, stdout=subprocess.PIPE)
    version = tuple(int(part) for part in shown.stdout.decode().split()[1].split(".")[:2])
    if version < MIN_PIP:
        subprocess.run([python, "-m", "pip", "install", "-q", "--upgrade", "pip"], check=True)


def pip_command(venv: Path, extras: List[str]) -> List[str]:
    """Return the command that installs the project and the given extras into ``venv``."""
    target = f"{ROOT}[{','.join(extras)}]" if extras else str(ROOT)
    command = [str(venv / "bin" / "python"), "-m", "pip", "install", "--prefer-binary"]
    if not sys.stdout.isatty():
        command.append("--quiet")
    if is_arm32():
        command += ["--only-binary", NEVER_BUILD_ON_ARM32]
        # On a 64-bit kernel uname says aarch64 and the markers in setup.py would ask for OpenCV.
        if platform.machine() == "aarch64":
            command = ["setarch", "linux32", *command]
    return [*command, "--editable", target]


def install(venv: Path, extras: List[str], optional: List[str]) -> None:
    """Install the project with its extras.

    An ``optional`` extra that cannot be had here (no wheels) is left out, and said so; of several
    each is tried alone then.
    """
    if subprocess.run(pip_command(venv, sorted({*extras, *optional}))).returncode == 0:
        return
    if not optional:
        raise SetupError("pip could not install the project; its message is above")
    if len(optional) == 1:
        print(f"*** not to be had here: [{optional[0]}]; going on without", file=sys.stderr)
        install(venv, extras, [])
        return
    for name in optional:
        install(venv, extras, [name])


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("venv", type=Path)
    parser.add_argument("--extras", default="", help="comma-separated extras that must be in")
    parser.add_argument("--optional", default="", help="extras to leave out where no wheel exists")
    args = parser.parse_args()
    extras = [name for name in args.extras.split(",") if name]
    optional = [] if is_arm32() else [name for name in args.optional.split(",") if name]
    venv = args.venv.resolve()
    stamp, now = venv / ".apex-setup.json", fingerprint()
    old = read_stamp(stamp) or {}
    is_same_base = all(old.get(key) == now[key] for key in ("python", "root"))
    asked = set(old.get("asked", [])) if is_same_base else set()
    if old.get("sha256") == now["sha256"] and asked >= {*extras, *optional} and is_same_base:
        return 0
    try:
        check_interpreter()
        if is_arm32():
            check_arm32_packages()
        print(f"Setting up {venv.name} with Python {platform.python_version()} (once) ...")
        sys.stdout.flush()
        if not is_same_base:
            create(venv)
        install(venv, extras, sorted((asked | set(optional)) - set(extras)))
    except SetupError as error:
        print(f"setup: {error}", file=sys.stderr)
        return 1
    except subprocess.CalledProcessError as error:
        print(f"setup: {' '.join(error.cmd)} failed; its message is above", file=sys.stderr)
        return 1
    now["asked"] = sorted(asked | {*extras, *optional})
    stamp.write_text(json.dumps(now), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
