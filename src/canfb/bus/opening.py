"""Opening a bus with python-can, with one clear line when it does not work."""

from __future__ import annotations

from typing import Any

import can

from canfb.errors import BusError


def open_bus(options: dict[str, Any]) -> can.BusABC:
    """A python-can bus from its own words (interface, channel, bitrate, ...).

    What is not given comes from python-can's environment variables and configuration
    files. BusError when there is no such bus.
    """
    try:
        return can.Bus(**options)
    except (
        can.CanError,
        OSError,
        ValueError,
        TypeError,
        KeyError,
        ImportError,
        NotImplementedError,
    ) as error:
        raise BusError(f"cannot open the bus {describe(options)}: {_reason(error)}") from error


def describe(options: dict[str, Any]) -> str:
    """The bus in a few words, for messages."""
    words = [str(options[key]) for key in ("interface", "channel") if options.get(key) is not None]
    return " ".join(words) or "of python-can's configuration"


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    text = str(error).strip().splitlines()
    return text[0] if text else type(error).__name__
