"""What ``canfb config check`` holds against this machine: python-can, paths, processors."""

from __future__ import annotations

import os
from pathlib import Path

from canfb.bus.bus_words import check_words
from canfb.bus.opening import check_device_bus
from canfb.configuration import Config, NodeConfig, line_of
from canfb.errors import ConfigError


def check_machine(path: Path, config: Config) -> None:
    """ConfigError, in one line with file, line and key, for what cannot be on this machine."""
    try:
        keys: tuple[str | int, ...] = ("bus",)
        check_words(config.bus)
        check_device_bus(config.bus)
        for key, n, node in config.nodes:
            keys = (key, n, "state_dir")
            _check_state_dir(node)
            keys = (key, n, "source")
            if node.source is not None:
                node.source.check_machine()
        keys = ("realtime", "cpu")
        _check_cpu(config.realtime.cpu)
    except ConfigError as error:
        raise ConfigError(f"{path}:{line_of(path, *keys, said=str(error))}: {error}") from None


def _check_state_dir(node: NodeConfig) -> None:
    if node.state_dir is None:
        return
    folder = Path(node.state_dir)
    there = next((part for part in (folder, *folder.absolute().parents) if part.exists()), Path("/"))
    if not there.is_dir():
        raise ConfigError(f"state_dir {folder} cannot be used: {there} is not a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise ConfigError(f"state_dir {folder} cannot be used: {there} is not writable")


def _check_cpu(cpu: int | None) -> None:
    # Not sched_getaffinity: a process may leave the processors that it was started on.
    count = os.cpu_count()
    if cpu is not None and count is not None and cpu >= count:
        raise ConfigError(f"cpu {cpu} in realtime: this machine has {count}, 0 to {count - 1}")
