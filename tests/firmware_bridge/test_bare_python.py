"""Everything up to the bus runs on a bare Python with pyserial."""

import subprocess
import sys

import pytest

SCRIPT = """
import sys

sys.modules.update(dict.fromkeys(
    ("numpy", "cv2", "tomli", "cattr", "cattrs", "requests", "importlib_metadata", "mcap")
))
from firmware_bridge import codec
from firmware_bridge.bus import Bus
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.links.opening import open_link
from firmware_bridge.simulator.make import Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving

name = sys.argv[1]
setup = Setup(name, ids=(1, 2, 3), is_plain=True)
with serving(PtyBoard(setup.firmware(), options=setup.wire(is_paced=False))) as board:
    protocol = codec.protocol(name)
    bus = Bus(protocol, open_link(board.port, protocol))
    bus.open()
    goal = sum(protocol.ticks) // 2 + 10
    told = bus.move([ServoTarget(i, goal, 1000) for i in (1, 2, 3)], 50)
    known = Quantity.TARGET if Quantity.TARGET in protocol.quantities else Quantity.POSITION
    found = bus.read(known, (1, 2, 3))
    bus.close()
    print(sorted(found), {verdict.name for verdict in told.values()})
"""


@pytest.mark.parametrize(
    ("name", "verdict"),
    [
        ("lx16a", "CONFIRMED"),
        ("lsc", "CONFIRMED"),
        ("rrc", "UNVERIFIABLE"),
        ("rrc-bus", "CONFIRMED"),
        ("sts", "CONFIRMED"),
        ("dxl2", "CONFIRMED"),
    ],
)
def test_an_arm_moves_and_answers_with_nothing_installed_but_pyserial(name, verdict):
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, name],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert run.stdout.strip() == f"[1, 2, 3] {{'{verdict}'}}", run.stdout
