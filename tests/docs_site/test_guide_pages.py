"""The short guides: their figures are right. tests/calibrate runs their commands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from canfb import max_acceleration
from canfb.cia301.frame import frame_bits

DOCS = Path(__file__).parents[2] / "docs"


def text_of(name: str) -> str:
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def test_the_accelerations_are_those_of_the_formula() -> None:
    rows = re.findall(r"^(\d+) Hz: ([\d.]+) rad/s\^2$", text_of("plan"), re.MULTILINE)
    assert len(rows) == 4
    for rate, limit in rows:
        assert float(limit) == round(max_acceleration(2500, float(rate), 1 / 3), 1)


def test_the_bus_loads_are_those_of_the_longest_frames() -> None:
    bits = frame_bits(0) + 2 * frame_bits(8)
    rows = re.findall(r"^\| (\d+) ([kM])bit/s \| ([\d.]+) ms \| (\d+) Hz \|$", text_of("plan"), re.MULTILINE)
    assert (bits, len(rows)) == (325, 4)
    for number, prefix, time_ms, rate_hz in rows:
        bit_rate = int(number) * {"k": 1000, "M": 1_000_000}[prefix]
        assert float(time_ms) == pytest.approx(bits / bit_rate * 1e3, abs=0.006)
        assert int(rate_hz) == int(0.5 * bit_rate / bits)
