"""docs/second-position.md: its configuration loads, and it has every object and key."""

from __future__ import annotations

import re
from pathlib import Path

from canfb.configuration import parse_config
from canfb.eds_files import eds_path
from canfb.module.second_position_config import SecondPositionConfig

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "second-position.md").read_text(encoding="utf-8")


def test_the_configuration() -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
    (module,) = parse_config(text).modules
    assert module.second_position == SecondPositionConfig(
        cob_id=0x3B0, increments=65536, tolerance_revolutions=0.01
    )


def test_every_object_and_every_key_is_there() -> None:
    subs = re.findall(r"^\[2014sub([1-9A-F])\]", eds_path("canfb-module").read_text(encoding="ascii"), re.M)
    rows = re.findall(r"^\| ([0-9, ]+) \|", PAGE, re.M)
    assert [sub.strip() for row in rows for sub in row.split(",")] == [f"0{sub}" for sub in subs]
    assert [key for key in SecondPositionConfig.__dataclass_fields__ if f"`{key}`" not in PAGE] == []
