"""Print the path of a CPython 3.7 that really runs; exit 1 when this machine has none.

Looks at $PYTHON37, python3.7 on the PATH and pyenv's versions. A pyenv shim named python3.7 may
exist and still refuse to run, so each candidate is tried.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Iterator

ASK = (
    "import sys, platform, venv, ensurepip; "
    "print(platform.python_implementation(), *sys.version_info[:2], sys.executable)"
)


def candidates() -> Iterator[str]:
    """Yield the interpreters to try, the user's own choice first."""
    chosen = os.environ.get("PYTHON37")
    if chosen:
        yield chosen
    for folder in os.environ.get("PATH", "").split(os.pathsep):
        found = shutil.which("python3.7", path=folder) if folder else None
        if found:
            yield found
    roots = [os.environ.get("PYENV_ROOT", ""), str(Path.home() / ".pyenv")]
    for root in roots:
        if root:
            yield from sorted(map(str, Path(root).glob("versions/3.7*/bin/python")), reverse=True)


def main() -> int:
    """Run the command line."""
    for path in candidates():
        try:
            done = subprocess.run(
                [path, "-c", ASK], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=30
            )
        except (OSError, subprocess.TimeoutExpired):
            continue
        words = done.stdout.decode(errors="replace").split(None, 3)
        if done.returncode == 0 and words[:3] == ["CPython", "3", "7"]:
            print(words[3].strip())
            return 0
    return 1


if __name__ == "__main__":
    sys.exit(main())
