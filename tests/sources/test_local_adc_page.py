"""docs/local-adc.md: its configurations load, and its table of keys is that of the class."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from canfb.cli.config_file import EXAMPLE
from canfb.configuration import parse_config
from canfb.sources.iio_source import IioSourceConfig
from canfb.sources.registry import source_kinds

PAGE = (Path(__file__).parents[2] / "docs" / "local-adc.md").read_text(encoding="utf-8")
CONFIGURATIONS = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize("text", CONFIGURATIONS, ids=range(len(CONFIGURATIONS)))
def test_its_configurations_load(text: str) -> None:
    assert all(module.source is not None for module in parse_config(text).modules)


def test_it_shows_every_kind() -> None:
    kinds = {
        module.source.kind
        for text in CONFIGURATIONS
        for module in parse_config(text).modules
        if module.source is not None
    }
    assert kinds == set(source_kinds())


def test_its_table_has_all_keys_with_their_defaults() -> None:
    rows = re.findall(r"^\| (`.*?) \| (.*?) \|", PAGE.partition("## Keys")[2], re.MULTILINE)
    told: dict[str, str] = {}
    for keys, defaults in rows:
        names = re.findall(r"`(\w+)`", keys)
        values = re.findall(r"`([^`]+)`", defaults) or [defaults.strip()] * len(names)
        told |= dict(zip(names, values, strict=True))
    known = {
        field.name: field.default
        for field in dataclasses.fields(IioSourceConfig)
        if field.name != "kind" and field.metadata.get("key", True)
    }
    assert set(told) == set(known)
    for name, default in known.items():
        if default is True:
            assert told[name] == "true"
        elif default is not None and default is not dataclasses.MISSING:
            assert told[name] == str(default)


def test_the_example_of_the_command_shows_a_source() -> None:
    lines = [line.split("#")[1].strip() for line in EXAMPLE.splitlines() if "# source:" in line]
    (source,) = lines
    config = parse_config(f"modules:\n  - node_id: 32\n    {source}\n")
    assert isinstance(config.modules[0].source, IioSourceConfig)
