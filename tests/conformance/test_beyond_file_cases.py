"""Beyond 21 to 24: events of type 0, 1003h:00, and what foreign masters ask of the EDS."""

from __future__ import annotations

import pytest
from conformance_eds import DOMAIN
from conformance_kit import RPDO1, SYNC, Tester, little, only

from canfb.eds_files import eds_path
from documentation import page


@pytest.mark.parametrize("kind", ["00", "FE"])
def test_beyond_21_a_missed_sample_is_an_event_until_the_position_is_lost(module: Tester, kind: str) -> None:
    can_id = module.set_up_tpdo(1, kind)
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
