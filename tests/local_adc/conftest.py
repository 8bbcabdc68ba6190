"""An emulated ADC behind an IIOD server, for the real libiio."""

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from emulated_iiod import LIMIT_S, EmulatedAdc, EmulatedIiod, iio_source

from canfb.errors import BusError
from canfb.hosting.captured_source import CapturedSource
from canfb.sources.iio_source import IioSourceConfig
from processes import Process


@pytest.fixture(scope="session", autouse=True)
def libiio() -> None:
    """What is tested is there; on CI it has to be."""
    try:
        iio_source(IioSourceConfig(device="none", uri="xml:"))
    except BusError as error:
        if "needs" not in str(error):
            return
        if os.environ.get("CI"):
            pytest.fail(str(error))
        pytest.skip(str(error))


@pytest.fixture
def iiod() -> Iterator[Callable[..., EmulatedIiod]]:
    """Starts servers; all are stopped at the end."""
    with contextlib.ExitStack() as stack:
        yield lambda adc=None, port=0: stack.enter_context(EmulatedIiod(adc or EmulatedAdc(), port))


@pytest.fixture
def opened(iiod: Callable[..., EmulatedIiod]) -> Iterator[Callable[..., tuple[EmulatedIiod, CapturedSource]]]:
    """Opens sources, each on a server of its own; all are closed at the end."""
    with contextlib.ExitStack() as stack:

        def open_one(adc: EmulatedAdc | None = None, **keys: Any) -> tuple[EmulatedIiod, CapturedSource]:
            server = iiod(adc)
            config = IioSourceConfig(**{"device": "ads7950", "uri": server.uri} | keys)
            source = stack.enter_context(contextlib.closing(iio_source(config, reopen_s=0.05)))
            assert server.opened.wait(10.0)
            return server, source

        yield open_one


class Running:
    """`canfb run` as a process on a multicast bus."""

    def __init__(self, process: Process, bus: can.BusABC) -> None:
        self.process, self.bus = process, bus

    def heard(self, can_id: int) -> bytes:
        data = self.hear(can_id, LIMIT_S)
        assert data is not None, f"no {can_id:03X}h within {LIMIT_S:g} s"
        return data

    def hear(self, can_id: int, patience_s: float) -> bytes | None:
        """The next frame with this CAN-ID, if one comes."""
        end = time.monotonic() + patience_s
        while time.monotonic() < end and not self.process.has_ended():
            message = self.bus.recv(0.2)
            if message is not None and message.arbitration_id == can_id:
                return bytes(message.data)
        return None

    def send(self, can_id: int, data: bytes = b"") -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


@pytest.fixture
def command(started: Any, multicast_bus: can.BusABC, multicast_words: dict[str, Any], tmp_path: Path) -> Any:
    """Starts the command with these nodes of its configuration, and these options."""

    def start(nodes: str, *options: str) -> Running:
        config = tmp_path / "nodes.yaml"
        config.write_text(f"bus: {json.dumps(multicast_words)}\n{nodes}\n")
        python = (sys.executable, "-W", "error", "-m")
        return Running(started(*python, "canfb", "run", str(config), *options), multicast_bus)

    return start
