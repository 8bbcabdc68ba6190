"""EDS 01 and OD 01 to OD 09: every object of the EDS answers as the EDS says."""

from collections.abc import Iterator

import pytest
from conformance_eds import DOMAIN, VISIBLE_STRING, EdsEntry
from conformance_kit import NO_READ, NO_WRITE, G, Tester, filled, hexes, little, m

from canfb.eds_files import eds_path
from processes import python

COMMUNICATION, DEVICE = range(0x1000, 0x2000), range(0x2000, 0x10000)
ERROR_HISTORY = 0x1003
STORE = (0x1010, 0x1011)
REFUSE_WRITE, REFUSE_READ = 1, 2  # ObjFlags (CiA 306)


def entries(tester: Tester, where: range) -> Iterator[EdsEntry]:
    for entry in tester.eds.entries.values():
        if entry.index in where:
            yield entry


def readable(tester: Tester, where: range) -> list[EdsEntry]:
    return [
        entry
        for entry in entries(tester, where)
        if entry.readable
        and not (entry.index == ERROR_HISTORY and entry.sub)  # empty: 08000024, see EMCY 03
        and not entry.flags & REFUSE_READ
    ]


def written_back(tester: Tester, where: range) -> list[EdsEntry]:
    return [
        entry
        for entry in readable(tester, where)
        if entry.writable
        and entry.index != ERROR_HISTORY
        and entry.index not in STORE
        and not 0x1400 <= entry.index <= 0x1BFF  # PDOs
        and not entry.flags & REFUSE_WRITE
    ]


def read(tester: Tester, entry: EdsEntry) -> bytes:
    """The value; more than 4 bytes come segmented."""
    first = tester.ask(f"40 {entry.m}")
    assert first[:2] != "80", f"{entry}: {first}"
    data = tester.upload(entry.m)
    if entry.size:
        assert len(data) == entry.size, entry
    if first[:2] == "41":
        assert len(data) > 4 or not data, entry
    return data


def write(tester: Tester, entry: EdsEntry, data: bytes) -> str:
    if 1 <= len(data) <= 4:
        request = f"{0x23 | (4 - len(data)) << 2:02X} {entry.m} {hexes(data)}"
        answer = tester.ask(request)
        return "ok" if answer == filled(f"60 {entry.m}") else answer
    return tester.download_segmented(entry.m, data)


def test_eds_01_static_check(tester: Tester) -> None:
    """The rules that this checker does not know are in tests/eds/test_cia301.py."""
    dcfchk = "import sys; from dcf.cli import main; sys.exit(main())"
    done = python("-c", dcfchk, "-n", str(tester.id), str(eds_path(tester.eds.name)))
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert {index for index, _ in tester.eds.entries} == tester.eds.objects.keys()
    for entry in tester.eds.entries.values():
        assert entry.size or entry.data_type in (VISIBLE_STRING, DOMAIN)


@pytest.mark.parametrize("where", [COMMUNICATION, DEVICE])
def test_od_01_and_07_and_od_09_read_and_write_back(tester: Tester, where: range) -> None:
    before = {entry: read(tester, entry) for entry in readable(tester, where)}
    assert before
    for entry in written_back(tester, where):
        assert write(tester, entry, before[entry]) == "ok", entry
        assert read(tester, entry) == before[entry], entry
    fixed = {entry: data for entry, data in before.items() if entry.default}  # the others are live
    assert {entry: read(tester, entry) for entry in fixed} == fixed


@pytest.mark.parametrize("where", [COMMUNICATION, DEVICE])
def test_od_02_and_08_and_sdo_13_defaults(tester: Tester, where: range) -> None:
    given = [e for e in entries(tester, where) if e.default and e.readable and not e.flags & REFUSE_READ]
    assert given
    defaults = {str(entry): entry.default for entry in given}
    assert {str(entry): read(tester, entry) for entry in given} == defaults


def test_od_03_write_what_is_read_only(tester: Tester) -> None:
    fixed = [entry for entry in tester.eds.entries.values() if entry.access in ("ro", "const")]
    assert fixed
    for entry in fixed:
        if 1 <= entry.size <= 4:
            tester.refuse(tester.download(entry.index, entry.sub, 0, entry.size), *NO_WRITE)
        # segmented and by block: at the first frame
        size = little(entry.size or 5, 4)
        tester.refuse(f"21 {entry.m} {size}", *NO_WRITE)
        tester.refuse(f"C6 {entry.m} {size}", *NO_WRITE)
        # the server waits for nothing: a segment belongs to no transfer
        tester.aborted(tester.ask("0B 00 00"), None, "05040001")


def test_od_04_and_sdo_04_read_what_is_write_only(tester: Tester) -> None:
    hidden = [entry for entry in tester.eds.entries.values() if entry.access == "wo"]
    assert hidden
    for entry in hidden:
        tester.refuse(f"40 {entry.m}", *NO_READ)
        tester.refuse(f"A0 {entry.m} 14 00", *NO_READ)


def test_od_05_type_information(tester: Tester) -> None:
    for index, object_type in tester.eds.objects.items():
        types = {e.sub: e.data_type for e in tester.eds.entries.values() if e.index == index}
        multiplexer = m(index, 0xFF)
        answer = tester.ask(f"40 {multiplexer}")
        if answer[:2] == "80":
            tester.aborted(answer, multiplexer, "06090011")  # not supported: allowed
            continue
        assert answer[:11] == f"43 {multiplexer}"
        information = int.from_bytes(bytes.fromhex(answer)[4:], "little")
        assert information & 0xFF == object_type
        if object_type in (0x02, 0x07, 0x08):
            assert information >> 8 == types[object_type == 0x08]


@pytest.mark.parametrize("side", ["low", "high"])
def test_od_06_limits(tester: Tester, side: str) -> None:
    limited = 0
    for entry in tester.eds.entries.values():
        limit = entry.low if side == "low" else entry.high
        if limit is None or not (entry.writable and entry.size <= 4):
            continue
        beyond = limit + (-1 if side == "low" else 1)
        if not 0 <= beyond < 1 << 8 * entry.size:
            continue  # no such value
        before = tester.upload(entry.m)
        request = tester.download(entry.index, entry.sub, beyond, entry.size)
        tester.refuse(request, "06090030", "06090032" if side == "low" else "06090031", G)
        assert tester.upload(entry.m) == before
        limited += 1
    assert limited or (side == "low" and tester.kind == "interface")
