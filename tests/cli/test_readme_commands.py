"""What README, first hour and simulation page have to paste, without a vcan: Python, commands, recording."""

import struct
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from canfb import FeedbackModule, Frame, max_acceleration
from canfb.cli.commands import build_parser
from canfb.cli.config_file import EXAMPLE
from canfb.cli.simulate import chosen
from canfb.configuration import parse_config
from canfb.interface.encoder_interface import EncoderInterface
from canfb.signal.starts import START_SAMPLES
from canfb.signal.supervision import VALID
from canfb.simulation.embedded_bus import EmbeddedBus, SyncProducer
from canfb.simulation.encoder import MotionSource
from canfb.simulation.set_up import of_motion, source_of
from canfb.sources.recording_source import RecordingSource
from documentation import ROOT, blocks, commands, page
from judged_session import check, new_judge
from processes import Started, python

POSITION = 0x1A0


def ten_seconds(
    rate_hz: float, *options: str
) -> tuple[list[bool], list[float], FeedbackModule, MotionSource | RecordingSource]:
    """``canfb run`` and ``canfb simulate --rate`` on one bus, with the options of the latter.

    Whether each position PDO is valid, and its error against the motion, cycles; the module and the source.
    """
    config = parse_config(EXAMPLE)
    arguments = build_parser().parse_args(["simulate", "feedback.yaml", "--rate", str(rate_hz), *options])
    source: Any = source_of(*chosen(arguments, config))
    bus, module = EmbeddedBus(), FeedbackModule(config.modules[0])
    interface = EncoderInterface(module.config.encoder_interface, source, times=module.config.times)
    valid: list[bool] = []
    errors: list[float] = []

    def note(frame: Frame, now: float) -> None:
        if frame.can_id == POSITION and module.feedback is not None:
            valid.append(bool(int.from_bytes(frame.data[4:6], "little") & VALID))
            if isinstance(source, MotionSource):
                errors.append(module.feedback.cycles + module.feedback.phase - source.position_cycles)

    for device in (module, interface, SyncProducer(1.0 / rate_hz)):
        bus.attach(device)
    bus.observers.append(note)
    bus.send(Frame(0x000, b"\x01\x00"))
    bus.run_until(bus.now + 10.0)
    assert len(valid) >= 10.0 * rate_hz - 2
    return valid, errors, module, source


README = (ROOT / "README.md").read_text(encoding="utf-8")
SESSION = page("vcan").partition("## Node by node")[2].partition("\n## ")[0]
SIMULATION = page("simulation")
RECORDING = "docs/recording/tracks.csv"
LIMIT_S = 240.0  # for everything that has to happen in one test; it takes about 15 s


def python_blocks() -> list[str]:
    return blocks(README + page("first-hour"), "python")


def test_every_python_snippet_is_one_that_a_test_runs() -> None:
    assert [("canopen" in block, RECORDING in block) for block in python_blocks()] == [
        (False, True),
        (True, False),
    ]


def test_the_library_snippet_runs_as_pasted_from_the_repository() -> None:
    (snippet,) = [block for block in python_blocks() if RECORDING in block]
    done = python("-W", "error", "-c", snippet, cwd=ROOT)
    assert (done.returncode, done.stderr) == (0, "")
    verdict, *parts = done.stdout.splitlines()
    assert verdict.startswith("accepted"), verdict
    cycles, valid = np.array([line.split() for line in parts], float).T
    assert len(parts) == 100
    assert cycles[-1] == pytest.approx(25_417, abs=100), "61 rpm for ten of the 12 s"
    assert np.all(np.diff(cycles[10:]) > 0)
    assert np.all(valid == 1.0)


def test_the_recording_is_small_and_plays_for_ten_seconds_without_a_fault() -> None:
    assert (ROOT / RECORDING).stat().st_size < 300_000
    (words,) = [words for words in commands(SIMULATION) if words[0] == "simulate" and RECORDING in words]
    options = build_parser().parse_args(words)
    play = [str(ROOT / word) if word == RECORDING else word for word in words[2:]]
    assert all(ten_seconds(options.rate, *play)[0][START_SAMPLES:])


@pytest.fixture
def start(
    started: Any, multicast_words: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Started:
    """Starts a command on the bus of the test, in its folder."""
    monkeypatch.chdir(tmp_path)
    words = multicast_words
    further = ("--bus-kwargs", f"port={words['port']}", "hop_limit=0")
    bus = ("-i", words["interface"], "-c", words["channel"], *further)
    return lambda *arguments: started(sys.executable, "-m", "canfb", *arguments, *bus)


def test_the_first_session_holds_for_ten_seconds_with_real_processes(
    start: Callable[..., Any], multicast_bus: can.BusABC, multicast_words: dict[str, Any], tmp_path: Path
) -> None:
    """The lines of docs/vcan.md on a multicast bus; then its master in Python, on the same bus."""
    (tmp_path / "feedback.yaml").write_text(python("-m", "canfb", "config", "example").stdout)
    session = [words for words in commands(SESSION) if words[0] in ("run", "simulate", "node")]
    module, interface, nmt = session
    running, simulating = start(*module), start(*interface)
    running.wait_for("end with Ctrl-C")
    simulating.wait_for("end with Ctrl-C")
    simulating.wait_for("motion: 61 rpm: up to 25.5 cycles per sample")
    while multicast_bus.recv(0.0) is not None:
        pass  # SYNCs; a queue that is full of them would lose the first sample
    starting = start(*nmt[:3])
    judge, last, count = new_judge(), 0, 0
    deadline = time.monotonic() + LIMIT_S
    while count < 1000 and time.monotonic() < deadline:
        message = multicast_bus.recv(1.0)
        if message is None:
            continue
        judge.take(message.arbitration_id, bytes(message.data), message.timestamp)
        if message.arbitration_id == POSITION:
            last, count = struct.unpack_from("<I", message.data)[0], count + 1
    assert starting.wait() == 0
    running.find("$^", 0.0)  # all that it has said
    assert count == 1000, running
    check(judge, str(running))
    assert not judge.machine_held or last > 1.5 * 2500 * 8192, "more than a revolution"
    (snippet,) = [block for block in python_blocks() if "import canopen" in block]
    here = ", ".join(f"{key}={value!r}" for key, value in multicast_words.items())
    snippet = snippet.replace('interface="socketcan", channel="vcan0"', here)
    done = python("-c", snippet)
    assert (done.returncode, done.stderr) == (0, "")
    cycles, unit = done.stdout.split()
    assert unit == "cycles"
    assert not judge.machine_held or float(cycles) > 1.5 * 2500


def test_its_machine_keeps_to_the_acceleration_that_it_declares() -> None:
    config = parse_config(EXAMPLE)
    declared = config.modules[0].max_acceleration_rad_s2
    demand = of_motion(config.simulation.motion, config.modules[0], 100.0)
    assert 0.8 * declared < demand.acceleration_rad_s2 < 0.95 * declared
    assert f"{demand.acceleration_rad_s2:.2f} rad/s^2: less than max_acceleration_rad_s2" in EXAMPLE
    assert demand.warning() is None
    motion, step_s = config.simulation.motion.motion(), 0.01
    position = motion.revolutions_at(np.arange(10_000) * step_s)
    measured = 2.0 * np.pi * np.abs(np.diff(position, 2)).max() / step_s**2
    assert 0.8 * declared < measured < 0.95 * declared, "between any three samples"


def test_the_reason_beside_the_acceleration_is_right() -> None:
    """With an encoder as good as the module assumes one trajectory fits, by docs/supervision.md."""
    config = parse_config(EXAMPLE)
    module = config.modules[0]
    half_a_cycle = max_acceleration(module.cycles_per_revolution, 100.0, 0.5)
    declared = 0.5 * module.max_acceleration_rad_s2 / half_a_cycle
    assert declared == pytest.approx(0.01, abs=1e-4)
    gap, phase_error = 9, 0.0125
    assert (gap + 1) ** 2 // 4 * 2.0 * declared + 4.0 * phase_error * (gap + 1) <= 1.0
    assert (
        f"At 100 Hz it is 0.01 cycle per\n    # interval^2: after a gap of up to {gap} intervals" in EXAMPLE
    )


@pytest.mark.parametrize("rate_hz", [100.0, 250.0])
def test_every_position_of_ten_seconds_is_valid_and_right(rate_hz: float) -> None:
    valid, errors, module, source = ten_seconds(rate_hz)
    assert all(valid[START_SAMPLES:]), "the sample times confirm the start first"
    assert len(errors) == len(valid)
    assert np.abs(errors).max() < 0.05, "no cycle is lost; the rest is the error of the tracks"
    assert isinstance(source, MotionSource)
    assert source.position_cycles > 2500 * 1.5, "it has turned by more than a revolution"
    assert module.dictionary.entry(0x2012, 2).value == 0
