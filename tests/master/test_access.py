"""Objects over SDO: block transfer where there is one, segments else; every failure one clear line."""

from typing import Any

import pytest

from canfb import CorrectionTable, Frame, objects as od
from canfb.cia301.datatypes import DataType
from canfb.master.access import REALS, CommissioningError, ObjectAbsentError, as_real32
from canfb.master.session import SupervisionLimits
from commissioning_kit import Bench
from node_commands import abort, between, interrupt

TABLE = CorrectionTable.identity(300)


def without_blocks(bench: Bench) -> list[int]:
    """The module refuses block transfers, as canopen's LocalNode does; the commands that came."""
    commands: list[int] = []

    def refuse(frame: Frame) -> list[Frame] | None:
        commands.append(frame.data[0])
        return abort(frame, 0x05040001) if frame.data[0] >> 5 in (5, 6) else None

    between(bench, refuse)
    return commands


@pytest.mark.parametrize("blocks", [True, False])
@pytest.mark.parametrize("entries", [16, 17, 256, 300, 4096])
def test_a_domain_goes_there_and_back(blocks: bool, entries: int) -> None:
    bench, table = Bench(sync=False), CorrectionTable.identity(entries)
    if not blocks:
        without_blocks(bench)
    bench.access.download_domain(0x2020, 1, table.to_bytes())
    assert bench.value(0x2020, 2) == table.crc32
    bench.access.write(0x2020, 3, "I", table.crc32)
    heard: list[float] = []
    assert bench.access.upload_domain(0x2020, 1, heard.append) == table.to_bytes()
    commands = [frame.data[0] for frame in bench.master.sent if frame.can_id == 0x620]
    assert (0xC6 in commands, 0xA4 in commands) == (True, True), "block transfer is tried first"
    assert (0x21 in commands, 0x40 in commands) == (not blocks, not blocks)


def test_every_real_of_encoder_and_supervision_is_read_as_one() -> None:
    bench = Bench(sync=False)
    reals = {
        (entry.index, entry.subindex)
        for entry in bench.module.dictionary
        if entry.index in (0x2001, 0x2010, 0x2011, 0x2014) and entry.data_type == DataType.REAL32
    }
    assert reals == REALS
    bench.access.write(*od.SUPERVISION_SYNC_JITTER, "f", 1e-4)
    assert SupervisionLimits.read(bench.access).values[od.SUPERVISION_SYNC_JITTER] == as_real32(1e-4)


def test_what_is_refused_is_one_line_with_the_reason() -> None:
    access = Bench(sync=False).access
    with pytest.raises(CommissioningError) as error:
        access.write(0x2020, 3, "I", 12345)
    assert str(error.value) == (
        "module 32 (20h): writing 2020:03 is refused: Code 0x06090030, Value range of parameter exceeded"
    )
    with pytest.raises(ObjectAbsentError, match="reading 2099:01 is refused"):
        access.read(0x2099, 1, "I")
    with pytest.raises(ObjectAbsentError, match="reading 2020:63 is refused"):
        access.upload_domain(0x2020, 0x63)
    with pytest.raises(ObjectAbsentError):
        access.download_domain(0x2099, 1, b"12345678")
    with pytest.raises(CommissioningError, match=r"2001:02 has 2 bytes, not 4"):
        access.read(0x2001, 2, "I")


class Interrupted(BaseException):
    """As KeyboardInterrupt, wherever it comes."""


@pytest.mark.parametrize("blocks", [True, False])
@pytest.mark.parametrize("at", [2, 5, 20])
def test_an_interrupted_download_stages_no_half_table(blocks: bool, at: int) -> None:
    bench = Bench(sync=False)
    commands = without_blocks(bench) if not blocks else None
    interrupt(bench, at + (not blocks) * 2, Interrupted)
    with pytest.raises(Interrupted):
        bench.access.download_domain(0x2020, 1, TABLE.to_bytes())
    assert bench.value(0x2020, 2) == 0, "nothing is staged"
    sent = [frame for frame in bench.master.sent if frame.can_id == 0x620]
    assert sent[-1].data[0] == 0x80, "the transfer is aborted"
    assert commands is None or 0x21 in commands
    bench.access.download_domain(0x2020, 1, TABLE.to_bytes())
    assert bench.value(0x2020, 2) == TABLE.crc32


@pytest.mark.parametrize("answer", [bytes(8), b"\xff" * 8, b"\x43", b"", bytes(range(8))])
@pytest.mark.parametrize("doing", ["upload", "download", "read"])
def test_nonsense_as_an_answer_is_one_line(answer: bytes, doing: str) -> None:
    bench = Bench(sync=False)
    between(bench, lambda frame: [Frame(0x5A0, answer)])
    act: dict[str, Any] = {
        "upload": lambda: bench.access.upload_domain(0x2020, 1),
        "download": lambda: bench.access.download_domain(0x2020, 1, TABLE.to_bytes()),
        "read": lambda: bench.access.read(0x2020, 4, "I"),
    }
    with pytest.raises(CommissioningError) as error:
        act[doing]()
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("module 32 (20h): ")
