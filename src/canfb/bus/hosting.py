"""From a configuration to modules that are served on a bus."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace

from canfb.bus.captured_source import CapturedSource
from canfb.errors import ConfigError
from canfb.module.config import ModuleConfig
from canfb.simulation.scenario import SimulationConfig
from canfb.sources.protocol import Converter, Source
from canfb.sources.surroundings import Capture, Surroundings


def open_source(
    config: ModuleConfig, simulation: SimulationConfig, resources: contextlib.ExitStack
) -> tuple[ModuleConfig, Source | None]:
    """The source, or None for the ADC PDO, and the configuration with the bits of its converter.

    What is open is closed with ``resources``. CanfbError, in one line, for a source that cannot be used.
    """
    settings = config.source
    if settings is None:
        return config, None

    def captured(opened: Callable[[], Capture], name: str, wait_s: float) -> Source:
        return resources.enter_context(CapturedSource(opened, name, wait_s))

    around = Surroundings(config.adc_bits, config.cycles_per_revolution, simulation, captured, resources)
    source = settings.open(around)
    if isinstance(source, Converter):
        try:
            config = replace(config, adc_bits=source.adc_bits)
        except ValueError as error:
            raise ConfigError(f"with {source.adc_bits} bits of {settings.title}: {error}") from None
    return config, source
