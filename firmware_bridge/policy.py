"""Section ``[policy]`` of an arm's file: from when on something is wrong, and what is done then.

Source: ours; the limits are those of the servos' makers with a margin.
"""

from dataclasses import dataclass

from apex_edge.config import setting
from apex_edge.errors import ConfigError

HOLD, TORQUE_OFF, WARN = "hold", "torque-off", "warn"
_ACTIONS = (HOLD, TORQUE_OFF, WARN)


@dataclass(frozen=True)
class Policy:
    """Limits of heat, supply and stall, and what is done about them.

    "hold" stops the arm where it is, "torque-off" lets it sink, "warn" is a line in the log.
    ``min_v`` is where small servos begin to reset, so an arm on 7.4 V or on 12 V that is well never
    meets it; a 12 V supply that sags is seen much earlier where the arm's file says more.
    """

    warn_c: float = setting(60.0, "a servo this warm is a warning", 20.0, 150.0)
    max_c: float = setting(68.0, "a servo this warm stops the arm", 20.0, 150.0)
    limp_c: float = setting(80.0, "a servo this warm loses its torque", 20.0, 150.0)
    min_v: float = setting(4.5, "a supply this low is a brown-out", 0.0, 30.0)
    stall_rad: float = setting(0.08, "a joint this far from its way is stalled", 0.005, 3.0)
    stall_s: float = setting(0.06, "for this long", 0.0, 5.0)
    overheat: str = setting(HOLD, "what is done at max_c", choices=_ACTIONS)
    stall: str = setting(HOLD, "what is done then", choices=_ACTIONS)
    brown_out: str = setting(HOLD, "what is done then", choices=_ACTIONS)
    estop: str = setting(HOLD, "what an e-stop does: gravity", choices=(HOLD, TORQUE_OFF))


def check_policy(policy: Policy, where: str) -> None:
    """Refuse temperatures that are not in the order of what is done about them.

    Raises
    ------
    ConfigError : names ``where`` they stand.
    """
    heat = (policy.warn_c, policy.max_c, policy.limp_c)
    if list(heat) != sorted(heat):
        raise ConfigError(
            f"{where}: warn_c, max_c and limp_c must rise, found {heat[0]}, {heat[1]} and {heat[2]}"
        )
