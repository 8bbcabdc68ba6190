"""Beyond 11 to 24; saved values of 13 and 19 stand with saving and restoring."""

from itertools import pairwise

import pytest
from conformance_eds import DOMAIN
from conformance_kit import INVALID, RPDO1, STATES, SYNC, Heard, Tester, filled, little, m, only

from canfb.eds_files import eds_path
from documentation import page


def test_beyond_11_a_short_rpdo(module: Tester) -> None:
    module.operational()
    good = module.send(RPDO1, "2C 01 78 05")
    assert module.emergencies(good) == []
    heard = module.send(RPDO1, "FF 00 FF") + module.send(RPDO1, "FF") + module.send(RPDO1)
    assert module.emergencies(heard) == ["8210"]
    assert module.ask("40 00 20 01") == filled("4B 00 20 01 2C 01")
    assert module.emergencies(module.send(RPDO1, "2D 01 78 05")) == ["0000"]
    assert module.ask("40 00 20 01") == filled("4B 00 20 01 2D 01")
    assert module.read(0x1001) == 0


def test_beyond_11_a_long_rpdo(module: Tester) -> None:
    module.operational()
    heard = module.send(RPDO1, "2C 01 78 05 AA BB CC DD")
    assert module.emergencies(heard) in ([], ["8220"])
    assert module.ask("40 00 20 01") == filled("4B 00 20 01 2C 01")
    assert module.ask("40 00 20 02") == filled("4B 00 20 02 78 05")
    assert module.ask("40 00 20 03") == filled("4B 00 20 03")


def test_beyond_12_all_that_is_not_there(tester: Tester) -> None:
    absent = filled("80 00 00 00 00 00 02 06")[12:]
    neighbours = {index + step for index in tester.eds.objects for step in (-1, 1)}
    for index in {*neighbours, *range(0, 0x10000, 7)} - set(tester.eds.objects):
        answer = tester.ask(f"40 {m(index)}")
        assert answer == f"80 {m(index)} {absent}", answer
    for index in tester.eds.objects:
        for sub in range(0xFF):
            if not tester.eds.has(index, sub):
                tester.refuse(f"40 {m(index, sub)}", "06090011")
                tester.refuse(f"2F {m(index, sub)} 00", "06090011")


@pytest.mark.parametrize("bit", [0, 1, 3, 4, 5, 6, 7, 8, 31])
def test_beyond_13_startup_bits_not_supported(tester: Tester, bit: int) -> None:
    before = tester.read(0x1F80)
    assert before & 4
    tester.refuse(f"23 80 1F 00 {little(1 << bit, 4)}", "06090030")
    assert tester.read(0x1F80) == before


def moved(tester: Tester, index: int, sub: int, new: int) -> None:
    """A new CAN-ID is refused while the object is in use, taken while it is invalid, and then used."""
    before = tester.read(index, sub)
    assert not before & INVALID
    tester.refuse(tester.download(index, sub, new, 4), "06090030")
    assert tester.read(index, sub) == before
    for value in (before | INVALID, new | INVALID, new):
        tester.write(index, sub, value, 4)
    assert tester.read(index, sub) == new
    tester.refuse(tester.download(index, sub, new | 0x20000000, 4), "06090030")


def test_beyond_14_a_valid_tpdo_keeps_its_can_id(tester: Tester) -> None:
    for index in tester.valid_tpdos:
        before = tester.read(index, 1)
        new = before & 0x40000000 | (before & 0x7FF) + 1
        moved(tester, index, 1, new)
        tester.accept(f"2F {m(index, 2)} 01")
        tester.operational()
        heard = tester.send(SYNC)
        assert len(only(heard, new & 0x7FF)) == 1
        assert only(heard, before & 0x7FF) == []
        tester.nmt("80")


def test_beyond_14_a_valid_emcy_keeps_its_can_id(tester: Tester) -> None:
    moved(tester, 0x1014, 0, 0x300)


def test_beyond_14_a_sync_producer_keeps_its_can_id(tester: Tester) -> None:
    tester.write(0x1006, 0, 100_000, 4)
    tester.write(0x1005, 0, 0x40000080, 4)
    tester.refuse("23 05 10 00 00 02 00 40", "06090030")
    assert tester.read(0x1005) == 0x40000080
    assert set(only(tester.wait(0.5), 0x080)) == {""}
    tester.refuse("23 05 10 00 80 00 00 20", "06090030")
    tester.write(0x1005, 0, 0x080, 4)
    tester.write(0x1005, 0, 0x200, 4)
    tester.write(0x1005, 0, 0x40000200, 4)
    heard = tester.wait(0.5)
    assert only(heard, 0x080) == []
    assert len(only(heard, 0x200)) >= 4


def test_beyond_14_a_valid_rpdo_keeps_its_can_id(module: Tester) -> None:
    moved(module, 0x1400, 1, 0x205)
    module.operational()
    module.send(RPDO1, "11 11 11 11")
    module.send(0x205, "22 22 22 22")
    assert module.ask("40 00 20 01") == filled("4B 00 20 01 22 22")


def test_beyond_14_a_valid_sdo_channel_keeps_its_can_ids(module: Tester) -> None:
    module.second_server()
    moved(module, 0x1201, 1, 0x6C1)
    assert only(module.send(0x6C1, filled("40 00 10 00")), 0x540)
    assert module.send(0x6C0, filled("40 00 10 00")) == []


def test_beyond_15_inhibit_time_and_start_value_of_a_valid_tpdo(tester: Tester) -> None:
    for index in tester.valid_tpdos:
        tester.refuse(f"2B {m(index, 3)} 64 00", "06090030", "08000022")
        tester.refuse(f"2F {m(index, 6)} 05", "06090030", "08000022")
        assert (tester.read(index, 3), tester.read(index, 6)) == (0, 0)
        tester.accept(f"2B {m(index, 5)} 64 00")


def test_beyond_15_the_event_timer_starts_anew(tester: Tester) -> None:
    for index in tester.valid_tpdos:
        can_id = tester.set_up_tpdo(index, "FE", timer_ms=200)
        tester.operational()
        tester.wait(0.15)
        tester.write(index, 5, 300, 2)
        begin = tester.now
        times = [frame.time - begin for frame in tester.wait(1.0) if frame.can_id == can_id]
        assert times == pytest.approx([0.3, 0.6, 0.9])
        tester.nmt("80")


def test_beyond_15_inhibit_time(module: Tester) -> None:
    """30 ms between frames; the one that waited has the newest data."""
    module.write(0x2010, 6, 255, 1)  # SYNCs that end later on are no samples
    module.write(0x1800, 1, 0xC00001A0, 4)
    module.write(0x1800, 3, 300, 2)
    module.write(0x1A00, 0, 0, 1)
    module.write(0x1A00, 1, 0x20110820, 4)  # samples processed
    module.write(0x1A00, 0, 1, 1)
    module.write(0x1800, 1, 0x400001A0, 4)
    module.operational()
    heard: list[Heard] = []
    for _ in range(10):
        heard += module.send(SYNC) + module.cause_event() + module.wait(0.008)
    heard += module.wait(0.1)
    frames = [frame for frame in heard if frame.can_id == 0x1A0]
    assert all(b.time - a.time == pytest.approx(0.03) for a, b in pairwise(frames))
    counts = [int.from_bytes(bytes.fromhex(frame.data), "little") for frame in frames]
    assert counts == [1, 4, 8, 10]


def test_beyond_16_reserved_types(tester: Tester) -> None:
    """On remote frames, and none allowed: refused with the type, or when the PDO is made valid."""
    for index in (*tester.tpdos, *tester.rpdos):
        before, cob_id = tester.read(index, 2), tester.read(index, 1)
        for kind in range(0xF1, 0xFC if index >= 0x1800 else 0xFE):
            tester.refuse(f"2F {m(index, 2)} {kind:02X}", "06090030")
        for kind in (0xFC, 0xFD) if index >= 0x1800 and cob_id >> 30 & 1 else ():
            if not cob_id >> 31:
                tester.refuse(f"2F {m(index, 2)} {kind:02X}", "06090030")
                continue
            tester.write(index, 2, kind, 1)
            tester.refuse(f"23 {m(index, 1)} {little(cob_id & 0x7FFFFFFF, 4)}", "06090030")
            tester.write(index, 2, before, 1)
        assert tester.read(index, 2) == before


def test_beyond_16_no_answer_where_none_is_allowed(tester: Tester) -> None:
    can_id = tester.set_up_tpdo(tester.valid_tpdos[0], "FE", remote=False)
    tester.operational()
    assert tester.remote(can_id) + tester.wait(1.0) == []


@pytest.mark.parametrize(("overflow", "wrong", "right"), [(0, ("01", "02"), ""), (10, ("", "01 02"), "05")])
def test_beyond_17_a_counter_not_expected_or_missing(
    tester: Tester, overflow: int, wrong: tuple[str, str], right: str
) -> None:
    if overflow:
        tester.write(0x1019, 0, overflow, 1)
    can_id = tester.set_up_tpdo(tester.valid_tpdos[0], "01")
    tester.operational()
    first, second = (tester.send(SYNC, counter) for counter in wrong)
    assert tester.emergencies(first + second) == ["8240"]
    assert [len(only(frames, can_id)) for frames in (first, second)] == [0, 0]  # no SYNC, always
    good = tester.send(SYNC, right)
    assert tester.emergencies(good) == ["0000"]
    assert len(only(good, can_id)) == 1


@pytest.mark.parametrize(("window_us", "delay", "taken"), [
    (10_000, 0.005, True), (10_000, 0.015, False), (0, 0.5, True),
])  # fmt: skip
def test_beyond_18_synchronous_window(module: Tester, window_us: int, delay: float, taken: bool) -> None:
    module.write(0x1007, 0, window_us, 4)
    module.write(0x1400, 2, 1, 1)
    can_id = module.set_up_tpdo(0x1801, "01")
    module.operational()
    assert len(only(module.send(SYNC), can_id)) == 1  # at the SYNC itself, within any window
    late = module.wait(delay) + module.send(RPDO1, "2C 01 78 05")
    assert only(late, can_id) == []
    module.send(SYNC)
    assert module.read(0x2000, 1) == (300 if taken else 0)
    module.wait(0.001)
    module.send(RPDO1, "2D 01 78 05")  # the next cycle is as any other
    module.send(SYNC)
    assert module.read(0x2000, 1) == 301


def test_beyond_19_heartbeat_consumer_values(module: Tester) -> None:
    module.accept("23 16 10 01 E8 03 05 00")
    module.refuse("23 16 10 02 D0 07 05 00", "06040043")
    module.accept("23 16 10 01 D0 07 05 00")
    assert module.read(0x1016, 1) == 0x000507D0
    for unused in ("00 00 05 00", "E8 03 00 00", "E8 03 80 00", "E8 03 FF 00"):
        module.accept(f"23 16 10 03 {unused}")
        assert module.emergencies(module.send(0x705, "05") + module.wait(1.5)) == []
        module.send(0x705, "05")


def test_beyond_20_commands_that_are_none(tester: Tester) -> None:
    for command in ("01", "02", "80", "81", "82"):
        assert tester.send(0x000, f"{command} {tester.id + 1:02X}") == []
        assert tester.send(0x000, command) == []
        assert tester.send(0x000, f"{command} {tester.nn} 00") == []
    for command in ("00", "03", "7F", "83", "FF"):
        assert tester.send(0x000, f"{command} {tester.nn}") == []
    assert tester.send(0x000, "") == []
    assert tester.remote(0x000) == []
    assert tester.state() == "7F"
    for command, state in STATES.items():  # to all nodes
        tester.send(0x000, f"{command} 00")
        assert tester.state() == state
    assert only(tester.send(0x000, "82 00") + tester.wait(1.0), 0x700 + tester.id) == ["00"]


@pytest.mark.parametrize("kind", ["00", "FE"])
def test_beyond_21_a_missed_sample_is_an_event_until_the_position_is_lost(module: Tester, kind: str) -> None:
    can_id = module.set_up_tpdo(0x1800, kind)
    bridged = module.read(0x2010, 3)
    module.operational()
    sent = []
    for cycle in range(17):
        heard = module.send(RPDO1, "2C 01 78 05") if cycle < 10 or cycle == 16 else []
        heard += module.wait(0.005) + module.send(SYNC) + module.wait(0.005)
        sent.append(len(only(heard, can_id)))
    lost = bridged + 1  # the last event: position lost
    assert sent == [1] * 10 + [1] * lost + [0] * (6 - lost) + [1]


def test_beyond_22_the_error_history_is_only_cleared(tester: Tester) -> None:
    entry = tester.eds[0x1003, 0]
    assert entry.high is None  # no limit that its own values may exceed
    for number in (1, 8, 0xFF):
        tester.refuse(f"2F 03 10 00 {number:02X}", "06090030")
    tester.accept("2F 03 10 00 00")
    assert tester.read(0x1003) == 0


def test_beyond_23_a_domain_has_no_pdo_mapping(tester: Tester) -> None:
    domains = [entry for entry in tester.eds.entries.values() if entry.data_type == DOMAIN]
    assert domains
    for entry in domains:
        assert "PDOMapping" not in tester.eds.options[entry.index, entry.sub], entry


def test_beyond_24_the_size_of_the_stored_eds(tester: Tester) -> None:
    file = eds_path(tester.eds.name).read_bytes()
    assert tester.ask("40 21 10 00") == f"41 21 10 00 {little(len(file), 4)}"
    assert tester.upload("21 10 00") == file
    assert tester.block_upload("21 10 00") == file
    if tester.kind == "module":
        assert f"({round(len(file) / 1000)} kB: use block transfer)" in page("canopen")
