"""What a simulated servo does beyond following a ramp, each feature by itself."""

import random
from dataclasses import replace

import pytest

from firmware_bridge.codec.protocol import ServoFlag
from firmware_bridge.simulator.physics import PHYSICS, PLAIN, Physics, Supply
from firmware_bridge.simulator.servo import SimServo

TICKS = (0, 1000)
RATE = 1000.0


def servo(physics=PLAIN, at=500, supply=None, seed=None):
    rng = None if seed is None else random.Random(seed)
    return SimServo(1, at, TICKS, RATE, physics=physics, supply=supply, rng=rng)


def run(one, seconds, dt_s=0.01):
    for _ in range(round(seconds / dt_s)):
        one.step(dt_s)


def test_plain_servo_follows_its_ramp_and_ends_on_target():
    one = servo()
    one.command(700, 0.5)
    run(one, 0.25)
    assert 580 < one.actual < 600.5  # the ramp is at 600, the shaft a lag behind
    run(one, 1.0)
    assert one.measured == 700
    assert one.load_permille == 0.0
    assert one.flags == ServoFlag.NONE


def test_rate_limits_a_jump():
    one = servo(at=0)
    one.command(1000, 0.0)
    run(one, 0.5)
    assert one.actual == pytest.approx(500.0, abs=1.0)


def test_play_is_lost_when_the_direction_turns():
    one = servo(Physics(backlash_ticks=10.0))
    one.command(600, 0.2)
    run(one, 2.0)
    up = one.actual
    one.command(500, 0.2)
    run(one, 2.0)
    assert up == pytest.approx(595.0, abs=0.1)
    assert one.actual == pytest.approx(505.0, abs=0.1)


def test_weight_makes_the_arm_sag_and_is_reported_as_load():
    one = servo(Physics(sag_ticks=20.0, gravity_permille=-400.0))
    one.command(600, 0.2)
    run(one, 2.0)
    assert one.actual == pytest.approx(592.0, abs=0.1)
    assert one.load_permille == pytest.approx(400.0, abs=1.0)


def test_weight_is_gone_where_the_arm_is_upright():
    physics = Physics(sag_ticks=20.0, gravity_permille=-400.0, level_ticks=100, ticks_per_rad=239)
    one = servo(physics)
    one.command(100 + 239 * 1.5707963, 0.2)
    run(one, 2.0)
    assert one.actual == pytest.approx(475.4, abs=0.1)


@pytest.mark.parametrize(("friction", "falls"), [(100.0, True), (500.0, False)])
def test_limp_arm_falls_unless_friction_holds_it(friction, falls):
    one = servo(Physics(gravity_permille=-400.0, friction_permille=friction))
    one.is_torque_on = False
    run(one, 1.0)
    assert (one.actual < 400) is falls
    assert (one.actual == 500) is not falls


def test_jammed_servo_reports_a_stall_and_recovers_when_freed():
    one = servo(PHYSICS["lx16a"])
    one.is_stuck = True
    one.command(800, 0.1)
    run(one, 0.2)
    assert not one.flags & ServoFlag.STALL
    run(one, 0.5)
    assert one.flags & ServoFlag.STALL
    assert one.load_permille == 1000.0
    assert one.measured == 500
    one.is_stuck = False
    run(one, 1.0)
    assert not one.flags & ServoFlag.STALL
    assert abs(one.measured - 800) <= 1


def test_even_a_plain_servo_jams():
    one = servo()
    one.is_stuck = True
    one.command(800, 0.1)
    run(one, 0.7)
    assert one.measured == 500
    assert one.flags == ServoFlag.STALL


def test_servo_that_protects_itself_gives_less_torque_when_stalled():
    one = servo(PHYSICS["sts"])
    one.block_ticks = (0.0, 550.0)
    one.command(900, 0.1)
    run(one, 2.0)
    assert one.actual <= 550.0
    assert one.is_stalled
    assert one.load_permille == 200.0


def test_stalled_servo_overheats_drops_its_torque_and_comes_back_cool():
    one = servo(PHYSICS["lx16a"])
    one.is_stuck = True
    one.command(900, 0.1)
    run(one, 120.0, dt_s=0.05)
    assert one.flags & ServoFlag.OVERHEAT
    assert not one.is_torque_on
    assert one.current_ma == pytest.approx(30.0)
    one.is_stuck = False
    run(one, 60.0, dt_s=0.05)
    assert not one.flags & ServoFlag.OVERHEAT
    assert one.is_torque_on
    assert one.temperature_c < 80.0


def test_other_servos_stay_limp_after_overheating_until_switched_on():
    one = servo(PHYSICS["sts"])
    one.temperature_c = 75.0
    one.step(0.01)
    assert one.flags & ServoFlag.OVERHEAT
    one.is_torque_on = True  # refused while it is hot
    assert not one.is_torque_on
    run(one, 80.0, dt_s=0.05)
    assert not one.flags & ServoFlag.OVERHEAT
    assert not one.is_torque_on
    one.is_torque_on = True
    assert one.is_torque_on


def test_supply_sags_with_the_load_of_all_servos():
    supply = Supply(7400.0, sag_mv=500.0)
    physics = Physics(gravity_permille=-600.0)
    all_servos = [servo(physics, supply=supply) for _ in range(3)]
    for _ in range(3):
        for one in all_servos:
            one.step(0.01)
    assert all_servos[2].supply_mv == pytest.approx(7400.0 - 3 * 300.0)


def test_brown_out_resets_a_servo_and_costs_its_ram():
    one = servo(PHYSICS["lx16a"])
    calls = []
    one.on_reset = lambda: calls.append(one.servo_id)
    one.command(900, 0.5)
    run(one, 0.2)
    one.supply_mv = 4000.0
    one.step(0.01)
    assert calls == [1]
    assert not one.is_answering
    assert not one.is_torque_on
    one.command(100, 0.1)  # it does not hear that
    run(one, 1.0)  # nor does it boot without power
    assert not one.is_answering
    one.supply_mv = 7400.0
    run(one, 0.5)
    assert one.is_answering
    assert not one.is_torque_on  # limp after a reset
    assert one.n_resets == 1
    assert 500 < one.target < 900


def test_voltage_out_of_range_is_flagged():
    one = servo(PHYSICS["lx16a"])
    one.supply_mv = 12500.0
    assert one.flags == ServoFlag.VOLTAGE
    one.limits_mv = (4500.0, 13000.0)
    assert one.flags == ServoFlag.NONE


def test_sensor_noise_is_seeded_and_off_by_default():
    noisy = replace(PLAIN, noise_ticks=3.0)
    looks = [[one.measured for _ in range(50)] for one in (servo(noisy, seed=s) for s in (1, 1, 2))]
    assert looks[0] == looks[1] != looks[2]
    assert len(set(looks[0])) > 3
    assert {servo(PLAIN, seed=1).measured for _ in range(50)} == {500}


def test_dead_or_deaf_servo_does_nothing_it_is_told():
    for fault in ("is_dead", "is_deaf"):
        one = servo()
        setattr(one, fault, True)
        one.command(900, 0.1)
        run(one, 0.5)
        assert one.measured == 500
        assert not one.is_answering


def test_executed_commands_are_told_to_the_listener():
    one = servo()
    told = []
    one.on_event = lambda _servo, what, numbers: told.append((what, numbers))
    one.command(900, 0.1)
    one.stop()
    one.is_torque_on = False
    one.is_torque_on = False
    one.reset()
    assert [what for what, _ in told] == ["move", "stop", "torque", "reset"]
    assert told[0][1] == {"ticks": 900.0, "duration_s": 0.1}
