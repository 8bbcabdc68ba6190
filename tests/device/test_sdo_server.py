"""SDO server: expedited and segmented transfers. What any device must do is in tests/conformance."""

from __future__ import annotations

import pytest
from device_kit import OK, Bench

from canfb.cia301.codes import AbortCode


def abort(multiplexer: str, code: AbortCode) -> list[str]:
    return [f"80{multiplexer}" + code.to_bytes(4, "little").hex().upper()]


def upload(bench: Bench, multiplexer: str) -> bytes:
    """A segmented upload by the book."""
    (answer,) = bench.sdo(f"40{multiplexer}")
    assert answer.startswith(f"41{multiplexer}")
    size = int.from_bytes(bytes.fromhex(answer)[4:], "little")
    data, toggle = b"", 0
    while True:
        (answer,) = bench.sdo(f"{0x60 | toggle:02X}")
        raw = bytes.fromhex(answer)
        assert raw[0] & 0xF0 == toggle
        data += raw[1 : 8 - (raw[0] >> 1 & 7)]
        toggle ^= 0x10
        if raw[0] & 1:
            assert len(data) == size
            return data


def download(bench: Bench, multiplexer: str, data: bytes, *, announce: bool = True) -> str:
    """A segmented download by the book; the last answer."""
    size = len(data).to_bytes(4, "little").hex()
    (answer,) = bench.sdo(f"21{multiplexer}{size}" if announce else f"20{multiplexer}")
    if answer != f"60{multiplexer}00000000":
        return answer
    parts = [data[place : place + 7] for place in range(0, len(data), 7)] or [b""]
    for number, part in enumerate(parts):
        toggle = 0x10 * (number & 1)
        last = number == len(parts) - 1
        (answer,) = bench.sdo(bytes([toggle | (7 - len(part)) << 1 | last, *part]).hex())
        if answer[:2] != f"{0x20 | toggle:02X}":
            return answer
    return OK


@pytest.mark.parametrize(
    ("request_", "multiplexer", "code"),
    [
        ("2F252000C9", "252000", AbortCode.VALUE_TOO_HIGH),
        ("2F25200002", "252000", AbortCode.VALUE_TOO_LOW),
        ("2108100010000000", "081000", AbortCode.READ_ONLY),
        ("2017100000000000", "171000", None),
        ("2117100003000000", "171000", AbortCode.TOO_LONG),
        ("2117100001000000", "171000", AbortCode.TOO_SHORT),
        ("2120200001000100", "202000", AbortCode.OUT_OF_MEMORY),
        ("40000500", "000500", AbortCode.NO_OBJECT),
        ("400010FF", "0010FF", AbortCode.NO_SUBINDEX),
    ],
)
def test_refusals(bench: Bench, request_: str, multiplexer: str, code: AbortCode | None) -> None:
    expected = [f"60{multiplexer}00000000"] if code is None else abort(multiplexer, code)
    assert bench.sdo(request_) == expected
    assert bench.node.counters.sdo_aborts == (code is not None)


@pytest.mark.parametrize("announce", [True, False])
def test_a_domain_of_16_kib_both_ways(bench: Bench, announce: bool) -> None:
    content = bytes(place * 7 & 0xFF for place in range(16384))
    seen: list[bytes] = []
    bench.dictionary.entry(0x2020).on_check = seen.append
    assert download(bench, "202000", content, announce=announce) == OK
    assert seen == [content]
    bench.dictionary.entry(0x2020).on_read = lambda: content[::-1]
    assert upload(bench, "202000") == content[::-1]


def test_the_upload_is_a_snapshot(bench: Bench) -> None:
    bench.sdo("40212000")
    bench.dictionary.entry(0x2021).value = "changed meanwhile"
    bench.dictionary.entry(0x2021).value = "text"
    bench.dictionary.entry(0x2026).value = 0x0807060504030201
    bench.sdo("40262000")
    bench.dictionary.entry(0x2026).value = 0
    assert bench.sdo("60") == ["0001020304050607"]
    assert bench.sdo("70") == ["1D08000000000000"]


def test_wrong_toggle_ends_a_download(bench: Bench) -> None:
    bench.sdo("2121200009000000")
    assert bench.sdo("10") == abort("212000", AbortCode.TOGGLE)
    assert bench.dictionary.entry(0x2021).value == "text"
    assert bench.sdo("00")[0].endswith("01000405")


def test_segments_of_the_other_direction_end_a_transfer(bench: Bench) -> None:
    bench.sdo("40081000")
    assert bench.sdo("00") == abort("081000", AbortCode.COMMAND)
    assert bench.sdo("60")[0].startswith("80")


def test_the_buffer_is_bounded(bench: Bench) -> None:
    answer = download(bench, "202000", bytes(70000), announce=False)
    assert answer == abort("202000", AbortCode.OUT_OF_MEMORY)[0]


def test_a_raising_program_leaves_the_server_usable(bench: Bench) -> None:
    def broken(value: int) -> None:
        raise RuntimeError("a mistake in the program")

    bench.dictionary.entry(0x2025).on_check = broken
    with pytest.raises(RuntimeError):
        bench.sdo("2F25200009")
    assert bench.read(0x1000) == 0x40191


REQUEST_2, RESPONSE_2 = 0x680, 0x6C0


def open_second(bench: Bench) -> None:
    assert bench.write(0x1201, 1, REQUEST_2, 4) == OK
    assert bench.send(REQUEST_2, "4000100000000000") == []
    assert bench.write(0x1201, 2, RESPONSE_2, 4) == OK


@pytest.mark.parametrize("value", [0x681, 0x20000680, 0x40000680, 0x00001680])
def test_channel_ids_are_fixed_while_valid(bench: Bench, value: int) -> None:
    open_second(bench)
    assert bench.write(0x1201, 1, value, 4) is AbortCode.INVALID_VALUE
    assert bench.read(0x1201, 1) == REQUEST_2
    assert bench.write(0x1201, 1, 0x80000681, 4) == OK
    assert bench.write(0x1201, 1, 0x681, 4) == OK
    assert bench.send(0x681, "4000100000000000") == ["6C0#4300100091010400"]


def test_expedited_text_without_a_size(bench: Bench) -> None:
    assert bench.sdo("2221200061626364") == ["6021200000000000"]
    assert bench.dictionary.entry(0x2021).value == "abcd"
