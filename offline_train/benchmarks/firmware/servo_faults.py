"""Servo faults: each must be named within half a second, with the others still readable."""

import time
from typing import Any, Dict, List

import numpy as np

from apex_edge.verbs.progress import Progress
from firmware_bridge.session import SessionState
from offline_train.benchmarks.firmware.live import LiveArm, Swinger, has_simulator, quiet
from offline_train.benchmarks.lines import Line, at_least, at_most

SUITE = "servo faults"
GOAL_S = 0.5
_N = 20
_STRUCK_S = (0.8, 1.6)
_PATIENCE_S = 3.0
NAMES: Dict[str, str] = {
    "stuck": "stall",
    "overheat": "overheat",
    "brown-out": "brown-out",
    "dead": "dead id",
    "id-clash": "id clash",
    "wrong-baud": "wrong baud",
}


def measure(scale: float, seed: int) -> List[Line]:
    """Strike every kind of fault on every protocol with feedback; 20 times at scale 1."""
    rng = np.random.RandomState(seed)
    n_runs = max(1, int(round(_N * scale)))
    protocols = [name for name in ("sts", "lx16a") if has_simulator(name)]
    lines: List[Line] = []
    with quiet(), Progress("faults", n_runs * len(protocols) * len(NAMES)) as progress:
        for protocol in protocols:
            for kind in NAMES:
                found = []
                for _ in range(n_runs):
                    found.append(strike(protocol, kind, rng))
                    progress.advance()
                worst_s = max(one["named_s"] for one in found)
                n_readable = min(one["n_readable"] for one in found)
                n_others = found[0]["n_others"]
                what = f"{protocol} {kind}"
                lines += [
                    at_most(SUITE, f"{what}: named after, worst of {n_runs}, s", worst_s, GOAL_S),
                    at_least(SUITE, f"{what}: other joints readable", n_readable, n_others),
                ]
    return lines


def strike(protocol: str, kind: str, rng: np.random.RandomState) -> Dict[str, float]:
    """Strike one servo of a swinging arm; returns when that was named (inf: never), and more."""
    with_yaw = kind == "stuck"  # only a joint that shall move can be seen not to
    at_s = float(rng.uniform(*_STRUCK_S))
    with LiveArm(protocol, seed=int(rng.randint(1 << 30))) as plain:
        ids = plain.arm.servo_ids
    j = 0 if with_yaw else int(rng.randint(1, len(ids)))
    fault: Dict[str, Any] = {"kind": kind, "id": ids[j], "at_s": at_s}
    struck = {j}
    if kind == "id-clash":
        other = int(rng.choice([i for i in range(len(ids)) if i != j]))
        fault["with"] = ids[other]
        struck.add(other)
    script = {"version": 1, "devices": [fault]}
    with LiveArm(protocol, script, int(rng.randint(1 << 30))) as live:
        live.arm_up()
        swinger = Swinger(live.session)

        def is_named() -> bool:
            return NAMES[kind] in live.session.reason

        def is_over() -> bool:
            return live.firmware.t_s >= at_s or live.session.state is SessionState.FAULT

        swinger.until(is_over, _PATIENCE_S)
        struck_s = time.monotonic() - (live.firmware.t_s - at_s)
        was_fault = live.firmware.t_s < at_s  # a false alarm counts as a miss
        is_found = swinger.until(is_named, _PATIENCE_S)
        named_s = time.monotonic() - struck_s if is_found else float("inf")
        is_fault = live.session.state is SessionState.FAULT and not was_fault
        for _ in range(3):
            swinger.turn()
        is_valid = live.session.read().is_valid
        n_readable = sum(bool(ok) for at, ok in enumerate(is_valid) if at not in struck)
        return {
            "named_s": named_s if is_fault else float("inf"),
            "n_readable": n_readable,
            "n_others": len(ids) - len(struck),
        }
