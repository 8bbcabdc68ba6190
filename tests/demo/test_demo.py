"""`canfb demo`: its story holds, its figures are those to expect, its pictures show it; a move of a servo."""

import json
import math
import os
import re
from dataclasses import replace
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest

from canfb import Frame, StatusBit
from canfb.demo import demo_page, story as story_module
from canfb.demo.demo_page import (
    account,
    figures as figures_of,
    position_error,
    residual,
    servo,
    servo_facts,
    tracks,
    write_files,
)
from canfb.demo.story import (
    ACCELERATION_RAD_S2,
    CYCLES_PER_REVOLUTION,
    FAULT_SAMPLES,
    FAULTS,
    JERK_RAD_S3,
    LOST_SAMPLE,
    MOST_RESIDUAL_CYCLES,
    RPM,
    SYNC_PERIOD_S,
    DemoNetwork,
    ServoRun,
    Story,
    run_story,
)
from canfb.signal.starts import MOST_WAITING
from canfb.simulation.encoder import Encoder, SCurve
from commands import Command
from folding import each
from html_page import Page
from processes import python
from servo_kit import s_curve

SHORT = 1500, 7000  # samples of track and reference; `make package` runs the demo as it is
PROGRAM = f"""\
from canfb.cli.main import main
from canfb.demo import demo_page, story
story.TRACK_SAMPLES, story.REFERENCE_SAMPLES = {SHORT}
raise SystemExit(main())
"""


class Told(NamedTuple):
    network: DemoNetwork
    story: Story


def told(network: DemoNetwork, samples: tuple[int, int] = SHORT) -> Told:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(story_module, "TRACK_SAMPLES", samples[0])
        patch.setattr(story_module, "REFERENCE_SAMPLES", samples[1])
        return Told(network, run_story(network))


def flagged(case: Told) -> set[int]:
    consumed, first = case.network.drive.consumed, case.story.fault_window[0] + 1  # numbers from there on
    seen = zip(consumed.sync_number, consumed.status, strict=True)
    return {number - first for number, status in seen if not status & StatusBit.VALID}


@pytest.fixture(scope="module")
def case() -> Told:
    return told(DemoNetwork())


def test_each_fault_is_ringed_and_named_once(case: Told) -> None:
    svg = tracks(*case).svg()
    assert svg.count("<circle ") == len(FAULTS) - 1
    for place, (name, _) in FAULTS.items():
        assert svg.count(f">{name}</text>") == (place != LOST_SAMPLE)


def test_the_names_of_the_faults_do_not_cross(case: Told) -> None:
    """Each is right of its line and below the one before; its line ends there."""
    svg = residual(case.story).svg()
    places = [re.search(rf'<text x="([\d.]+)" y="([\d.]+)"[^>]*>{name}<', svg) for name, _ in FAULTS.values()]
    found = [(float(place[1]), float(place[2])) for place in places if place]
    assert len(found) == len(FAULTS)
    assert found == sorted(found)
    assert all(below - above > 14.0 for (_, above), (_, below) in pairwise(found))


def test_no_error_is_beyond_the_picture(case: Told) -> None:
    story = case.story
    plot = position_error(story.phase_before, story.error_before, "before", "without a table")
    points = re.findall(r"M([\d.]+) ([\d.]+)h0", plot.drawing())
    assert len(points) == SHORT[0]
    top, bottom = plot.y(plot.y.high), plot.y(plot.y.low)
    assert all(top < float(y) < bottom for _, y in points)


def test_a_story_that_did_not_hold_is_shown_as_one(case: Told) -> None:
    story = replace(case.story, checks={"it flies": True, "it <floats>": False})
    page = Page(demo_page.demo_page(story, "canfb 1.2.3, 2026-11-22 <b>", (residual(story),) * 5))
    assert "canfb 1.2.3, 2026-11-22 <b>" in page.text
    assert "Failed: it <floats>." in page.text
    assert ("class", "verdict bad") in page.attributes


SPEED = RPM * 2.0 * math.pi / 60.0


@pytest.fixture
def runs(case: Told) -> list[ServoRun]:
    return case.story.servo


def test_four_samples_count_exactly_and_one_loses_the_move(runs: list[ServoRun]) -> None:
    four, two, one = runs
    assert four.exact
    assert 0.15 < four.largest_residual < MOST_RESIDUAL_CYCLES < four.limit_cycles
    for fewer in (two, one):
        assert not fewer.exact
    assert abs(one.cycles_off) > 1000


def test_every_sample_is_in_the_picture(runs: list[ServoRun]) -> None:
    four, _, one = runs
    assert len(four.residual) == 4 * (len(one.residual) - 1), "the first SYNC has no earlier one"
    assert (
        abs(np.diff(four.time_s) - 0.25e-3).max() < 0.3e-3
    )  # SYNC jitters by 0.1 ms, twice, and waits for a frame
    assert 0.0 < four.time_s[np.argmax(four.residual)] < 0.055, "it is within the move"
    drawn = servo(Story(servo=runs)).svg()
    assert four.name in drawn
    assert servo(Story()).svg()


def test_what_is_said(runs: list[ServoRun]) -> None:
    facts = servo_facts(Story(servo=runs))
    assert facts[0].words == ("0 to 3000 rpm in 50 ms: 7850 rad/s^2, 785000 rad/s^3",)
    assert facts[1].words[0].startswith("four samples for each SYNC: counted exactly, largest residual 0.")
    assert facts[3].words[0] == f"one sample for each SYNC: lost, {abs(runs[2].cycles_off)} cycles off"
    assert runs[0].figures()["counted_exactly"] is True


def test_a_run_that_was_wrong_once_is_not_exact(runs: list[ServoRun]) -> None:
    assert not replace(runs[0], wrong_and_valid=1).exact
    assert not replace(runs[0], cycles_off=-1).exact
    assert not replace(runs[0], valid=False).exact


def test_the_move_is_limited_in_jerk() -> None:
    times = np.linspace(-0.02, 0.08, 1001)
    move = SCurve(SPEED, ACCELERATION_RAD_S2, JERK_RAD_S3, 0.01)
    assert move.end_s == pytest.approx(0.06, abs=1e-4)
    expected = s_curve(SPEED, ACCELERATION_RAD_S2, JERK_RAD_S3, times - 0.01) / (2.0 * math.pi)
    np.testing.assert_allclose(move.revolutions_at(times), expected, atol=1e-12)
    np.testing.assert_allclose([move.revolutions(float(t)) for t in times], expected, atol=1e-12)


@each(
    "values, message",
    [
        ((0.0, 1.0, 1.0), "speed_rad_s must be a number"),
        ((1.0, math.inf, 1.0), "acceleration_rad_s2 must be a number"),
        ((1.0, 1.0, -1.0), "jerk_rad_s3 must be a number"),
        ((1.0, 100.0, 100.0), "speed_rad_s is too low to reach 100"),
    ],
)
def test_a_move_that_cannot_be(values: tuple[float, float, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SCurve(*values)


TRUSTED_AGAIN = 9  # samples
NOISY = Encoder(amplitude_counts=1500.0, noise_lsb=15.0)


def test_the_machine_turns_as_told(case: Told) -> None:
    story = case.story
    rpm = story.cycles_per_sample / CYCLES_PER_REVOLUTION / SYNC_PERIOD_S * 60
    assert 1940 < rpm < 2060, "2000 rpm, give or take 3 %"
    assert 83 <= story.cycles_per_sample < 84
    assert story.samples == pytest.approx(len(case.network.drive.consumed.status), abs=20)
    assert len(story.error_before) == len(story.error_after) == SHORT[0]


def test_the_error_with_the_table_is_the_noise_of_single_samples_and_not_less(case: Told) -> None:
    # What noise and rounding of a single sample make of the phase, rms.
    encoder = case.network.encoder
    amplitude = encoder.amplitude_counts * (encoder.sine_amplitude + encoder.cosine_amplitude) / 2
    noise = math.sqrt(encoder.noise_lsb**2 + 1 / 12) / amplitude / (2 * math.pi)
    after = case.story.error_after
    rms = math.sqrt(np.mean(after**2))
    assert 0.85 * noise < rms < 1.2 * noise
    assert 2.5 * rms < np.abs(after).max() < 6 * rms
    correlation = np.corrcoef(after[1:], after[:-1])[0, 1]
    assert abs(correlation) < 0.15, "noise, and nothing that the table left"


def test_counts_are_right_and_faults_are_flagged_at_once(case: Told) -> None:
    story = case.story
    assert story.flagged_at_once == len(FAULTS)
    assert (story.wrong_counts, story.wrong_and_valid, story.wrong_counts_after) == (0, 0, 0)
    # Each fault itself, and after it as many samples as it takes to trust the phase again: more than on a
    # bus without jitter, for a sample time of 100 ns is 0.008 of a cycle.
    assert len(FAULTS) < len(flagged(case) & {*range(FAULT_SAMPLES)}) <= TRUSTED_AGAIN * len(FAULTS)


def test_status_and_residual_tell_of_the_faults_and_of_nothing_else(case: Told) -> None:
    first, last = case.story.fault_window
    started = min(case.network.drive.consumed.sync_number) - 1 + MOST_WAITING - first
    told_wrong = {n for n in flagged(case) if n >= started}  # uneven times tell first whether it stood
    near = {place + n for place in FAULTS for n in range(TRUSTED_AGAIN)}
    assert told_wrong <= near, "no false alarm in the whole run"
    assert {place for place in FAULTS if place != LOST_SAMPLE} <= told_wrong
    quiet = [n for n in case.story.residual_number.tolist() if n not in near]
    residual = dict(zip(case.story.residual_number.tolist(), case.story.residual.tolist(), strict=True))
    assert 0.0005 < max(residual[n] for n in quiet) < 0.06
    assert max(residual.values()) == 0.5
    assert last - first == FAULT_SAMPLES


def test_the_account_for_people_has_the_figures(case: Told) -> None:
    text = account(case.story)
    lines = text.splitlines()
    assert all(len(line) <= 110 for line in lines)
    assert 20 <= len(lines) <= 40
    assert text.count("  held  ") == len(case.story.checks)
    assert "FAILED" not in text
    assert f"{case.story.samples}, wrong cycle counts 0" in text
    assert f"CRC-32 {case.story.table_crc32:08X}h" in text
    assert f"{100 * np.abs(case.story.error_before).max():8.4f}" in text
    assert "4 of 4 flagged at once" in text


def test_with_an_encoder_too_noisy_the_story_does_not_hold_and_says_so() -> None:
    story = told(DemoNetwork(NOISY, 4), (500, 3000)).story
    assert not story.held
    failed = {name for name, held in story.checks.items() if not held}
    assert failed == {"error at least 50 times smaller", "error below 0.05 % of a cycle"}
    assert account(story).count("  FAILED  ") == 2
    assert figures_of(story)["held"] is False


def test_with_a_module_that_calls_everything_valid_the_story_does_not_hold() -> None:
    network = DemoNetwork(Encoder(amplitude_counts=1900.0, noise_lsb=0.3), 5)
    receive = network.drive.receive

    def gullible(frame: Frame, now: float) -> list[Frame]:
        answer = receive(frame, now)
        network.drive.consumed.status[-1:] = [status | 1 for status in network.drive.consumed.status[-1:]]
        return answer

    network.drive.receive = gullible  # type: ignore[method-assign]
    network, story = case = told(network, (500, 3000))
    assert not story.held
    assert story.flagged_at_once == len(flagged(case) & {*range(FAULT_SAMPLES)}) == 0
    assert not story.checks["every fault flagged in the same sample"]


def test_an_untold_story_does_not_hold() -> None:
    assert not Story().held
    with pytest.raises(ValueError, match="has not run"):
        account(Story())


PICTURES = ["tracks.svg", "error-over-phase.svg", "residual-over-time.svg", "servo-move.svg"]
EPOCH = "1700000000"


class Run(NamedTuple):
    code: int
    figures: dict[str, Any]
    errors: str
    folder: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """One run in a process of its own, with pictures into a folder that is not there yet."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "pictures"
    dated = {**os.environ, "SOURCE_DATE_EPOCH": EPOCH}
    done = python("-c", PROGRAM, "demo", "--json", "--out", str(folder), env=dated)
    return Run(done.returncode, json.loads(done.stdout), done.stderr, folder)


def test_all_checks_held(run: Run) -> None:
    assert (run.code, run.errors) == (0, "")
    figures = run.figures
    assert figures["held"] is True
    assert len(figures["checks"]) == 13
    assert set(figures["checks"].values()) == {True}
    assert figures["wrong_cycle_counts"] == 0
    assert figures["faults_flagged_in_the_same_sample"] == figures["faults_provoked"] == 4
    assert figures["error_peak_before_cycles"] > 50 * figures["error_peak_after_cycles"] > 0
    assert all(math.isfinite(value) for value in figures.values() if isinstance(value, float))


def test_it_tells_the_same_each_time(run: Run, case: Told, tmp_path: Path) -> None:
    """The figures, and the files byte for byte."""
    places = ("figures", "report")
    assert figures_of(case.story) == {key: value for key, value in run.figures.items() if key not in places}
    date = "2023-11-14 22:13:20+00:00"
    write_files(*case, tmp_path, version("canfb"), date)
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (run.folder / path.name).read_bytes(), path.name
    assert f"canfb {version('canfb')}, {date}" in (tmp_path / "report.html").read_text("utf-8")


def test_four_pictures_and_a_page_are_written(run: Run) -> None:
    assert run.figures["figures"] == [str(run.folder / name) for name in PICTURES]
    assert run.figures["report"] == str(run.folder / "report.html")
    assert sorted(path.name for path in run.folder.iterdir()) == sorted([*PICTURES, "report.html"])
    for name in PICTURES:
        picture = ElementTree.fromstring((run.folder / name).read_bytes())
        assert picture.tag == "{http://www.w3.org/2000/svg}svg"
        drawn = sum(len(one.get("d", "")) for one in picture.iter("{http://www.w3.org/2000/svg}path"))
        assert 2000 < drawn < 200_000
        assert "nan" not in {one.get("d") for one in picture.iter()}


def test_the_page_stands_alone_and_has_the_figures(run: Run) -> None:
    text = (run.folder / "report.html").read_text(encoding="utf-8")
    assert len(text) < 300_000
    page = Page(text)
    assert not {"script", "link", "img", "iframe", "object", "embed", "base"} & set(page.tags)
    assert not {"src", "href", "data"} & {name for name, _ in page.attributes}
    assert page.tags.count("svg") == page.tags.count("figure") == 5
    assert ("class", "verdict bad") not in page.attributes
    for words in ("All checks passed.", *run.figures["checks"]):
        assert words in page.text
    assert f"{run.figures['samples']} samples" in page.text
    assert f"CRC-32 {run.figures['table_crc32']}h" in page.text
    assert f"{100 * run.figures['error_rms_after_cycles']:.4f}" in page.text


def test_a_wrong_date_and_a_wrong_folder_are_found_before_the_work(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("canfb.demo.story.DemoNetwork", None)
    file = tmp_path / "a file"
    file.write_text("")
    for path, why in ((file, "File exists"), (file / "below", "Not a directory")):
        assert command("demo --out", path, code=1).err == f"canfb: {path}: cannot be written: {why}\n"
    for wrong in ("today", "", "9" * 30):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", wrong)
        assert "seconds since 1970 are required" in command("demo --out", tmp_path, code=2).err


def test_a_story_that_does_not_hold_is_exit_code_1(
    case: Told, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    told = replace(case.story, checks={"it flies": False, "it floats": True})
    monkeypatch.setattr("canfb.demo.story.run_story", lambda network, progress: told)
    said = command("demo --json", code=1).json
    assert (said["held"], said["checks"], said["figures"]) == (False, told.checks, [])
