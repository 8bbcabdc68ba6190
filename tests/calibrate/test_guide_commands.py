"""The guide pages: each `canfb` command runs, in the order of its page; those that do not are listed here."""

import contextlib
import itertools
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canfb.cia301.frame import Frame
from canfb.cli import node_command, node_options
from canfb.cli.aliases import current
from canfb.cli.commands import build_parser
from canfb.cli.config_file import EXAMPLE
from canfb.hosting import hosting, serving
from canfb.simulation.embedded_bus import EmbeddedBus
from commands import Command
from commissioning_kit import EmbeddedMaster
from documentation import blocks, page


def unplug(device: Any) -> None:
    """It is taken from the bus."""
    device.receive, device.deadline = lambda frame, now: [], lambda: None


class GuideNetwork:
    """The bus of a page, and its folder, which is the working directory."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, command: Command, resources: contextlib.ExitStack
    ) -> None:
        self.bus = EmbeddedBus()
        self.master = EmbeddedMaster(self.bus)
        self._attached: list[list[Any]] = []
        self.is_limited = False
        self._command = command
        network = self

        class Attaching:
            """In place of :class:`canfb.bus.runner.Runner`."""

            def __init__(self, bus: Any, devices: Any, **words: Any) -> None:
                self._devices = devices

            def hears(self, can_ids: Any, wait_s: float, asked: Any = ()) -> None:
                """No other node has the node-ID of a device."""

            def run(self, until: Any = None, ready: Any = None) -> None:
                network._attached.append(list(self._devices))
                for device in network._attached[-1]:
                    network.bus.attach(device)
                if ready is not None:
                    ready()
                network.wait(0.1)
                while network.is_limited and not until():
                    network.wait(1.0)

            def stop(self) -> None:
                """It has ended."""

        @contextlib.contextmanager
        def the_master(*words: Any) -> Iterator[EmbeddedMaster]:
            yield self.master

        def keep(entered: Any, *ending: Any) -> None:
            resources.push(entered._resources.pop_all())

        # A thread takes true time, and a master gives up in that of the bus.
        monkeypatch.setattr(hosting, "ThreadedStore", lambda files: files)
        monkeypatch.setattr(serving, "Runner", Attaching)
        monkeypatch.setattr(serving, "open_device_bus", lambda words: contextlib.nullcontext())
        monkeypatch.setattr(serving, "apply_realtime", lambda realtime: None)
        monkeypatch.setattr(serving.OnBus, "__exit__", keep)
        monkeypatch.setattr(node_command, "open_bus", lambda words: None)
        monkeypatch.setattr(node_command, "BusMaster", the_master)
        monkeypatch.setattr(node_options, "master_of", the_master)
        monkeypatch.setattr(node_options, "open_sync_bus", lambda *words, **more: None)
        monkeypatch.setattr(node_options, "BusMaster", the_master)

    def __call__(self, line: str) -> str:
        """Run a line, ``canfb ...``, perhaps with ``> FILE``, or ``cansend ...``; what it says."""
        fewer = ("--least-samples", "2000")  # a measurement of 20 s in place of 80
        command, _, file = line.removesuffix(" &").partition(" > ")
        name, *words = shlex.split(command, comments=not command.startswith("cansend"))
        if name == "cansend":
            return self._send(*words[1].split("#"))
        assert name == "canfb"
        self.is_limited = "--seconds" in words
        words += fewer if words[0] == "calibrate" and "--samples" not in words else ()
        said = self._command("", *words)
        if file:
            Path(file.strip()).write_text(said.out)
        return said.out + said.err

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.bus.run_until(self.bus.now + seconds)

    def end_of_the_last_command(self) -> None:
        """Ctrl-C: what it put on the bus is gone."""
        for device in self._attached[-1]:
            unplug(device)

    def end_of_all(self) -> None:
        """The bus is empty."""
        for device in itertools.chain(*self._attached):
            unplug(device)

    def _send(self, can_id: str, data: str) -> str:
        heard: list[str] = []
        self.bus.observers.append(
            lambda frame, now: heard.append(f"{frame.can_id:03X}#{frame.data.hex().upper()}")
        )
        remote = data == "R"
        self.bus.send(Frame(int(can_id, 16), b"" if remote else bytes.fromhex(data), remote))
        self.wait(1.0)
        self.bus.observers.pop()
        return "\n".join(heard)


FIRST_ENCODER = "first-hour#Your first encoder"
RATE = "plan#The SYNC rate"
DRIFT = "analog-front-end#Drift: does the correction table still fit?"
GUIDES = (
    *("first-hour", FIRST_ENCODER, "wiring", RATE),
    *("service#Real time", "homing", "calibration", DRIFT, "canopen", "simulation"),
)
# Parsed, not run.
PARSED_ONLY = {
    "canfb demo --out demo": "takes 9 s; tests/demo/test_demo.py runs it",
    "canfb calibrate -i socketcan -c can0 --method zero-crossings --seconds 4": (
        "needs an interface that records at 50 kHz; test_recordings_and_own_calibration.py has one"
    ),
    "canfb calibrate -i socketcan -c vcan0 --method zero-crossings --source recording --seconds 2": (
        "uploads 100 000 samples; test_recordings_and_own_calibration.py does so"
    ),
    "canfb try": "runs until Ctrl-C; tests/cli/test_try_command.py does so",
    "canfb node list": "on the bus that the line before it names",
}
# Not run at all, by the first word.
OF_OTHERS = {
    "needs CAN hardware or root": {"sudo", "ip", "candump", "dmesg"},
    "tells of this computer": {"uname"},
    "installs canfb": {"python3", "git", ".", "canfb-venv/bin/pip", "~/canfb-venv/bin/pip"},
    "is not a command": {
        *("dtparam=spi=on", "dtoverlay=mcp2515-can0,oscillator=16000000,interrupt=25", "SYNC", "export"),
        "dtoverlay=mcp251xfd,spi0-0,oscillator=40000000,interrupt=25",
    },
}
# What is there already when a page begins: a module, its interface and a SYNC, all started.
RUNNING = (
    "canfb config example > feedback.yaml",
    "canfb run feedback.yaml",
    "canfb simulate feedback.yaml --rate 100",
    "canfb node start all",
)
HARDWARE = ("canfb simulate machine.yaml --rate 100",)
BEFORE = {
    RATE: RUNNING[:2],
    "service#Real time": RUNNING,
    "homing": ("canfb run still.yaml", "canfb simulate still.yaml --rate 100 --rpm 0", RUNNING[-1]),
    "calibration": RUNNING[1:],
    "canopen": RUNNING,
    FIRST_ENCODER: HARDWARE,
}
# What a command says, where there is more to it than that it succeeds; by page and number of the command.
VALID = "2011:01 Feedback: Status word: 1 (valid)"
SAYS = {
    ("first-hour", 5): VALID,
    ("first-hour", 8): "Accepted. The error within a cycle falls from ",
    ("first-hour", 9): "(lost",
    (FIRST_ENCODER, 3): VALID,
    (FIRST_ENCODER, 4): "cycles",
    (FIRST_ENCODER, 5): "saved (1010:04)",
    (FIRST_ENCODER, 6): "axis-1.yaml",
    (RATE, 0): "the module follows 209 at 500 Hz (eq. 10)",
    ("service#Real time", 0): "2012:01 Counters: Missed samples: 0",
    ("calibration", 0): "is active and verified on fresh samples; saved (1010:04)",
    ("calibration", 1): "Accepted.",
    (DRIFT, 0): '"drift_seen": false',
    (DRIFT, 4): "5A0#43302008",
    ("canopen", 1): "720#7F",
}


def text_of(name: str) -> str:
    """A page, or a part of one: "service#Real time"."""
    name, _, part = name.partition("#")
    text = page(name)
    if not part:
        return text.partition("\n## Your first encoder\n")[0]
    return text.partition(f"\n## {part}\n")[2].partition("\n## ")[0]


def lines_of(name: str) -> list[str]:
    """The lines of the indented and the `sh` blocks of a page."""
    lines, fence = [], None
    for line in text_of(name).splitlines():
        if line.startswith("```"):
            fence = line[3:] if fence is None else None
        elif fence == "sh" or (fence is None and re.match(r" {4}( {4})?\S", line)):
            lines.append(re.sub(r"^\S*/bin/canfb ", "canfb ", line.strip()))
    return lines


def runs(line: str) -> bool:
    return line.split()[0] in ("canfb", "cansend") and line not in PARSED_ONLY


@pytest.fixture
def network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: Command) -> Iterator[GuideNetwork]:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(Path(__file__).parents[2] / "docs")
    with contextlib.ExitStack() as resources:
        yield GuideNetwork(monkeypatch, command, resources)


def play(network: GuideNetwork, *pages: str) -> None:
    for line in BEFORE.get(pages[0], ()):
        network(line)
    network.wait(5.0)  # standstill and ramp are over
    for name in pages:
        for number, line in enumerate(filter(runs, lines_of(name))):
            if (name, number) == ("first-hour", 9):
                network.end_of_the_last_command()
                network.wait(2.0)
            if "today.npz" in line:
                shutil.copy("measured/samples.npz", "today.npz")
            said = network(line)
            assert SAYS.get((name, number), "") in said, (name, number, line)
            network.wait(0.5)


@pytest.mark.parametrize("page", ["first-hour", "wiring", RATE, "service#Real time"])
def test_a_page_from_its_first_to_its_last_command(network: GuideNetwork, page: str) -> None:
    play(network, page)


def test_an_encoder_that_is_simulated_in_place_of_the_first_one(network: GuideNetwork) -> None:
    (block,) = blocks(text_of(FIRST_ENCODER), "yaml")
    Path("feedback.yaml").write_text(block)
    motion = "{standstill_s: 2, ramp_s: 3, rpm: 61, ripple_rpm: 0.5, ripple_hz: 0.3}"
    Path("machine.yaml").write_text(
        f"{block}simulation: {{encoder: {{sine_offset: 0.03}}, motion: {motion}}}\n"
    )
    play(network, FIRST_ENCODER)


def test_calibration_then_drift(network: GuideNetwork) -> None:
    Path("feedback.yaml").write_text(EXAMPLE.replace("# state_dir: /var/lib/canfb/x", "state_dir: state"))
    play(network, "calibration", DRIFT)


def test_homing_with_a_folder_for_what_is_saved(network: GuideNetwork) -> None:
    text = EXAMPLE.replace("# state_dir: /var/lib/canfb/x", "state_dir: state")
    Path("still.yaml").write_text(text.replace(", ripple_rpm: 0.3, ripple_hz: 0.1", ""))
    play(network, "homing")
    assert network("canfb sdo read 0x20 6004").startswith("6004:00 Position value: 81920 ")


def test_the_simulated_machines_of_the_page(network: GuideNetwork) -> None:
    text = page("simulation")
    slow, drive = re.findall(r"```yaml\n(modules:.*?|bus:.*?)```", text, re.DOTALL)[:2]
    Path("slow.yaml").write_text(slow.replace("modules:", "bus: {interface: virtual}\nmodules:"))
    Path("drive.yaml").write_text(drive)
    simulate, *_, example, record, played, measured, run, with_drive = filter(runs, lines_of("simulation"))
    network("canfb run slow.yaml")
    assert "motion: 13 rpm" in network(simulate)
    network("canfb node start 0x20")
    network.wait(0.5)
    assert VALID in network('canfb sdo read 0x20 "status word"')
    network.end_of_all()
    network(example)
    network(record)
    assert len(Path("tracks.csv").read_text().splitlines()) > 12_000
    network.end_of_all()
    network(played)
    network.end_of_all()
    assert "Accepted." in network(measured)
    network(run)
    assert "drive" in network(with_drive)
    network("canfb node start all")
    network.wait(0.5)
    assert VALID in network('canfb sdo read 0x20 "status word"')


def test_each_line_runs_is_parsed_or_is_of_another_program() -> None:
    others = set().union(*OF_OTHERS.values())
    seen = [line for page in GUIDES for line in lines_of(page)]
    assert [
        line for line in seen if not runs(line) and line not in PARSED_ONLY and line.split()[0] not in others
    ] == []
    assert set(PARSED_ONLY) <= set(seen)
    assert others <= {line.split()[0] for line in seen}
    for line in PARSED_ONLY:
        build_parser().parse_args(current(line.split()[1:])[0])
    assert sum(map(runs, seen)) > 30
