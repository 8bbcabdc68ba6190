"""The own readers of bus logs against those of python-can: the same frames, to the bit."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.logs.log_reader import BusLogFile, LogError

MESSAGES = st.lists(
    st.builds(
        lambda step, can_id, data, remote, extended, fd, error, channel: (
            step,
            can.Message(
                arbitration_id=can_id,
                data=b"" if remote or error else data,
                is_remote_frame=remote and not fd and not error,
                is_extended_id=extended or can_id > 0x7FF,
                is_fd=fd and not error,
                is_error_frame=error,
                channel=channel,
            ),
        ),
        st.integers(0, 2_000_000),
        st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF)),
        st.binary(max_size=8),
        *(st.booleans().map(lambda value: value),) * 2,
        st.sampled_from([False, False, False, True]),
        st.sampled_from([False, False, False, True]),
        st.integers(0, 1),
    ),
    max_size=40,
)


def written(path: Path, messages: list[tuple[int, can.Message]]) -> Path:
    at = 1_700_000_000_000_000
    with can.Logger(path) as logger:
        for step, message in messages:
            at += step
            message.timestamp = at / 1e6
            logger.on_message_received(message)
    return path


def by_python_can(path: Path, channel: str | None) -> list[Frame]:
    frames = []
    for one in can.LogReader(path):
        if one.is_error_frame:  # of candump it has no channel
            continue
        if channel not in (None, str(one.channel)) or one.is_extended_id or one.is_fd:
            continue
        frames.append(Frame(one.arbitration_id, bytes(one.data), one.is_remote_frame, one.timestamp))
    return frames


@pytest.mark.parametrize("suffix", [".log", ".blf"])
@settings(max_examples=40)
@given(messages=MESSAGES)
def test_they_give_the_frames_of_python_can(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, messages: list[tuple[int, can.Message]]
) -> None:
    path = written(tmp_path_factory.mktemp("logs") / f"bus{suffix}", messages)
    for channel in (None, "can1" if suffix == ".log" else "1"):
        log = BusLogFile(path, channel)
        assert list(log) == by_python_can(path, channel)
        assert log.trouble is None
        counters = log.counters
        assert counters.frames == sum(1 for _ in can.LogReader(path))
        assert counters.damaged_lines == 0
        assert channel is None or counters.channels <= {channel}
        others = [
            (str(one.channel), one.arbitration_id)
            for one in can.LogReader(path)
            if not (one.is_error_frame or one.is_extended_id or one.is_fd)
            and channel not in (None, str(one.channel))
        ]
        left_out = [(name, can_id) for name, ids in counters.left_out.items() for can_id in ids.elements()]
        assert sorted(left_out) == sorted(others)


def test_many_containers(tmp_path: Path) -> None:
    messages = [
        (
            100,
            can.Message(arbitration_id=n % 0x7FF, data=struct.pack("<I", n), is_extended_id=False, channel=0),
        )
        for n in range(9000)
    ]
    messages[4000][1].is_extended_id = True
    path = written(tmp_path / "bus.blf", messages)
    assert list(BusLogFile(path)) == by_python_can(path, None)


@given(
    data=st.binary(max_size=400),
    suffix=st.sampled_from([".log", ".blf", ".asc", ".trc", ".log.gz", ".csv", ".db"]),
    begin=st.booleans(),
)
def test_any_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, suffix: str, begin: bool
) -> None:
    path = tmp_path_factory.mktemp("logs") / f"bus{suffix}"
    path.write_bytes((b"(1.0) can0 080#\n" if begin else b"") + data)
    try:
        log = BusLogFile(path)
        frames = list(log)
    except LogError as error:
        refused = str(error)
    else:
        refused = "-"
        assert all(len(frame.data) <= 8 or suffix == ".csv" for frame in frames)
    assert len(refused.splitlines()) == 1
