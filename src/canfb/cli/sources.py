"""The source of a module that samples itself, opened as the configuration has it."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

from canfb.bus.iio_source import IioSource
from canfb.commissioning.sample_files import read_npz
from canfb.errors import ConfigError
from canfb.module.config import ModuleConfig
from canfb.simulation.scenario import SimulationConfig
from canfb.simulation.shaft_encoder import ShaftEncoder
from canfb.sources.motion_source import MotionSource
from canfb.sources.protocol import Source
from canfb.sources.recording_source import ArraySource, RecordingLayout, RecordingSource
from canfb.sources.source_config import IioSourceConfig, MotionSourceConfig, RecordingSourceConfig


def open_source(
    config: ModuleConfig, simulation: SimulationConfig, resources: contextlib.ExitStack
) -> tuple[ModuleConfig, Source | None]:
    """The source, or None for the ADC PDO, and the configuration with the bits of its converter.

    What is open is closed with ``resources``. CanfbError, in one line, for a source that cannot be used.
    """
    source = config.source
    match source:
        case None:
            return config, None
        case MotionSourceConfig():
            return config, _motion(config, source, simulation)
        case RecordingSourceConfig():
            return config, _recording(source)
        case IioSourceConfig():
            converter = resources.enter_context(IioSource(source))
            try:
                return replace(config, adc_bits=converter.adc_bits), converter
            except ValueError as error:
                raise ConfigError(f"with {converter.adc_bits} bits of {source.device!r}: {error}") from None


def _motion(config: ModuleConfig, source: MotionSourceConfig, simulation: SimulationConfig) -> MotionSource:
    return MotionSource(
        ShaftEncoder(
            simulation.encoder.encoder(config.adc_bits), config.cycles_per_revolution, simulation.seed
        ),
        simulation.motion.motion(),
        1.0 / source.rate_hz,
    )


def _recording(source: RecordingSourceConfig) -> Source:
    sine, cosine = (str(name) for name in source.columns)
    layout = RecordingLayout(
        (sine, cosine),
        source.mid_scale,
        None if source.time_column is None else str(source.time_column),
        source.gap_s,
        source.gap_samples,
        source.time_stamps,
    )
    return open_recording(source.file, layout)


def open_recording(file: str, layout: RecordingLayout) -> RecordingSource | ArraySource:
    """A recording: an NPZ file of ours by its name, which needs no layout, else CSV. CanfbError."""
    path = Path(file)
    if path.suffix == ".npz":
        samples = read_npz(path)
        return ArraySource(samples.sine, samples.cosine)
    return RecordingSource(path, layout)
