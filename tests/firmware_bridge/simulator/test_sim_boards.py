"""The simulated LSC and RRC boards do what their hosts are told of them."""

import pytest

from firmware_bridge.codec import lsc, lx, rrc, rrc_frames
from firmware_bridge.simulator.lsc_board import LscBoard, LscPwmBoard
from firmware_bridge.simulator.rrc_board import RrcBoard, RrcBusBoard
from firmware_bridge.simulator.servo import SimServo

WAVE = (lsc.Move(200, ((1, 700),)), lsc.Move(200, ((1, 300),)))


def servos(*ids, at=500, ticks=(0, 1000)):
    return [SimServo(one, at, ticks, 4000.0) for one in ids]


@pytest.fixture
def board():
    return LscBoard(servos(1, 2, 3), {8: WAVE})


@pytest.fixture
def rrc_board():
    return RrcBoard(servos(1, 3, at=1500, ticks=(500, 2500)), servos(5, 6))


def run(firmware, seconds):
    for _ in range(round(seconds / 0.01)):
        firmware.step(0.01)


def told(board, *messages):
    for message in messages:
        board.feed(lsc.encode(message))
    return [lsc.decode_from_board(frame) for frame in lsc.host_parser().feed(board.replies())]


def answers(firmware, *messages):
    for message in messages:
        firmware.feed(rrc.encode(message))
    frames = rrc_frames.host_parser().feed(firmware.replies())
    return [rrc.decode_from_board(frame) for frame in frames]


def test_lsc_moves_all_servos_of_a_frame_and_tells_where_they_are(board):
    assert told(board, lsc.Move(100, ((1, 600), (2, 300)))) == []
    run(board, 0.4)
    ask = lsc.PositionRequest((1, 2, 3))
    assert told(board, ask) == [lsc.Positions(((1, 600), (2, 300), (3, 500)))]
    assert board.commanded == {1: 600, 2: 300}


def test_lsc_leaves_out_servos_that_do_not_answer(board):
    board.servos[1].is_dead = True
    assert told(board, lsc.PositionRequest((1, 2))) == [lsc.Positions(((1, 500),))]
    assert told(board, lsc.PositionRequest((2, 77))) == []


def test_lsc_servos_keep_within_range_and_their_own_limits(board):
    board.members[0].set_limits(200, 800)
    told(board, lsc.Move(0, ((1, 1000), (2, 2000), (77, 500))))
    assert board.commanded == {1: 800, 2: 1000}
    assert (board.n_clamped, board.n_rejected) == (2, 1)


def test_lsc_unloads_until_the_next_move(board):
    told(board, lsc.Unload((1,)))
    assert not board.servos[0].is_torque_on
    assert board.servos[1].is_torque_on
    told(board, lsc.Move(0, ((1, 500),)))
    assert board.servos[0].is_torque_on


def test_lsc_tells_its_supply(board):
    assert told(board, lsc.BatteryRequest()) == [lsc.Battery(7400)]


def test_lsc_plays_a_group_as_often_as_told_and_says_when_it_is_over(board):
    assert told(board, lsc.GroupRun(8, 2)) == []
    places = []
    for _ in range(90):
        board.step(0.01)
        places.append(board.servos[0].measured)
    assert told(board) == [lsc.GroupComplete(8, 2)]
    n_up = sum(before <= 600 < after for before, after in zip(places, places[1:]))
    assert n_up == 2
    assert places[-1] == pytest.approx(300, abs=3)


def test_lsc_group_stops_when_told_and_can_be_slowed(board):
    told(board, lsc.GroupSpeed(8, 50), lsc.GroupRun(8, 0))
    run(board, 0.35)
    assert 600 < board.servos[0].measured < 700  # twice as long as it was taught
    told(board, lsc.GroupStop())
    run(board, 3.0)
    assert board.commanded == {1: 700}


def test_lsc_says_unasked_what_the_pad_does(board):
    board.press(8)
    assert told(board) == [lsc.GroupRun(8, 1)]
    run(board, 0.1)
    board.press_stop()
    assert told(board) == [lsc.GroupStop()]
    run(board, 1.0)
    assert told(board) == []


def test_lsc_ignores_groups_it_does_not_have(board):
    assert told(board, lsc.GroupRun(9, 1)) == []
    run(board, 1.0)
    assert told(board) == []


def test_lsc_with_pwm_servos_takes_pulses_and_measures_nothing():
    board = LscPwmBoard(servos(1, at=1500, ticks=(500, 2500)))
    assert told(board, lsc.Move(0, ((1, 2000),)), lsc.PositionRequest((1,))) == []
    run(board, 0.5)
    assert board.servos[0].measured == 2000
    told(board, lsc.Move(0, ((1, 100),)))
    assert board.commanded == {1: 500}


def test_rrc_bus_servos_move_stop_and_are_measured(rrc_board):
    assert answers(rrc_board, rrc.BusMove(400, ((5, 900), (6, 100)))) == []
    run(rrc_board, 0.2)
    answers(rrc_board, rrc.BusStop((5, 6)))
    run(rrc_board, 0.5)
    five, six = answers(rrc_board, *(rrc.BusRead(one, rrc.BUS_POSITION) for one in (5, 6)))
    assert 640 < five.values[0] < 720
    assert 280 < six.values[0] < 360


def test_rrc_says_when_a_bus_servo_does_not_answer(rrc_board):
    for what, code in rrc.BUS_READS.items():
        (reply,) = answers(rrc_board, rrc.BusRead(77, what))
        assert (reply.is_ok, reply.what) == (False, what)
        assert len(reply.values) == len(code) - 1


def test_rrc_tells_everything_of_a_bus_servo(rrc_board):
    expected = {
        rrc.BUS_POSITION: (500,),
        rrc.BUS_VIN: (7400,),
        rrc.BUS_TEMPERATURE: (30,),
        rrc.BUS_TORQUE: (1,),
        rrc.BUS_ID: (5,),
        rrc.BUS_OFFSET: (0,),
        rrc.BUS_LIMITS: (0, 1000),
        rrc.BUS_VIN_LIMITS: (4500, 12000),
        rrc.BUS_TEMP_LIMIT: (85,),
    }
    for what, values in expected.items():
        assert answers(rrc_board, rrc.BusRead(5, what)) == [rrc.BusReply(5, what, True, values)]


def test_rrc_stores_settings_in_bus_servos(rrc_board):
    messages = (
        rrc.BusLimits(5, 200, 800),
        rrc.BusVinLimits(5, 5000, 9000),
        rrc.BusTempLimit(5, 70),
        rrc.BusOffset(5, -20),
        rrc.BusSaveOffset(5),
        rrc.BusTorque(5, False),
        rrc.BusSetId(5, 9),
    )
    assert answers(rrc_board, *messages) == []
    told_of = {what: answers(rrc_board, rrc.BusRead(9, what))[0].values for what in rrc.BUS_READS}
    assert told_of[rrc.BUS_LIMITS] == (200, 800)
    assert told_of[rrc.BUS_VIN_LIMITS] == (5000, 9000)
    assert told_of[rrc.BUS_TEMP_LIMIT] == (70,)
    assert told_of[rrc.BUS_OFFSET] == (-20,)
    assert told_of[rrc.BUS_TORQUE] == (0,)
    assert rrc_board.n_rejected == 0


def test_rrc_counts_what_bus_servos_do_not_take(rrc_board):
    rrc_board.feed(rrc_frames.frame_bytes(5, bytes.fromhex("30 05 84 03 64 00")))  # 900..100
    answers(rrc_board, rrc.BusMove(0, ((77, 500),)))
    assert rrc_board.n_rejected == 2
    assert rrc_board.members[0].limits == (0, 1000)


def test_rrc_pwm_offset_shifts_the_pulse_and_not_what_is_told(rrc_board):
    answers(rrc_board, rrc.PwmOffset(3, 50), rrc.PwmMove(0, ((3, 1600),)))
    run(rrc_board, 0.5)
    assert rrc_board.servos[1].measured == 1650
    assert answers(rrc_board, rrc.PwmPositionRequest(3)) == [rrc.PwmPosition(3, 1600)]
    assert answers(rrc_board, rrc.PwmOffsetRequest(3)) == [rrc.PwmOffsetReply(3, 50)]
    assert answers(rrc_board, rrc.PwmPositionRequest(5)) == []  # a bus servo has no pulse


def test_rrc_counts_signals_and_ignores_what_it_does_not_drive(rrc_board):
    assert answers(rrc_board, rrc.Led(1, 1, 1, 1), rrc.Buzzer(1, 1, 1, 1)) == []
    assert rrc_board.n_signals == 2
    assert rrc_board.commanded == {}


def test_rrc_pushes_the_supply_of_its_first_servo_or_the_one_that_is_set():
    board = RrcBusBoard(servos(1))
    board.servos[0].supply_mv = 7100.0
    run(board, 1.0)
    board.battery_mv = 6800
    run(board, 1.0)
    assert answers(board) == [rrc.Battery(7100), rrc.Battery(6800)]


@pytest.mark.parametrize("make", [LscBoard, RrcBusBoard])
def test_a_board_hears_nothing_at_another_baud(make):
    board = make(servos(1))
    assert not board.listen(4800)
    move = rrc.BusMove(0, ((1, 600),)) if make is RrcBusBoard else lsc.Move(0, ((1, 600),))
    frame = rrc.encode(move) if make is RrcBusBoard else lsc.encode(move)
    board.feed(frame)
    assert board.commanded == {}
    assert board.listen(board.baud)
    board.feed(frame)
    assert board.commanded == {1: 600}


def test_bus_servos_behind_a_board_are_those_of_the_bus():
    board = RrcBusBoard(servos(1))
    board.members[0].set_offset(10)
    assert answers(board, rrc.BusRead(1, rrc.BUS_OFFSET))[0].values == (10,)
    assert board.members[0].read(lx.OFFSET_READ) == (10,)
