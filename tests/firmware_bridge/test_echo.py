import pytest

from firmware_bridge.links.echo import EchoFilter

QUESTION = bytes.fromhex("55 55 01 03 1C DF")
ANSWER = bytes.fromhex("55 55 01 05 1C F4 01 E8")


def exchange(echo, received, n_chunk=99):
    echo.sent(QUESTION)
    chunks = [received[at : at + n_chunk] for at in range(0, len(received), n_chunk)]
    return b"".join(echo.strip(chunk) for chunk in chunks)


@pytest.mark.parametrize("n_chunk", [1, 2, 5, 99])
def test_an_echo_is_taken_out_in_whatever_chunks_it_comes(n_chunk):
    echo = EchoFilter()
    for _ in range(3):
        assert exchange(echo, QUESTION + ANSWER, n_chunk) == ANSWER
    assert echo.has_echo is True


@pytest.mark.parametrize("n_chunk", [1, 2, 5, 99])
def test_a_quiet_adapter_is_learned_and_loses_no_byte(n_chunk):
    echo = EchoFilter()
    for _ in range(3):
        assert exchange(echo, ANSWER, n_chunk) == ANSWER
    assert echo.has_echo is False


def test_nothing_is_known_before_the_first_answer():
    echo = EchoFilter()
    echo.sent(QUESTION)
    assert echo.strip(b"") == b""
    assert echo.has_echo is None


def test_several_frames_written_before_reading_are_all_taken_out():
    echo = EchoFilter()
    echo.sent(QUESTION)
    assert exchange(echo, QUESTION + QUESTION + ANSWER) == ANSWER


def test_a_damaged_echo_lets_the_answer_through():
    echo = EchoFilter()
    exchange(echo, QUESTION + ANSWER)
    damaged = b"\x55\x54" + QUESTION[2:]
    assert exchange(echo, damaged + ANSWER).endswith(ANSWER)
    assert exchange(echo, QUESTION + ANSWER) == ANSWER


def test_an_echo_behind_a_stray_byte_is_taken_out():
    echo = EchoFilter()
    exchange(echo, QUESTION + ANSWER)
    assert exchange(echo, b"\x00" + QUESTION + ANSWER) == b"\x00" + ANSWER


def test_a_line_that_nobody_reads_does_not_fill_the_memory():
    echo = EchoFilter()
    for _ in range(10000):
        echo.sent(QUESTION)
    assert len(echo._awaited) < 5000
