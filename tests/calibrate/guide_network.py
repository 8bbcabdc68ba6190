"""Commands of a page, one after the other, on a bus in simulated time in place of that of their options.

`canfb run` and `canfb simulate` put their devices on it and end at once, or after `--seconds`; the devices
stay. The commands that speak to a node find them there. Nothing else of a command is replaced, but that
measurements are shorter.
"""

from __future__ import annotations

import contextlib
import itertools
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from canfb.cia301.frame import Frame
from canfb.cli import calibrate, node_command, node_options
from canfb.cli.main import main
from canfb.hosting import hosting, serving
from canfb.simulation.embedded_bus import EmbeddedBus
from commissioning_kit import EmbeddedMaster

FEWER = ("--least-samples", "2000")  # a measurement of 20 s in place of 80


class Unplugged:
    """A device that can be taken from the bus."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.plugged = True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def start(self, now: float) -> list[Frame]:
        return list(self._device.start(now))

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        return list(self._device.receive(frame, now)) if self.plugged else []

    def deadline(self) -> float | None:
        found: float | None = self._device.deadline()
        return found if self.plugged else None

    def tick(self, now: float) -> list[Frame]:
        return list(self._device.tick(now)) if self.plugged else []


class GuideNetwork:
    """The bus of a page, and its folder, which is the working directory."""

    def __init__(
        self,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        resources: contextlib.ExitStack,
    ) -> None:
        self.bus = EmbeddedBus()
        self.master = EmbeddedMaster(self.bus)
        self._attached: list[list[Unplugged]] = []
        self.is_limited = False
        self._capsys = capsys
        network = self

        class Attaching:
            """In place of :class:`canfb.bus.runner.Runner`."""

            def __init__(self, bus: Any, devices: Any, **words: Any) -> None:
                self._devices = devices

            def hears(self, can_ids: Any, wait_s: float, asked: Any = ()) -> None:
                """No other node has the node-ID of a device."""

            def run(self, until: Any = None, ready: Any = None) -> None:
                network._attached.append([Unplugged(device) for device in self._devices])
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
        monkeypatch.setattr(hosting, "ThreadedStore", contextlib.nullcontext)
        monkeypatch.setattr(serving, "Runner", Attaching)
        monkeypatch.setattr(serving, "open_device_bus", lambda words: contextlib.nullcontext())
        monkeypatch.setattr(serving, "apply_realtime", lambda realtime: None)
        monkeypatch.setattr(serving.OnBus, "__exit__", keep)
        monkeypatch.setattr(node_command, "open_bus", lambda words: None)
        monkeypatch.setattr(node_command, "BusMaster", the_master)
        monkeypatch.setattr(node_options, "master_of", the_master)
        monkeypatch.setattr(calibrate, "sync_master", the_master)

    def __call__(self, line: str) -> str:
        """Run a line, ``canfb ...``, perhaps with ``> FILE``, or ``cansend ...``; what it says."""
        command, _, file = line.removesuffix(" &").partition(" > ")
        name, *words = shlex.split(command, comments=not command.startswith("cansend"))
        if name == "cansend":
            return self._send(*words[1].split("#"))
        assert name == "canfb"
        self.is_limited = "--seconds" in words
        words += FEWER if words[0] == "calibrate" and "--samples" not in words else ()
        self._capsys.readouterr()
        assert main(words) == 0, (line, self._capsys.readouterr())
        said = self._capsys.readouterr()
        if file:
            Path(file.strip()).write_text(said.out)
        return said.out + said.err

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.bus.run_until(self.bus.now + seconds)

    def end_of_the_last_command(self) -> None:
        """Ctrl-C: what it put on the bus is gone."""
        for device in self._attached[-1]:
            device.plugged = False

    def end_of_all(self) -> None:
        """The bus is empty."""
        for device in itertools.chain(*self._attached):
            device.plugged = False

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
