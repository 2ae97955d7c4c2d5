"""What a servo and its power supply are made of: numbers, each of which can be switched off.

``PLAIN`` (a rate limit and a lag, nothing else) is what a ``SimServo`` has unless it is told
otherwise. The other sets are plausible for the servo family they are named after, in the spirit of
its data sheet, and unverified: nobody measured them on hardware.
"""

from dataclasses import dataclass
from typing import Dict, List, Tuple


@dataclass(frozen=True)
class Physics:
    """Everything beyond rate and lag. Zero switches a feature off.

    Parameters
    ----------
    backlash_ticks : play between motor and shaft, in all.
    sag_ticks : how far the loop gives way under the largest torque (a proportional controller).
    gravity_permille : torque of the arm's weight at level, signed (positive pulls to more ticks),
        in thousandths of the largest torque.
    level_ticks, ticks_per_rad : where the arm is level, and the scale; 0: the weight pulls alike
        everywhere.
    friction_permille : torque to turn at full speed; a limp shaft holds that much weight.
    stall_s : this long at full torque without getting there is a stall.
    stall_share : an error smaller than this share of the range is none.
    stall_permille : torque left after a stall was noticed (some servos protect themselves).
    heat_c_s : heating at full torque; it grows with the square of the load.
    cool_s, ambient_c : time constant of cooling, and towards what.
    max_temperature_c, hysteresis_c : limp above the first, until colder by the second.
    is_back_when_cool : torque comes back by itself then.
    limits_mv : supply that it does not complain about.
    brown_out_mv : below this it resets.
    boot_s : how long it is deaf after a reset.
    is_limp_at_boot : torque is off after a reset.
    noise_ticks : standard deviation of its sensor.
    idle_ma, stall_ma : current at rest and at full torque.
    """

    backlash_ticks: float = 0.0
    sag_ticks: float = 0.0
    gravity_permille: float = 0.0
    level_ticks: float = 0.0
    ticks_per_rad: float = 0.0
    friction_permille: float = 0.0
    stall_s: float = 0.3
    stall_share: float = 0.01
    stall_permille: float = 1000.0
    heat_c_s: float = 0.0
    cool_s: float = 300.0
    ambient_c: float = 25.0
    max_temperature_c: float = 85.0
    hysteresis_c: float = 5.0
    is_back_when_cool: bool = False
    limits_mv: Tuple[float, float] = (0.0, 100_000.0)
    brown_out_mv: float = 0.0
    boot_s: float = 0.3
    is_limp_at_boot: bool = True
    noise_ticks: float = 0.0
    idle_ma: float = 0.0
    stall_ma: float = 0.0


PLAIN = Physics()

PHYSICS: Dict[str, Physics] = {
    # 0.24 degrees a tick. Unverified.
    "lx16a": Physics(
        backlash_ticks=2.0,
        sag_ticks=12.0,
        friction_permille=150.0,
        heat_c_s=0.9,
        is_back_when_cool=True,
        limits_mv=(4500.0, 12000.0),
        brown_out_mv=4200.0,
        idle_ma=30.0,
        stall_ma=2000.0,
    ),
    # 0.088 degrees a tick. Unverified.
    "sts": Physics(
        backlash_ticks=6.0,
        sag_ticks=20.0,
        friction_permille=120.0,
        stall_s=0.5,
        stall_permille=200.0,
        heat_c_s=1.2,
        max_temperature_c=70.0,
        limits_mv=(4000.0, 8000.0),
        brown_out_mv=3800.0,
        idle_ma=20.0,
        stall_ma=2700.0,
    ),
    # 0.088 degrees a tick. Unverified.
    "dxl2": Physics(
        backlash_ticks=3.0,
        sag_ticks=10.0,
        friction_permille=100.0,
        stall_s=0.5,
        heat_c_s=1.0,
        max_temperature_c=72.0,
        limits_mv=(6000.0, 14000.0),
        brown_out_mv=5500.0,
        idle_ma=40.0,
        stall_ma=1500.0,
    ),
    # Hobby servos behind a board, 0.09 degrees a tick (microsecond). Unverified.
    "pwm": Physics(
        backlash_ticks=10.0,
        sag_ticks=25.0,
        friction_permille=200.0,
        heat_c_s=1.0,
        max_temperature_c=1000.0,  # nothing inside looks after it
        brown_out_mv=4000.0,
        idle_ma=10.0,
        stall_ma=2500.0,
    ),
}
"""Family -> its numbers, all unverified. The weight of the arm is not among them: set it."""


class Supply:
    """One battery or adapter that several servos share: its voltage sags with their load.

    Parameters
    ----------
    nominal_mv : with nothing moving.
    sag_mv : drop per servo at full torque.
    """

    def __init__(self, nominal_mv: float = 7400.0, sag_mv: float = 0.0) -> None:
        self.nominal_mv = nominal_mv
        self.sag_mv = sag_mv
        self._loads: List[float] = []

    def attach(self) -> int:
        """Take in one more servo; returns the place under which it reports its load."""
        self._loads.append(0.0)
        return len(self._loads) - 1

    def report(self, place: int, load_permille: float) -> float:
        """Take a servo's load and return the voltage in mV."""
        self._loads[place] = abs(load_permille)
        return self.nominal_mv - self.sag_mv * sum(self._loads) / 1000.0
