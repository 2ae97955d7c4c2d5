import pytest
from plain_bus import (
    BATTERY,
    MOVE,
    POSITION,
    STOP,
    Line,
    Plain,
    PlainBlind,
    PlainNoTarget,
    PlainServos,
    frame,
    number,
)

from firmware_bridge.bus import Bus, BusSettings, Priority, Verdict
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.errors import LinkLost, MotionRefused, ProtocolError


def answer(servo_id, value, command=POSITION):
    return frame(servo_id, command | 0x80, number(value))


def make(protocol=None, settings=None):
    line = Line(PlainServos())
    bus = Bus(protocol or Plain(), line, settings, line.clock)
    bus.open()
    return bus, line


@pytest.fixture
def known():
    """A bus that has heard all three servos before."""
    bus, line = make()
    assert len(bus.read(Quantity.POSITION, (1, 2, 3))) == 3
    line.written.clear()
    return bus, line


def moves(line):
    return [whole for whole in line.servos.log if whole[3] == MOVE]


# -- reading ----------------------------------------------------------------------------------


def test_a_reading_carries_value_time_and_tries(known):
    bus, line = known
    reading = bus.read(Quantity.POSITION, (2,))[2]
    assert reading.values == (500,)
    assert reading.n_tries == 1
    assert reading.t_s == pytest.approx(line.clock())


def test_the_first_reading_ever_must_be_confirmed():
    bus, line = make()
    line.answers = [lambda true: answer(1, 900)]
    reading = bus.read(Quantity.POSITION, (1,))[1]
    assert reading.values == (500,)
    assert reading.n_tries == 3


def test_a_quiet_first_reading_takes_two_questions():
    bus, line = make()
    assert bus.read(Quantity.POSITION, (1,))[1].n_tries == 2
    assert bus.read(Quantity.POSITION, (1,))[1].n_tries == 1


def test_a_jump_that_a_second_answer_does_not_confirm_is_dropped(known):
    bus, line = known
    line.answers = [lambda true: answer(1, 560)]
    reading = bus.read(Quantity.POSITION, (1,))[1]
    assert (reading.values, reading.n_tries) == ((500,), 2)
    assert bus.stats.implausible >= 1


def test_a_true_jump_is_taken_after_two_answers(known):
    bus, line = known
    line.servos.servos[1].actual = 800.0
    line.servos.servos[1].target = 800.0
    line.servos.servos[1].command(800.0, 0.0)
    reading = bus.read(Quantity.POSITION, (1,))[1]
    assert (reading.values, reading.n_tries) == ((800,), 2)


def test_a_value_that_no_servo_can_have_is_never_taken_however_often(known):
    bus, line = known
    line.answers = [lambda true: answer(1, 3000)] * 10
    assert bus.read(Quantity.POSITION, (1,)) == {}


def test_a_shaft_a_little_outside_its_range_is_read():
    bus, line = make()
    line.servos.servos[1].actual = -12.0
    line.servos.servos[1].command(-12.0, 0.0)
    assert bus.read(Quantity.POSITION, (1,))[1].values == (-12,)


def test_after_a_reconnect_the_first_reading_must_be_confirmed_again(known):
    bus, line = known
    bus.close()
    bus.open()
    assert bus.read(Quantity.POSITION, (1,))[1].n_tries == 2


@pytest.mark.parametrize(
    "wrong",
    [
        lambda true: answer(2, 500),  # another servo
        lambda true: answer(1, 30, command=5),  # another command
        lambda true: true[:-1] + bytes((true[-1] ^ 1,)),  # damaged
        lambda true: true[:4],  # cut
        lambda true: b"",  # lost
        lambda true: b"\xa5\x01" + true[:3],  # garbage that looks like a start
    ],
)
def test_an_answer_that_does_not_fit_is_asked_for_again(known, wrong):
    bus, line = known
    line.answers = [wrong]
    reading = bus.read(Quantity.POSITION, (1,))[1]
    assert (reading.values, reading.n_tries) == ((500,), 2)
    assert bus.stats.retries > 0


def test_an_answer_behind_garbage_is_found_at_once(known):
    bus, line = known
    line.answers = [lambda true: b"\x00\xa5\x01\x07" + true]
    assert bus.read(Quantity.POSITION, (1,))[1].n_tries == 1


def test_an_answer_that_comes_too_late_does_not_answer_the_next_question(known):
    bus, line = known
    line.servos.say(answer(1, 505))  # on the line before anybody asks
    line.wait_readable(0.001)
    assert bus.read(Quantity.POSITION, (1,))[1].values == (500,)
    assert bus.stats.foreign == 1


def test_a_silent_servo_is_missing_and_the_others_are_there(known):
    bus, line = known
    del line.servos.servos[2]
    assert sorted(bus.read(Quantity.POSITION, (1, 2, 3))) == [1, 3]
    assert bus.stats.timeouts >= 2


def test_a_silent_servo_costs_no_more_than_the_budget(known):
    bus, line = known
    del line.servos.servos[2]
    before_s = line.clock()
    bus.read(Quantity.POSITION, (2,))
    assert line.clock() - before_s <= 0.025 + 1e-6


def test_the_number_of_questions_is_bounded():
    bus, line = make(settings=BusSettings(n_tries=3, budget_s=9.0))
    line.answers = [lambda true: b""] * 99
    assert bus.read(Quantity.POSITION, (1,)) == {}
    assert len(line.written) == 3


def test_the_board_itself_can_be_asked(known):
    bus, line = known
    assert bus.read(Quantity.VOLTAGE, ())[0].values == (7400,)


def test_a_quantity_that_the_protocol_does_not_know_is_refused(known):
    bus, line = known
    with pytest.raises(ProtocolError):
        bus.read(Quantity.LOAD, (1,))


def test_a_report_that_nobody_asked_for_is_kept_and_disturbs_nothing(known):
    bus, line = known
    line.answers = [lambda true: answer(0, 7310, BATTERY) + true]
    assert bus.read(Quantity.POSITION, (1,))[1].n_tries == 1
    assert bus.reports[Quantity.VOLTAGE].values == (7310,)
    assert bus.stats.unsolicited == 1


def test_draining_takes_reports_without_a_question(known):
    bus, line = known
    line.servos.say(answer(0, 7200, BATTERY))
    line.wait_readable(0.001)
    bus.drain()
    assert bus.reports[Quantity.VOLTAGE].values == (7200,)
    assert line.written == []


# -- moving -----------------------------------------------------------------------------------


def test_a_move_is_confirmed_by_what_the_servos_were_told(known):
    bus, line = known
    verdicts = bus.move([ServoTarget(1, 600), ServoTarget(2, 300)], 200)
    assert verdicts == {1: Verdict.CONFIRMED, 2: Verdict.CONFIRMED}
    assert len(moves(line)) == 2


def test_a_move_that_arrived_wrong_is_sent_again_once(known):
    bus, line = known
    line.commands = [lambda data: frame(1, MOVE, number(777) + number(200))]
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.CONFIRMED}
    assert line.servos.servos[1].target == 600
    assert len(moves(line)) == 2


def test_only_the_servo_that_was_told_wrong_is_told_again(known):
    bus, line = known
    line.commands = [lambda data: b""]
    assert bus.move([ServoTarget(1, 600), ServoTarget(2, 300)], 200)[1] is Verdict.CONFIRMED
    assert [whole[1] for whole in moves(line)] == [2, 1]


def test_a_servo_that_takes_no_target_is_a_mismatch(known):
    bus, line = known
    line.servos.servos[1].command = lambda ticks, duration_s: None
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.MISMATCH}
    assert len(moves(line)) == 2


def test_a_damaged_read_back_is_no_mismatch(known):
    bus, line = known
    line.answers = [lambda true: answer(1, 111, command=2)]
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.CONFIRMED}
    assert len(moves(line)) == 1


def test_a_dead_servo_is_unanswered(known):
    bus, line = known
    del line.servos.servos[1]
    verdicts = bus.move([ServoTarget(1, 600), ServoTarget(2, 300)], 200)
    assert verdicts == {1: Verdict.UNANSWERED, 2: Verdict.CONFIRMED}


def test_a_damaged_move_that_reached_another_servo_is_noticed_and_not_undone(known):
    bus, line = known
    bus.move([ServoTarget(i, 500) for i in (1, 2, 3)], 200)
    line.commands = [lambda data: frame(3, MOVE, number(600) + number(200))]
    verdicts = bus.move([ServoTarget(1, 600)], 200)
    assert verdicts == {1: Verdict.CONFIRMED, 3: Verdict.MISMATCH}
    assert line.servos.servos[3].target == 600


def test_what_frames_of_a_caller_told_other_servos_is_no_mismatch(known):
    bus, line = known
    bus.move([ServoTarget(2, 500)], 200)
    bus.send(Plain().move([ServoTarget(2, 700)], 200), Priority.MOVE)
    line.commands = [lambda data: b""]
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.CONFIRMED}


def test_a_move_that_a_newer_one_replaced_is_not_sent_again(known):
    bus, line = known
    newer = Plain().move([ServoTarget(1, 400)], 200)
    replaced = []

    def replace(data):
        if data[3] == MOVE and not replaced:
            replaced.append(data)
            line.on_write = lambda data: None
            bus._turns._is_taken = False  # as if another caller had come between
            bus.send(newer, Priority.MOVE)

    line.on_write = replace
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.MISMATCH}
    assert line.servos.servos[1].target == 400


def test_without_targets_to_read_the_position_is_compared_after_the_move():
    bus, line = make(PlainNoTarget())
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.CONFIRMED}
    assert line.clock() >= 0.2
    line.commands = [lambda data: b"", *[None] * 9]
    assert bus.move([ServoTarget(1, 500)], 100) == {1: Verdict.CONFIRMED}
    assert line.servos.servos[1].target == 500


def test_a_protocol_without_feedback_says_that_it_cannot_tell():
    bus, line = make(PlainBlind())
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.UNVERIFIABLE}


def test_a_move_without_verification_asks_nothing(known):
    bus, line = known
    assert bus.move([ServoTarget(1, 600)], 200, is_verified=False) == {1: Verdict.UNVERIFIABLE}
    assert len(line.written) == 1


# -- stopping ---------------------------------------------------------------------------------


def test_after_an_urgent_stop_moves_are_refused_until_released(known):
    bus, line = known
    bus.urgent((frame(1, STOP),))
    with pytest.raises(MotionRefused):
        bus.move([ServoTarget(1, 600)], 200)
    with pytest.raises(MotionRefused):
        bus.send((frame(1, MOVE, number(600) + number(200)),), Priority.MOVE)
    assert moves(line) == []
    assert bus.read(Quantity.POSITION, (1,))  # reading goes on
    bus.release()
    assert bus.move([ServoTarget(1, 600)], 200) == {1: Verdict.CONFIRMED}


def test_an_estop_by_priority_latches_too(known):
    bus, line = known
    bus.send((frame(1, STOP),), Priority.ESTOP)
    assert bus.is_latched


def test_an_urgent_stop_in_the_middle_of_a_list_ends_the_list(known):
    bus, line = known
    frames = Plain().move([ServoTarget(i, 600) for i in (1, 2, 3)], 200)
    line.on_write = lambda data: data == frames[0] and bus.urgent((frame(1, STOP),))
    with pytest.raises(MotionRefused):
        bus.send(frames, Priority.MOVE)
    assert line.written == [frames[0], frame(1, STOP)]


def test_a_stop_in_the_middle_of_a_list_ends_the_list_without_a_latch(known):
    bus, line = known
    frames = Plain().move([ServoTarget(i, 600) for i in (1, 2, 3)], 200)
    stop = frame(1, STOP)
    line.on_write = lambda data: data == frames[0] and bus.urgent((stop,), is_latched=False)
    with pytest.raises(MotionRefused):
        bus.send(frames, Priority.MOVE)
    line.on_write = lambda data: None
    bus.send(frames, Priority.MOVE)
    assert line.written == [frames[0], stop, *frames]


def test_a_question_that_a_stop_overtook_is_asked_again_by_itself(known):
    bus, line = known
    question = frame(1, POSITION)
    line.on_write = lambda data: line.written == [question] and bus.urgent((frame(1, STOP),))
    line.answers = [lambda true: b""]  # the collision destroys the answer
    reading = bus.read(Quantity.POSITION, (1,))[1]
    assert (reading.values, reading.n_tries) == ((500,), 1)
    assert bus.stats.preempted == 1


def test_a_stop_that_may_have_met_an_answer_goes_out_again_when_that_is_over(known):
    bus, line = known
    stop, question = frame(1, STOP), frame(1, POSITION)
    line.on_write = lambda data: line.written == [question] and bus.urgent((stop,))
    assert bus.read(Quantity.POSITION, (1,))[1].values == (500,)
    assert line.written[:4] == [question, stop, stop, stop]


def test_a_stop_on_a_quiet_line_goes_out_once(known):
    bus, line = known
    bus.urgent((frame(1, STOP),))
    assert line.written == [frame(1, STOP)]


def test_the_latch_holds_even_if_the_stop_found_no_line(known):
    bus, line = known
    bus.close()
    with pytest.raises(LinkLost):
        bus.urgent((frame(1, STOP),))
    bus.open()
    with pytest.raises(MotionRefused):
        bus.move([ServoTarget(1, 600)], 200)


@pytest.mark.parametrize(
    "act",
    [
        lambda bus: bus.read(Quantity.POSITION, (1,)),
        lambda bus: bus.move([ServoTarget(1, 600)], 200),
        lambda bus: bus.drain(),
        lambda bus: bus.send((b"x",), Priority.READ),
    ],
)
def test_a_closed_bus_is_one_error_and_leaves_the_turn_free(known, act):
    bus, line = known
    bus.close()
    assert not bus.is_open
    for _ in range(2):
        with pytest.raises(LinkLost):
            act(bus)
