"""An emulated ADC behind an IIOD server, for the real libiio."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from emulated_iiod import EmulatedAdc, EmulatedIiod
from iio_kit import iio_source

from canfb.errors import BusError
from canfb.hosting.captured_source import CapturedSource
from canfb.sources.iio_source import IioSourceConfig


def _missing() -> str:
    """Why these tests cannot run here, if they cannot."""
    try:
        iio_source(IioSourceConfig(device="none", uri="xml:"))
    except BusError as error:
        return str(error) if "needs" in str(error) else ""
    return ""


@pytest.fixture(scope="session", autouse=True)
def libiio() -> None:
    """What is tested is there; on CI it has to be."""
    missing = _missing()
    if missing and os.environ.get("CI"):
        pytest.fail(missing)
    if missing:
        pytest.skip(missing)


@pytest.fixture
def iiod() -> Iterator[Callable[..., EmulatedIiod]]:
    """Starts servers; all are stopped at the end."""
    with contextlib.ExitStack() as stack:
        yield lambda adc=None, port=0: stack.enter_context(EmulatedIiod(adc or EmulatedAdc(), port))


@pytest.fixture
def opened() -> Iterator[Callable[..., CapturedSource]]:
    """Opens sources on a server; all are closed at the end."""
    with contextlib.ExitStack() as stack:

        def open_one(server: EmulatedIiod, **keys: Any) -> CapturedSource:
            config = IioSourceConfig(**{"device": "ads7950", "uri": server.uri} | keys)
            source = stack.enter_context(iio_source(config, reopen_s=0.05))
            assert server.opened.wait(10.0)
            return source

        yield open_one
