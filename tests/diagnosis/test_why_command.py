"""`canfb why`: what a module says of its last loss, what brings it back; and the file of --bundle."""

import json
import math
import re
import shlex
import stat
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import commissioning_kit
from canfb import BusError, Frame, objects as od
from canfb.cli.commands import build_parser
from canfb.diagnosis.lost import MOTION, Loss, LostPosition, read_lost_position
from canfb.hosting import self_diagnosis
from canfb.objects import LossCause, StatusBit
from canfb.rows import age_words
from canfb.simulation.embedded_bus import SyncProducer
from canfb.simulation.encoder import Motion
from canfb.view.module_view import limit_settings
from commands import Command, yaml_file
from commissioning_kit import CYCLES, INTERFACE_ID, MODULE_ID, RATE_HZ, Bench, lose, random_encoder, running
from documentation import ROOT, blocks, page
from folding import each
from node_commands import Commands, abort, between, place_of

NODE = hex(MODULE_ID)
PAGE = page("troubleshooting")
SIGNAL = "".join(one.read_text(encoding="utf-8") for one in (ROOT / "src/canfb/signal").rglob("*.py"))


def test_a_module_that_has_lost_nothing(canfb: Commands) -> None:
    out, _ = canfb(running(), "why", NODE)
    assert out == "module 32 (20h): position valid\nlast loss\n  none since the start\n"


def test_an_interface_that_was_silent(canfb: Commands) -> None:
    bench = lose(running())
    lines = canfb(bench, "why", NODE).lines
    assert lines[0].startswith("module 32 (20h): position lost")
    assert " s ago: more samples in a row were bad or missing than 2010:03 allows" in lines[2]
    assert lines[3] == "  4 samples in a row missed or bad (sample missed); 2010:03 bridges 3"
    assert lines[4] == "  residual then: nothing to compare; limit 0.333 cycle"
    assert " cycles per interval, " in lines[5]
    at = lines.index("what brings it back")
    assert lines[at + 1].startswith("  stand still, then canfb node reset 0x20:")
    assert [line.partition(":")[2][:11] for line in lines[at + 2 : at + 4]] == [" not mapped"] * 2
    kept = lines[lines.index("what would have kept it") + 1 :]
    assert kept[0] == "  2010:03 bridges 3 samples, 3 ms: a larger value bridges a longer fault"
    assert kept[1].startswith("  2010:02 is 0, not declared")
    figures = canfb(bench, "why", NODE, "--json").json
    assert figures["position"] == "lost"
    assert figures["last_loss"]["cause"] == "coasted"
    assert figures["last_loss"]["bad_samples"] == 4
    assert figures["last_loss"]["faults"] == ["sample missed"]
    assert figures["sample_hz"] == pytest.approx(RATE_HZ, rel=0.05)
    assert figures["counters"]["losses"] == 1
    assert figures["mapped"] == dict.fromkeys(figures["mapped"], False)
    assert len(figures["brings_back"]) == 4


def test_what_the_module_has_mapped_is_what_brings_it_back() -> None:
    bench = running()
    entry = bench.module.dictionary.entry
    entry(0x1401, 1).value = 0x280 + INTERFACE_ID
    for sub, place in enumerate((od.SAMPLE_COARSE_SINE, od.SAMPLE_COARSE_COSINE), 1):
        entry(0x1601, sub).value = place.mapped(16)
    entry(0x1601, 3).value = od.SAMPLE_FLAGS.mapped(8)
    entry(0x1601, 0).value = 3
    found = read_lost_position(bench.access)
    assert (found.coarse, found.zero_pulse, found.second, found.limits.timed) == (True, True, False, False)
    said = replace(found, status=StatusBit.LOST).brings_back()
    assert "not mapped" not in said[1] + said[2]
    assert "not in use" in said[3]


def test_a_module_without_samples_says_so_first(canfb: Commands) -> None:
    silent = running()
    silent.source.change = lambda counts: None
    for bench in (Bench(sync=False, operational=False), silent):
        out, _ = canfb(bench, "why", NODE)
        assert "no samples are processed now: is it OPERATIONAL (canfb node start 0x20)" in out


def test_a_signal_that_was_never_good_is_what_is_named_and_not_a_reset(canfb: Commands) -> None:
    bench = running(encoder=replace(random_encoder(1), amplitude_counts=200.0))
    out, _ = canfb(bench, "why", NODE)
    assert "position not valid, amplitude outside of its limits\n  a signal within 2001:03 to 2001:04" in out
    assert "node reset" not in out
    assert canfb(bench, "why", NODE, "--json").json["brings_back"] == []


@each("rate_hz", [2.0, 5.0, 11.0])
def test_a_slow_sync_is_seen(canfb: Commands, monkeypatch: pytest.MonkeyPatch, rate_hz: float) -> None:
    monkeypatch.setattr(commissioning_kit, "RATE_HZ", rate_hz)
    bench = running(rpm=0.0)
    bench.bus.run_until(5.0)
    figures = canfb(bench, "why", NODE, "--json").json
    assert figures["sample_hz"] == pytest.approx(rate_hz, abs=0.6)


def test_a_loss_while_it_reads_is_that_of_one_time(canfb: Commands) -> None:
    bench = running(rpm=137.0)
    for command in (b"\x80\x20", b"\x01\x20"):  # started again in motion: lost a few samples later
        bench.bus.send(Frame(0x000, command))
    out = canfb(bench, "why", NODE)[0]
    assert "the machine moved during a pause" in out
    assert "speed then: not known, standstill was assumed\n" in out


def test_a_module_of_before_keeps_no_cause(canfb: Commands) -> None:
    bench = lose(running())
    between(
        bench,
        lambda frame: (
            abort(frame, 0x06090011) if place_of(frame)[0] == 0x2012 and place_of(frame)[1] >= 0x10 else None
        ),
    )
    assert "not known: this module does not keep the cause; 1 loss so far" in canfb(bench, "why", NODE)[0]


def test_sdo_says_what_explains_a_lost_position(canfb: Commands) -> None:
    bench = lose(running())
    assert canfb(bench, "sdo", "read", NODE, "2011:01")[0].endswith(
        "\nthe position is lost: canfb why 0x20 says why, and what brings it back\n"
    )
    assert canfb(bench, "sdo", "read", NODE, "2012:10")[0] == (
        "2012:10 Counters: Last loss cause: 1 (more samples in a row were bad or missing than 2010:03 "
        "allows)\n"
    )
    assert canfb(bench, "sdo", "read", NODE, "2012:16")[0].endswith(": 64 (missed)\n")


USUAL = limit_settings(lambda place: None)
LOST = LostPosition(
    node_id=32, status=int(StatusBit.LOST), losses=1, missed=3, missed_syncs=0,
    loss=Loss(LossCause.AMBIGUOUS, 3.0, 3, 0.2, 0.333, 1.2, int(StatusBit.MISSED)),
    sample_hz=100.0,
    limits=replace(USUAL, coast_samples=8, widest_cycles=1 / 3, acceleration_rad_s2=0.25),
    coarse=False, zero_pulse=False, second=False,
)  # fmt: skip


def with_limits(**limits: Any) -> LostPosition:
    return replace(LOST, limits=replace(LOST.limits, **limits))


def test_the_longest_gap_is_that_of_the_page_on_missed_samples() -> None:
    """The table of docs/supervision.md, A = a: 1/6, 1/8 and 1/12 cycle per interval squared."""
    for missed, largest in ((1, 1 / 6), (2, 1 / 8), (3, 1 / 12)):
        rad_s2 = largest * 100.0**2 / 2500 * 6.283185307
        assert with_limits(acceleration_rad_s2=0.999 * rad_s2).longest_gap() == missed
        assert with_limits(acceleration_rad_s2=1.01 * rad_s2).longest_gap() == missed - 1
    assert with_limits(acceleration_rad_s2=0.0).longest_gap() is None


@each("back", [True, False])
def test_a_limit_that_was_too_narrow_is_named_also_after_it_was_set_back(canfb: Commands, back: bool) -> None:
    bench = running()
    out = canfb(bench, "sdo", "write", NODE, "residual limit", "0.0001 cycle")[0]
    assert out == (
        "2010:01 Supervision: Residual limit: 21845 (0.333328 cycle) -> 7 (0.000106812 cycle)\n"
        "this lost the position: canfb why 0x20 says what brings it back\n"
    )
    if back:
        canfb(bench, "sdo", "write", NODE, "residual limit", "21845", "--raw")
    out = canfb(bench, "why", NODE)[0]
    assert "; limit 0.000107 cycle\n" in out
    named = "the residual limit was 0.000107 cycle and is 0.333 cycle now: 2010:01 was written since"
    assert (named if back else "2010:01 is 0.000107 cycle, and the declared") in out


@each("needed", [0.25, 0.45])
def test_what_the_limits_need_is_that_of_a_slow_sync(canfb: Commands, needed: float) -> None:
    bench = Bench(motion=Motion(()), sync=False)
    bench.bus.attach(SyncProducer(0.2))
    bench.bus.run_until(2.0)
    bench.access.write(*od.SUPERVISION_ACCELERATION, "f", (needed - 0.05) * 2.0 * math.pi / CYCLES / 0.2**2)
    for _ in range(4):
        bench.bus.run_until(bench.bus.now + 0.06)
        out, _ = canfb(bench, "sdo", "write", NODE, "2010:0C", "0.0125 cycle")
        said = [float(one) for one in re.findall(r"\(2010:0C\) need (\S+):", out)]
        assert said == [pytest.approx(needed, rel=0.25)] * (needed > 1.0 / 3.0)


def test_2010_03_counts_intervals_of_sync() -> None:
    loss = Loss(LossCause.COASTED, 3.0, 3, 0.2, 0.333, 1.2, 0)
    several = replace(with_limits(samples_per_sync=3), loss=loss, sample_hz=300.0)
    assert several.would_have_kept()[0].startswith("2010:03 bridges 24 samples, 80 ms")
    assert several.happened()[1] == "3 samples in a row missed or bad; 2010:03 bridges 24"


def test_more_coasting_is_not_proposed_where_it_cannot_help() -> None:
    loss = replace(LOST.loss, cause=LossCause.COASTED)  # type: ignore[type-var]
    said = {20: "more would not help at this acceleration", 3: "a larger value", 255: "its largest value"}
    for many, words in said.items():
        assert words in replace(with_limits(coast_samples=many), loss=loss).would_have_kept()[0]


@each("cause", list(LossCause)[1:])
def test_each_cause_has_an_advice(cause: LossCause) -> None:
    lost = replace(LOST, loss=replace(LOST.loss, cause=cause))  # type: ignore[type-var]
    assert all(replace(lost, sample_hz=hz).would_have_kept() for hz in (0.0, 100.0))
    for bit in (0, StatusBit.TABLE_ACTIVE):  # a table is proposed where none is active
        said = "\n".join(replace(lost, status=lost.status | bit).would_have_kept())
        assert said.count("canfb calibrate --check") == (cause in MOTION and bit > 0)
        assert said.count("phase errors: canfb calibrate") == (cause in MOTION and bit == 0)
    assert cause.text in "\n".join(lost.lines())
    assert f"| {cause.value} | {cause.text}" in PAGE
    assert f"LossCause.{cause.name}" in SIGNAL, "one that nothing gives"


def test_ages() -> None:
    assert [age_words(one) for one in (0.8, 90.0, 600.0, 10800.0)] == ["0.8 s", "90.0 s", "10 min", "3.0 h"]


def test_the_page_shows_what_the_command_prints() -> None:
    (shown,) = blocks(PAGE, "text")
    loss = Loss(LossCause.COASTED, 12.4, 4, 0.5, 1 / 3, 1.2, int(StatusBit.MISSED))
    undeclared = with_limits(acceleration_rad_s2=0.0, coast_samples=3)
    lost = replace(undeclared, loss=loss, missed=4, missed_syncs=3)
    assert "\n".join(lost.lines()).startswith(shown.rstrip())


def test_the_commands_of_the_page_are_understood() -> None:
    commands = re.findall(r"^canfb (.*)$", PAGE, re.M) + re.findall(r"`canfb (sdo [^`]*)`", PAGE)
    assert len(commands) >= 3
    for command in commands:
        assert build_parser().parse_args(shlex.split(command)).command


BUNDLE_PAGE = page("monitor").partition("\n## One file")[2]
SECONDS = "--seconds=0.01"


@pytest.fixture
def canfb(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Commands:
    monkeypatch.chdir(tmp_path)
    return Commands(monkeypatch, capsys)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    modules = f"modules: [{{node_id: {MODULE_ID}, encoder_interface: {INTERFACE_ID}}}]\n"
    return yaml_file(tmp_path, "bus: {channel: x, password: apple}\n" + modules, "left.yaml")


def written(folder: Path) -> dict[str, Any]:
    (path,) = folder.glob("canfb-diagnose-*.json")
    text = path.read_text(encoding="utf-8")
    assert "apple" not in text
    found: dict[str, Any] = json.loads(text)
    return found


def test_all_objects_of_the_configured_nodes_are_in_the_file(
    canfb: Commands, config: Path, tmp_path: Path
) -> None:
    out = canfb(Bench(sync=False), "why", "--bundle", config, SECONDS)[0]
    found = written(tmp_path)
    assert list(found)[:4] == ["canfb_diagnosis", "made", "made_by", "versions"]
    assert set(re.findall(r"^\| `(\w+)` \|", BUNDLE_PAGE, re.M)) == set(list(found)[3:])
    interface, module = found["nodes"]
    assert (interface["node_id"], module["node_id"]) == (INTERFACE_ID, MODULE_ID)
    assert (interface["objects"]["1000:00"], module["objects"]["2010:01"]) == (0x00040191, 21845)
    assert module["objects"]["1008:00"] == "canfb drive feedback module"
    assert "2020:01" not in module["objects"], "no tables"
    assert "2020:03" not in module["objects"], "write only"
    assert found["configuration"]["bus"] == {"channel": "x", "password": "(left out)"}
    assert re.search(rf"^node {MODULE_ID} \(20h\): \d+ objects$", out, re.M)
    assert re.search(r"^written  canfb-diagnose-\d{8}-\d{6}\.json$", out, re.M)


def test_named_nodes_are_read_one_that_is_silent_is_told_and_frames_are_heard(
    canfb: Commands, tmp_path: Path
) -> None:
    def fail(frame: Frame) -> None:
        if place_of(frame) == (0x2012, 1):
            raise BusError("the bus fails")

    path, bench = tmp_path / "canfb-diagnose-of-a-machine.json", Bench()
    between(bench, fail)
    bus = "--seconds=0.2", "-i", "virtual", "-c", "x"
    out, err = canfb(bench, "why", "--bundle", 5, MODULE_ID, "--out", path, *bus, code=1)
    assert ".json is incomplete: node 5 (05h): " in err
    assert "node 5 (05h): 0 objects\n" in out
    found = written(tmp_path)
    silent, module = found["nodes"]
    assert (silent["node_id"], module["node_id"]) == (5, MODULE_ID)
    assert "no answer" in silent["error"]
    assert module["objects"]["2010:03"] == 3
    assert module["error"] == "the bus fails", "what was read before stays"
    assert found["bus"]["seconds"] == 0.2
    assert found["bus"]["frames"]["080"] > 10
    assert stat.S_ISREG(path.stat().st_mode)


def test_without_nodes_all_that_answer_are_read_and_a_refused_object_has_the_reason_in_its_place(
    canfb: Commands, tmp_path: Path
) -> None:
    bench = Bench(sync=False)

    def spoil(frame: Frame) -> list[Frame] | None:
        return abort(frame, 0x08000022) if place_of(frame) == (0x2010, 2) else None

    between(bench, spoil)
    canfb(bench, "why", "--bundle", SECONDS, "-i", "virtual", "-c", "x")
    found = written(tmp_path)
    assert {one["node"] for one in found["bus"]["found"]} >= {INTERFACE_ID, MODULE_ID}
    objects = {one["node_id"]: one["objects"] for one in found["nodes"]}
    assert INTERFACE_ID in objects
    assert objects[MODULE_ID]["2010:02"] == "refused: 08000022h"
    assert objects[MODULE_ID]["2010:03"] == 3


def test_a_bus_that_is_down_and_a_wrong_configuration_are_in_the_file(
    tmp_path: Path, command: Command
) -> None:
    path, wrong = tmp_path / "canfb-diagnose-1.json", yaml_file(tmp_path, "modules: [{node_id: 300}]\n")
    command("why --bundle -i udp_multicast -c 127.0.0.1 --out", path, wrong, code=1)
    assert command.said.err.count(" is incomplete: ") == 1
    found = written(tmp_path)
    assert "node_id must be a whole number 1..127, not 300" in found["configuration_error"]
    assert found["bus"]["error"].startswith("cannot open the bus udp_multicast 127.0.0.1: ")
    assert "nodes" not in found


def test_the_journal_is_that_of_the_services_of_the_configuration(
    canfb: Commands, config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = tmp_path / "journalctl"
    journal.write_text("#!/bin/sh\nprintf '%s \\377\\n' \"$*\"\n")
    journal.chmod(0o755)
    for folder, said in (
        (tmp_path, "-u canfb@left -u canfb-interface@left -n 500 .*--no-hostname --no-pager -q \ufffd"),
        (tmp_path / "empty", "journalctl is not installed"),
    ):
        monkeypatch.setenv("PATH", str(folder))
        canfb(
            Bench(sync=False), "why", "--bundle", config, SECONDS, "--out", tmp_path / "canfb-diagnose-1.json"
        )
        (line,) = written(tmp_path)["log"]
        assert re.fullmatch(said, line)


def test_the_commands_of_the_page_are_those_of_the_parser() -> None:
    assert f"last {self_diagnosis.MOST_LINES} lines" in BUNDLE_PAGE
    assert all(f"`{unit}@NAME`" in BUNDLE_PAGE for unit in self_diagnosis.UNITS)
