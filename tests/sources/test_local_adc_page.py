"""docs/local-adc.md and the example of the command: each kind of source is shown."""

from __future__ import annotations

import re
from pathlib import Path

from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.sources.iio_source import IioSourceConfig
from canfb.sources.protocol import source_kinds

PAGE = (Path(__file__).parents[2] / "docs" / "local-adc.md").read_text(encoding="utf-8")
PAGE = PAGE.partition("\n## An encoder interface")[0]
CONFIGURATIONS = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def test_it_shows_every_kind() -> None:
    kinds = {
        module.source.kind
        for text in CONFIGURATIONS
        for module in parse_config(text).modules
        if module.source is not None
    }
    assert kinds == set(source_kinds())


def test_the_example_of_the_command_shows_a_source() -> None:
    lines = [line.split("#")[1].strip() for line in EXAMPLE.splitlines() if "# source:" in line]
    (source,) = lines
    config = parse_config(f"modules:\n  - node_id: 32\n    {source}\n")
    assert isinstance(config.modules[0].source, IioSourceConfig)
