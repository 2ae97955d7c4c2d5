"""Fetch the independent servo libraries that our codecs and simulator are compared with.

``.venv/bin/python scripts/setup_peers.py``: each goes into a folder of its own under ``peers`` of
that environment, without its dependencies: two of them share a module name, and one would pull in
a GUI toolkit. Tests and benchmarks only; nothing of ours needs them. Standard library only.
"""

import subprocess
import sys
from pathlib import Path

# name -> version, oldest Python it runs on
PEERS = {
    "lewansoul-lx16a": ("0.1", (3, 7)),
    "pylx16a": ("1.1.1", (3, 10)),
    "xarm": ("0.0.4", (3, 7)),
    "feetech-servo-sdk": ("1.0.0", (3, 7)),
    "ftservo-python-sdk": ("2.0.1", (3, 7)),
    "dynamixel-sdk": ("4.1.0", (3, 7)),
    "crcmod": ("1.7", (3, 7)),
    "smbus2": ("0.6.1", (3, 7)),
}


def main() -> int:
    """Install what is missing; 1 when pip could not."""
    folder = Path(sys.prefix) / "peers"
    for name, (version, oldest) in PEERS.items():
        target = folder / f"{name}-{version}"
        if target.is_dir() or sys.version_info[:2] < oldest:
            continue
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
        command += ["--target", str(target), f"{name}=={version}"]
        if subprocess.run(command).returncode != 0:
            print(f"peers: pip could not install {name}; its message is above", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
