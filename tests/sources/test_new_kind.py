"""A new kind of source is one file: the registry finds it, the YAML has its keys, a module runs on it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import canfb.sources
from canfb.cia301.frame import Frame
from canfb.configuration import parse_config
from canfb.hosting.hosting import open_source
from canfb.module.feedback_module import FeedbackModule
from canfb.signal.supervision import VALID
from canfb.sources.protocol import source_kinds
from commands import Command

FILE = """
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from canfb.checks import number
from canfb.signal.sample import Sample
from canfb.sources.protocol import Source, SourceEnded
from canfb.sources.protocol import SourceConfig
from canfb.sources.protocol import Surroundings


@dataclass(frozen=True, kw_only=True)
class SteadySourceConfig(SourceConfig):
    kind: str = "steady"
    steps: Sequence[float] = field(metadata={"list": True})

    def __post_init__(self):
        super().__post_init__()
        for step in self.steps:
            number("steps", step)

    def open(self, surroundings: Surroundings) -> Source:
        source = SteadySource(self.steps)
        surroundings.resources.callback(source.close)
        return source


class SteadySource:
    adc_bits = 14

    def __init__(self, steps):
        self._steps = iter(steps)
        self._position = 0.0
        self.closed = False

    def close(self):
        self.closed = True

    def next(self):
        try:
            self._position += next(self._steps)
        except StopIteration:
            raise SourceEnded from None
        angle = 2 * math.pi * self._position
        return Sample(6000.0 * math.sin(angle), 6000.0 * math.cos(angle))
"""


@pytest.fixture(autouse=True)
def one_more_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The file, as if it were in the folder."""
    (tmp_path / "steady_source.py").write_text(FILE)
    monkeypatch.setattr(canfb.sources, "__path__", [*canfb.sources.__path__, str(tmp_path)])
    yield
    sys.modules.pop("canfb.sources.steady_source", None)


def configuration(source: str) -> str:
    return f"modules:\n  - node_id: 32\n    autostart: true\n    source:\n      kind: steady\n{source}"


def test_the_registry_finds_it_and_a_module_runs_on_it() -> None:
    assert list(source_kinds()) == ["iio", "motion", "recording", "steady"]
    config = parse_config(configuration("      steps: [0, 0.125, 0.25, 0.375, 0.375]\n"))
    with contextlib.ExitStack() as resources:
        (module_config,) = config.modules
        assert module_config.source is not None
        module_config, source = open_source(module_config, module_config.source, config, resources)
        assert module_config.adc_bits == 14, "those of its converter"
        module = FeedbackModule(module_config, source=source)
        told: list[str] = []
        module.on_source = told.append
        module.start(0.0)
        positions = []
        for n in range(7):
            module.receive(Frame(0x80, b""), n * 1e-3)
            if module.feedback is not None and module.feedback.status & VALID:
                positions.append(module.feedback.cycles + module.feedback.phase)
        assert not source.closed  # type: ignore[attr-defined]
    assert positions == pytest.approx([0.0, 0.125, 0.375, 0.75, 1.125], abs=2e-3)
    assert told == ["the source has ended: no more samples"]
    assert source.closed  # type: ignore[attr-defined]


def test_its_values_are_asked_by_the_check(tmp_path: Path, command: Command) -> None:
    path = tmp_path / "steady.yaml"
    path.write_text(configuration("      steps: [1, two]\n"))
    said = command("config check", path, code=2).err
    assert said == f"canfb: {path}:6: source: steps must be a number, not 'two'\n"
