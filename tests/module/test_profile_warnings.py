"""Objects 6503h to 6506h and 2004h: alarms, warnings and their EMCY; what docs/encoder-profile.md has."""

import re
from typing import Any

import canopen
import pytest
from module_bench import Bench

from canfb import Frame, eds_path
from canfb.cia301.codes import EmergencyCode
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import MemoryStore
from canfb.module.cia406.alarms import CODES
from canfb.module.cia406.profile import ALARM_PARAMETERS, ALARM_POSITION
from documentation import blocks, page
from ideal_tracks import adc_pdo

FREQUENCY, AMPLITUDE, REFERENCE = 0xFF10, 0xFF11, 0xFF15
LOW, GOOD, BAD = 430.0, 1500.0, 10.0  # amplitudes; 400 is the lowest accepted one


def told(bench: Bench) -> list[tuple[int, int]]:
    """Code and error register of each EMCY."""
    return [alarm[:2] for alarm in bench.alarms()]


def test_low_amplitude_is_told_once_and_over_after_the_hold_time(bench: Bench) -> None:
    bench.at(0.0, LOW, samples=50)
    assert (bench.sdo[0x6505].raw, bench.sdo[0x6503].raw) == (2, 0)
    assert told(bench) == [(AMPLITUDE, 0x21)]
    assert bench.sdo[0x1001].raw == 0x21
    assert bench.sdo[0x1003][1].raw == 2 << 16 | AMPLITUDE
    bench.at(0.0, GOOD, samples=999)
    assert bench.sdo[0x6505].raw == 0
    assert told(bench) == [(AMPLITUDE, 0x21)]
    bench.at(0.0, LOW)  # once more, before it was over
    bench.at(0.0, GOOD, samples=1002)
    assert told(bench) == [(AMPLITUDE, 0x21), (0, 0)]
    assert bench.sdo[0x1001].raw == 0


def test_no_warning_without_a_valid_position(bench: Bench) -> None:
    for amplitude, samples, warning in ((LOW, 3, 2), (BAD, 2, 0), (LOW, 8, 2)):
        bench.at(0.0, amplitude, samples)
        assert bench.sdo[0x6505].raw == warning
    assert told(bench) == [(AMPLITUDE, 0x21), (0x7300, 0x21), (0, 0x21)]


def test_a_limit_that_a_known_acceleration_narrows(bench: Bench) -> None:
    bench.at(0.0, samples=10)
    bench.sdo[0x2010][2].raw = 100.0
    limit = bench.module.limits.residual_limit
    assert limit < 0.1
    bench.at(0.0)
    bench.at(0.95 * limit)
    assert (bench.sdo[0x6505].raw, told(bench)) == (1, [(FREQUENCY, 0x21)])


def flagged(bench: Bench, flags: int, position: float = 0.0) -> None:
    bench.sync()
    bench.sent(adc_pdo(position))
    bench.sent(Frame(0x290, bytes([flags])))


def test_no_zero_pulse_yet(bench: Bench) -> None:
    bench.at(0.0)
    assert bench.sdo[0x6505].raw == 0  # none is wired
    bench.map_rpdo2(0x20000608)  # the flags of a sample
    assert (bench.sdo[0x6505].raw, told(bench)) == (0x20, [])
    for _ in range(3):
        flagged(bench, 0)
    assert told(bench) == [(REFERENCE, 0x21)]
    bench.sdo[0x2001][1].raw = 10
    for n in range(55):
        flagged(bench, n == 5, 0.2 * n)
    assert told(bench) == [(REFERENCE, 0x21)], "a single one may be false"
    flagged(bench, 1, 11.0)
    flagged(bench, 0, 11.2)
    assert bench.sdo[0x6505].raw == 0
    assert told(bench) == [(REFERENCE, 0x21), (0, 0)]


@pytest.mark.parametrize("mask", [0, 1, 0x20])
def test_only_chosen_warnings_are_told(bench: Bench, mask: int) -> None:
    bench.sdo[0x2004][1].raw = mask
    bench.at(0.0, LOW, samples=3)
    assert (bench.sdo[0x6505].raw, told(bench)) == (2, [])
    bench.sdo[0x2004][1].raw = mask | 2
    bench.at(0.0, LOW)
    assert told(bench) == [(AMPLITUDE, 0x21)]
    bench.sdo[0x2004][1].raw = mask
    bench.at(0.0, LOW)
    assert told(bench) == [(AMPLITUDE, 0x21), (0, 0)]


PAGE = page("encoder-profile")
DICTIONARY = Dictionary.load(eds_path("canfb-module"), 32)


def section(title: str) -> str:
    found = PAGE.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
    assert found, title
    return found


def test_the_alarms_and_warnings_are_those_that_are_supported() -> None:
    told: dict[str, dict[int, int]] = {"6503": {}, "6505": {}}
    for index, bit, code in re.findall(
        r"^\| (650[35])h \| (\d+) \| [^|]* \| ([0-9A-F]{4})h", section("Alarms and warnings"), re.M
    ):
        told[index][1 << int(bit)] = int(code, 16)
    assert told["6505"] == {bit: int(code) for bit, code in CODES.items()}
    assert told["6503"] == {ALARM_POSITION: EmergencyCode.SENSOR, ALARM_PARAMETERS: EmergencyCode.DATA_SET}
    assert sum(told["6503"]) == DICTIONARY.entry(0x6504).default
    assert sum(told["6505"]) == DICTIONARY.entry(0x6506).default


@pytest.mark.parametrize("index", [0x6005, 0x6010, 0x6020, 0x6050, 0x650C])
def test_what_is_not_there(bench: Bench, index: int) -> None:
    assert f"{index:04X}h" in section("Objects")
    with pytest.raises(canopen.SdoAbortedError, match="06020000"):
        bench.remote.sdo.upload(index, 0)


def test_the_examples_run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(MemoryStore())
    bench.start()
    bench.at(0.25, samples=3)
    monkeypatch.setattr(bench.network, "connect", lambda **words: None, raising=False)
    monkeypatch.setattr(canopen, "Network", lambda: bench.network)
    names: dict[str, Any] = {}
    printed = []
    for example in blocks(PAGE, "python"):
        exec(example, names)
        printed.append(capsys.readouterr().out)
    offset = 1_800_000 - 3  # a quarter of a cycle is 3.6 units
    assert printed == ["", f"1800000 {offset}\n", "0\n", "0\n", "[]\n"]
    bench.network.send_message(0, b"\x81\x20")
    bench.network.send_message(0, b"\x01\x20")
    bench.at(0.25)
    sdo = names["module"].sdo
    assert (sdo[0x6509].raw, sdo[0x6004].raw, sdo[0x2004][1].raw) == (offset, 1_800_000, 0x3023)


def test_a_position_out_of_date_is_an_alarm_without_warnings_and_takes_no_preset(bench: Bench) -> None:
    bench.at(0.0, LOW)
    unreported = bench.module.receive(Frame(0x620, bytes.fromhex("2303600000000000")), bench.bus.now + 3.0)
    assert unreported[-1].data[0] == 0x80
    bench.bus.run_until(bench.bus.now + 3.0)  # SYNC stops before its period is known
    assert (bench.sdo[0x6503].raw, bench.sdo[0x6505].raw) == (ALARM_POSITION, 0)
    with pytest.raises(canopen.SdoAbortedError):
        bench.sdo[0x6003].raw = 77
    bench.remote.nmt.state = "RESET COMMUNICATION"
    assert (bench.sdo[0x6503].raw, bench.sdo[0x1001].raw) == (ALARM_POSITION, 0x21), "it is told again"


def test_a_stall_before_the_first_sample_counts_for_nothing(bench: Bench) -> None:
    for _ in range(20):
        bench.sync()
    bench.bus.run_until(bench.bus.now + 1.0)
    assert [bench.at(0.2)[1] & 1 for _ in range(20)] == [1] * 20


def test_a_preset_in_pre_operational(bench: Bench) -> None:
    bench.at(0.25, samples=3)
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.sdo[0x6003].raw = 77
    assert bench.sdo[0x6004].raw == 77
    bench.start()
    assert (bench.sdo[0x6503].raw, bench.at(0.25)[0]) == (ALARM_POSITION, 77), "no sample, then one"
