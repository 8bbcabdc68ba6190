"""Lines to a pipe that nobody reads: the writer goes on, and the reader gets them all later, in order."""

import errno
import os
import select
from collections.abc import Iterator

import pytest

from canfb.bus.line_output import MOST_LINES, LineOutput


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for end in ends:
        os.close(end)


def excuse(lines: int) -> str:
    return f"{lines} left out"


def fill(writing: int) -> int:
    """Write until no more goes in; bytes."""
    filled = 0
    os.set_blocking(writing, False)
    try:
        while True:
            filled += os.write(writing, b"." * select.PIPE_BUF)
    except BlockingIOError:
        os.set_blocking(writing, True)
    return filled


def test_a_line_is_written_at_once(pipe: tuple[int, int]) -> None:
    output = LineOutput(pipe[1], excuse)
    output.put("position valid, Ω")
    assert os.read(pipe[0], 100) == "position valid, Ω\n".encode()
    LineOutput(pipe[1], excuse, "ascii").put("Ω")
    assert os.read(pipe[0], 100) == b"\\u03a9\n"


def test_a_full_disk_takes_them_when_it_has_room(
    pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    output = LineOutput(pipe[1], excuse)
    with monkeypatch.context() as full:
        full.setattr(os, "write", refuse)
        output.put("one")
        output.put("two")
        with pytest.raises(OSError, match="No space left"):
            output.flush(0.1)
    output.flush()
    assert os.read(pipe[0], 100) == b"one\ntwo\n"


def test_nothing_waits_for_a_reader_and_what_is_too_much_is_counted(pipe: tuple[int, int]) -> None:
    filled = fill(pipe[1])
    output = LineOutput(pipe[1], excuse)
    lines = ["long " * 2000, *map(str, range(MOST_LINES - 1))]
    for line in (*lines, *["too much"] * 7):
        output.put(line)
    output.flush()
    read = b""
    while len(read) < filled:
        read += os.read(pipe[0], filled - len(read))
    assert not select.select([pipe[0]], [], [], 0.0)[0]
    output.flush()
    assert os.read(pipe[0], 1 << 16).decode().splitlines() == [*lines, "7 left out"]
    output.put("again")
    assert os.read(pipe[0], 100) == b"again\n"


def test_a_reader_that_has_gone_is_an_error(pipe: tuple[int, int]) -> None:
    gone, writing = os.pipe()
    os.close(gone)
    try:
        with pytest.raises(BrokenPipeError):
            LineOutput(writing, excuse).put("nobody")
    finally:
        os.close(writing)
