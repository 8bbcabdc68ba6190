"""docs/second-position.md: its configuration loads, its figures are those of the program."""

from __future__ import annotations

import re
from pathlib import Path

from canfb.configuration import parse_config
from canfb.eds_files import eds_path
from canfb.module.second_position_config import SecondPositionConfig
from canfb.objects import COUNTER_SECOND_DISAGREEMENTS, EncoderEmergency, StatusBit
from canfb.signal.recovery import second_opinion as rules
from canfb.signal.recovery.second_search import AGREEING_VALUES, STILL_PAIRS
from canfb.signal.recovery.second_values import ON_TIME_VALUES
from canfb.signal.second_position import MOST_TOLERANCE_REVOLUTIONS

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


def test_the_figures() -> None:
    assert rules.DISAGREEING_VALUES == 3
    assert "three values in a row" in PAGE
    assert AGREEING_VALUES == STILL_PAIRS == 8
    assert "eight values in a row" in PAGE
    assert "first standstill (eight samples)" in PAGE
    assert rules.START_SAMPLES == 4
    assert "the position waits four samples" in PAGE
    assert f"more than {rules.LONGEST_GAP} intervals without" in PAGE
    assert f"until {ON_TIME_VALUES} in a row" in PAGE
    assert (rules.HYSTERESIS, rules.PROVISIONAL) == (3 / 4, 2.0)
    assert "within 3/4 of the tolerance" in PAGE
    assert "provisional and twice the tolerance applies" in PAGE
    assert f"0 to {MOST_TOLERANCE_REVOLUTIONS} revolutions" in PAGE
    assert StatusBit.SECOND_POSITION == 1 << 13
    assert EncoderEmergency.SECOND_POSITION == 0xFF1C
    assert COUNTER_SECOND_DISAGREEMENTS == (0x2012, 0x0F)
    supervision = (DOCS / "supervision.md").read_text(encoding="utf-8")
    assert "| 13 | second position |" in supervision
    assert "| 0F | second position disagrees |" in supervision
