"""`canfb commission` as a whole on an in-process bus, and its commands in docs/plan.md."""

import json
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from canfb import BusError, Frame, objects as od
from canfb.calibration.path_fit import LowPass
from canfb.cli.commands import build_parser
from canfb.cli.commission import measured_nodes, named_config, run as commissioned, say_result, wishes_of
from canfb.cli.printing import Progress
from canfb.commission.limit_choice import corner_choice
from canfb.device.storage.storage import MemoryStore
from canfb.files import prepare_folder
from canfb.master.access import CommissioningError
from canfb.master.all_or_nothing import Guard, put_in_force
from canfb.master.session import AMPLITUDES, CORNER, SupervisionLimits, read_corners, write_limits
from canfb.simulation.encoder import AnalogPath, Encoder, Motion, Ramp
from commissioning_kit import Bench
from documentation import commands, page
from folding import each
from html_page import Page
from machine_kit import BEFORE, correction_of, duty
from node_commands import between

ENCODER = Encoder(amplitude_counts=1400.0, noise_lsb=0.6)
SHORT = ("--seconds", "2.1", "--watch", "0.3")


def bench_of(motion: Motion | None = None, table: bool = True, **options: Any) -> Bench:
    bench = Bench(ENCODER, motion=motion or duty(120, 0.3), **options)
    if table:
        put_in_force(bench.access, correction_of(ENCODER))
    bench.bus.run_until(0.1)
    bench.master.sent.clear()
    return bench


def run(bench: Bench, *words: str, guard: Guard | None = None) -> int:
    options = build_parser().parse_args([*words])
    options.line = "canfb commission"
    if options.out:
        prepare_folder(options.out, "commission")
    asked, shown = (
        (*measured_nodes(options, named_config(options)), wishes_of(options)),
        Progress(quiet=options.json),
    )
    return say_result(options, commissioned(bench.master, *asked, guard or Guard(), shown, "2026-03-01"))


def commission(bench: Bench, *arguments: str, guard: Guard | None = None) -> int:
    return run(bench, "commission", "0x20", *SHORT, *arguments, guard=guard)


def values(bench: Bench) -> dict[tuple[int, int], float]:
    return {(place[0], place[1]): bench.value(*place) for place in BEFORE}


def is_unwritten(bench: Bench) -> bool:
    return not any(frame.data[0] >> 5 in (1, 6) for frame in bench.master.sent if frame.can_id == 0x620)


def test_without_write_it_proposes_and_writes_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    bench = bench_of()
    before = values(bench)
    assert commission(bench, "--out", str(tmp_path)) == 0
    out = capsys.readouterr().out
    assert is_unwritten(bench)
    assert values(bench) == before
    assert {frame.can_id for frame in bench.master.sent if frame.can_id != 0x080} == {0x620, 0x610}
    assert "nothing was written to the module: use --write" in out
    for words in ("2010:01 residual limit", "2010:02 largest acceleration", "bad samples", "largest jerk"):
        assert words in out
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert page.tags.count("svg") == 4
    assert "Nothing was written to the module" in page.text
    assert not {"script", "link", "img"} & set(page.tags)
    assert (tmp_path / "samples.npz").exists()
    assert "nan" not in page.text.replace("canfb", "")


@pytest.mark.parametrize("config", [
    {"samples_per_sync": 3, "max_acceleration_rad_s2": 300.0},
    {"noise_margin": 8, "max_acceleration_rad_s2": 80.0},
], ids=lambda one: next(iter(one)))  # fmt: skip
def test_it_judges_by_the_limits_that_the_module_has_in_force(
    config: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """And not by those at each SYNC: L + a from sample to sample."""
    bench = bench_of(config=config)
    limits = bench.module.limits
    assert commission(bench, "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    motion = figures["deviation_cycles"] - figures["residual_limit_in_force_cycles"]
    near = 0.15 if "noise_margin" in config else 1e-4  # the module takes the largest noise of its last blocks
    assert figures["deviation_before_cycles"] - motion == pytest.approx(limits.residual_limit, rel=near)
    assert motion == pytest.approx(2.0 * figures["acceleration_cycles"], rel=0.3)
    assert limits.residual_limit < 0.3, "narrowed"
    assert figures["sample_rate_hz"] == pytest.approx(1000.0 * config.get("samples_per_sync", 1), rel=1e-3)
    assert figures["speed_most_rpm"] == pytest.approx(0.12 * figures["sample_rate_hz"], rel=0.02)


def test_no_phase_is_off_by_more_than_half_a_cycle(capsys: pytest.CaptureFixture[str]) -> None:
    assert commission(bench_of(), "--acceleration", "2000") == 0
    assert "if its phase is off by more than 0.5 cycle, 0.5 before" in capsys.readouterr().out


def test_it_writes_watches_and_saves(capsys: pytest.CaptureFixture[str]) -> None:
    store = MemoryStore()
    bench = bench_of(store=store)
    assert commission(bench, "--write", "--save", "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["written"]
    assert figures["saved"]
    proposed = {one["object"]: one["proposed"] for one in figures["limits"]}
    there = {f"{place[0]:04X}:{place[1]:02X}": value for place, value in values(bench).items()}
    assert there == proposed
    true = 120 / 60 * 2500 / 0.3 / 1e6  # cycles per interval squared
    assert figures["acceleration_cycles"] == pytest.approx(true, rel=0.05)
    assert 2.0 * true <= proposed["2010:01"] / 65536 < 2.6 * true
    assert figures["bad_samples_detected"] > figures["bad_samples_detected_before"]
    bench.bus.run_until(bench.bus.now + 1.0)
    assert bench.module.feedback is not None
    assert bench.module.feedback.valid
    assert bench.value(0x2012, 2) == bench.value(0x2012, 3) == 0
    again = Bench(ENCODER, store=store, sync=False)
    first = values(bench)
    assert values(again) == first, "after the power was off"
    assert commission(bench, "--write") == 0, "a second time gives much the same"
    said = capsys.readouterr()
    assert said.err.endswith("... the limits are in force\n"), "also where the page is interrupted"
    assert "the limits are in force, and nothing was flagged" in said.out
    for place, value in values(bench).items():
        # The repeats of a frozen input rise steeply where the noise is small.
        near = 0.4 if place == od.SUPERVISION_FROZEN else 0.15
        assert value == pytest.approx(first[place], rel=near)


def weaken(bench: Bench, guard: Guard) -> None:
    bench.source.change = lambda counts: (int(0.7 * counts[0]), int(0.7 * counts[1]))


def fail(bench: Bench, guard: Guard) -> None:
    """For half a second; a wait ends 50 ms later at once."""
    end_s = bench.bus.now + 0.5

    def failing(now: float) -> None:
        if now < end_s:
            bench.bus.run_until(now + 0.05)
            raise BusError("the bus fails: cable")

    bench.master.on_wait = failing
    failing(bench.bus.now)


def write_another(bench: Bench, guard: Guard) -> None:
    bench.module.receive(Frame(0x620, struct.pack("<BHBf", 0x23, 0x2010, 2, 7.0)), bench.bus.now)


IN_FORCE_AGAIN = r"; the limits from before are in force in module 32 \(20h\)"


@each("act, error, words", [
    (weaken, CommissioningError, f"flags samples with the new limits .* amplitude.*{IN_FORCE_AGAIN}"),
    (fail, CommissioningError, f"the bus fails: cable{IN_FORCE_AGAIN}"),
    (lambda bench, guard: guard.interrupt(), KeyboardInterrupt, None),
    (write_another, CommissioningError, f"2010:02 reads 7, not .* as written{IN_FORCE_AGAIN}"),
])  # fmt: skip
def test_what_happens_while_the_new_limits_are_watched_undoes_all(
    act: Callable[[Bench, Guard], None], error: type[BaseException], words: str | None
) -> None:
    bench, guard = bench_of(store=MemoryStore()), Guard()
    before, done = values(bench), list[float]()

    def look(now: float) -> None:
        if not done and bench.value(0x2010, 4):  # the last limit is in the module
            done.append(now)
            act(bench, guard)

    bench.master.on_wait = look
    with pytest.raises(error, match=words):
        commission(bench, "--write", "--save", guard=guard)
    assert values(bench) == before


def test_a_save_that_is_not_possible_is_said_before_anything_is_measured() -> None:
    bench = bench_of()
    with pytest.raises(CommissioningError, match="--save: module 32"):
        commission(bench, "--write", "--save")
    assert is_unwritten(bench)
    assert bench.bus.now < 1.0


# 0.45 cycle per interval squared, up to 10 cycles per interval.
FAR_TOO_FAST = Motion((Ramp(0.5, 0.0), *(Ramp(0.022, 240.0), Ramp(0.022, 0.0)) * 500))


def lose(bench: Bench) -> None:
    bench.module.chain.lose()
    bench.bus.run_until(bench.bus.now + 0.05)


def spoil_the_limit(bench: Bench) -> None:
    bench.module.dictionary.entry(*od.SUPERVISION_ACCELERATION).value = float("nan")


def spoil_the_speed(bench: Bench) -> None:
    answer = Frame(0x5A0, b"\x43\x11\x20\x07" + struct.pack("<f", float("nan")))
    between(bench, lambda frame: [answer] if frame.data[:4] == b"\x40\x11\x20\x07" else None)


def restart(bench: Bench) -> None:
    """Somewhen in the measurement; the machine stands, and the position is valid again at once."""
    boot_ups = [Frame(0x720, b"\0")]
    bench.master.on_wait = lambda now: bench.bus.send(boot_ups.pop()) if boot_ups and now > 1.0 else None


@each("options, spoil, words", [
    ({}, restart, r"module 32 \(20h\) was restarted meanwhile"),
    ({"table": False}, None, r"no correction table is active.*run canfb calibrate first"),
    ({"motion": Motion(())}, None, "the machine stands still: its acceleration cannot be measured"),
    ({"motion": FAR_TOO_FAST}, None, "the position is lost"),
    ({}, lose, r"the position is lost \(2011:01\).*: canfb why 0x20 says why, and what brings it back"),
    ({}, spoil_the_limit, "2010:02, largest acceleration, is nan"),
    ({}, spoil_the_speed, r"its speed \(2011:07\) is nan"),
    ({"operational": False}, None, r"no valid position \(2011:01 is .*NMT start"),
])  # fmt: skip
def test_what_cannot_be_commissioned_is_refused_in_one_line(
    options: dict[str, Any], spoil: Callable[[Bench], None] | None, words: str
) -> None:
    bench = bench_of(**options)
    if spoil is not None:
        spoil(bench)
    with pytest.raises(CommissioningError, match=words) as error:
        commission(bench, "--write")
    assert "\n" not in str(error.value)
    assert is_unwritten(bench)


def test_the_recording_of_the_module_serves_as_well(capsys: pytest.CaptureFixture[str]) -> None:
    bench = bench_of()
    assert commission(bench, "--source", "recording", "--json") == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["acceleration_cycles"] == pytest.approx(120 / 60 * 2500 / 0.3 / 1e6, rel=0.05)
    assert figures["jitter_s"] is None
    writes = {frame.data[1:4] for frame in bench.master.sent if frame.data[:1] in (b"\x2f", b"\x23", b"\x2b")}
    assert writes == {b"\x50\x20\x01"}, "start and stop of the recording, nothing else"


PAGE = page("plan").partition("\n## Measured on")[2]
CONFIG = "bus: {interface: virtual}\nmodules: [{node_id: 0x20, encoder_interface: 0x10}]\n"


def test_the_commands_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("feedback.yaml").write_text(CONFIG)
    bench = bench_of(store=MemoryStore())
    for words in commands(PAGE):
        assert run(bench, *words, *SHORT) == 0
    assert Path("limits/report.html").exists()
    assert "saved (1010:04)" in capsys.readouterr().out
    assert bench.value(*od.SUPERVISION_RESIDUAL_LIMIT) < 3000


CORNER_HZ = 125e3
LOW_PASS = AnalogPath(sine_corner_hz=CORNER_HZ, cosine_corner_hz=CORNER_HZ)


def test_the_corner_is_found_and_the_limits_become_narrow(capsys: pytest.CaptureFixture[str]) -> None:
    """Up to 3000 rpm and back, with the table of standstill."""
    made = Bench(replace(ENCODER, path=LOW_PASS), motion=duty(3000, 1.5))
    put_in_force(made.access, correction_of(ENCODER))
    made.bus.run_until(0.1)
    assert commission(made, "--seconds", "5", "--write", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["corner_hz"] == pytest.approx(CORNER_HZ, rel=0.01)
    assert found["delay_estimate_s"] == pytest.approx(1.0 / (2.0 * math.pi * CORNER_HZ), rel=0.01)
    assert 0.0 < found["delay_estimate_uncertainty_s"] < 5e-8
    corners = read_corners(made.access)
    assert corners.corner_hz == pytest.approx(CORNER_HZ, rel=0.01)
    assert corners.cosine_corner_hz == 0.0
    assert made.value(0x2002, 7) == 0.0, "nobody asked for it"
    proposed = {one["object"]: one["proposed"] for one in found["limits"]}
    assert proposed["2001:03"] == pytest.approx(0.8 * 1400.0, rel=0.01)
    assert proposed["2001:04"] == pytest.approx(1.2 * 1400.0, rel=0.01)
    made.bus.run_until(made.bus.now + 3.0)
    assert made.value(0x2012, 3) == 0, "no amplitude is flagged"
    assert commission(made, "--seconds", "5", "--json") == 0
    again = json.loads(capsys.readouterr().out)
    assert not next(one for one in again["limits"] if one["object"] == "2001:05")["changes"]
    assert again["corner_hz"] == pytest.approx(CORNER_HZ, rel=0.01), "without what is corrected"


def test_the_amplitude_is_within_its_limits_at_every_write() -> None:
    """On the way up the upper limit comes first, on the way back the lower one."""
    made = Bench(sync=False)
    low, high = AMPLITUDES
    before, after = {low: 500, high: 1300, CORNER.place: 0.0}, {low: 1100, high: 1700, CORNER.place: 125e3}
    write_limits(made.access, before)
    for wanted, order in ((after, [4, 5, 3]), (before, [3, 5, 4])):
        made.master.sent.clear()
        write_limits(made.access, wanted)
        written = [one.data[3] for one in made.master.sent if one.data[0] >> 5 == 1]
        assert written == order
        assert {place: made.value(*place) for place in wanted} == wanted


@each(
    "low_pass, before, words, changes",
    [
        (None, 0.0, None, False),
        (LowPass(0.0, 0.0, 1e5, 0.0, True, 1e6), 0.0, None, False),
        (LowPass(0.0, 0.0, 1e5, 0.0, True, 1e6), 125e3, "does not fall", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.02, True), 0.0, "by one pole", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.0, False), 0.0, "by one pole", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.0, True), 0.0, "125 ± 0.2 kHz", True),
        (LowPass(8e-6, 1e-8, 1e5, 0.0, True), 130e3, "125 ± 0.2 kHz", False),
        (LowPass(8e-6, 1e-8, 1e5, 0.0, True), 250e3, "125 ± 0.2 kHz", True),
    ],
)
def test_when_the_corner_is_proposed(
    low_pass: LowPass | None, before: float, words: str | None, changes: bool
) -> None:
    limits = SupervisionLimits({CORNER.place: before})
    found = corner_choice(low_pass, limits)
    assert (found is None) == (words is None)
    if found is not None and words is not None:
        assert words in found.why
        assert found.changes == changes
        assert found.value == (125e3 if changes else before)
