"""Every command on a page is one that the parser takes, every whole configuration is one that loads.

Tests of single pages run their examples; the reference pages, which have every option, key and object, are
made of the code (test_made_pages.py).
"""

import asyncio
import re
import struct
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any

import can
import pytest

from canfb import FeedbackModule, ModuleConfig, StatusBit, max_acceleration
from canfb.cia301.frame import frame_bits
from canfb.cli.aliases import current
from canfb.cli.commands import build_parser
from canfb.configuration import ANY_NODES, parse_config
from documentation import ROOT, blocks, commands, page

PAGES = [*(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")), "README.md"]
parser = cache(build_parser)


TEXTS = {one: (ROOT / one).read_text(encoding="utf-8") for one in PAGES}
COMMANDS = [(one, words) for one, text in TEXTS.items() for words in commands(text)]
CONFIGURATIONS = [
    (one, block)
    for one, text in TEXTS.items()
    for block in blocks(text, "yaml")
    if re.search(r"^(modules|interfaces):", block, re.M)
]


def test_there_are_examples() -> None:
    assert len(COMMANDS) > 100
    assert len(CONFIGURATIONS) > 10


@pytest.mark.parametrize(
    ("page", "words"), COMMANDS, ids=lambda one: one if isinstance(one, str) else " ".join(one)
)
def test_a_command_is_understood(page: str, words: list[str]) -> None:
    parser().parse_args(current(words)[0])


@pytest.mark.parametrize(("page", "text"), CONFIGURATIONS, ids=[page for page, _ in CONFIGURATIONS])
def test_a_configuration_loads(page: str, text: str) -> None:
    parse_config(text, needs=ANY_NODES)


def test_the_accelerations_are_those_of_the_formula() -> None:
    rows = re.findall(r"^(\d+) Hz: ([\d.]+) rad/s\^2$", page("plan"), re.MULTILINE)
    assert len(rows) == 4
    for rate, limit in rows:
        assert float(limit) == round(max_acceleration(2500, float(rate), 1 / 3), 1)


def test_the_bus_loads_are_those_of_the_longest_frames() -> None:
    bits = frame_bits(0) + 2 * frame_bits(8)
    rows = re.findall(r"^\| (\d+) ([kM])bit/s \| ([\d.]+) ms \| (\d+) Hz \|$", page("plan"), re.MULTILINE)
    assert (bits, len(rows)) == (325, 4)
    for number, prefix, time_ms, rate_hz in rows:
        bit_rate = int(number) * {"k": 1000, "M": 1_000_000}[prefix]
        assert float(time_ms) == pytest.approx(bits / bit_rate * 1e3, abs=0.006)
        assert int(rate_hz) == int(0.5 * bit_rate / bits)


PATIENCE_S = 60.0


async def session(names: dict[str, Any]) -> tuple[int, bytes]:
    """SYNC and ADC PDO, each answered before the next: the valid positions, and the first frame."""
    module = FeedbackModule(ModuleConfig(node_id=0x20, encoder_interface=0x10))
    statuses: asyncio.Queue[int] = asyncio.Queue()
    module.on_feedback = lambda feedback, now: statuses.put_nowait(feedback.status & StatusBit.VALID)
    ended, valid = asyncio.Event(), 0
    with (
        can.Bus(interface="virtual", channel="program") as bus,
        can.Bus(interface="virtual", channel="program") as master,
    ):
        serving = asyncio.create_task(names["serve"](bus, module, ended))
        boot_up = await asyncio.to_thread(master.recv, PATIENCE_S)
        assert boot_up is not None
        cycle = [(0x080, b""), (0x190, struct.pack("<hh", 1500, 0))]
        for can_id, data in [(0x000, b"\x01\x20"), *5 * cycle]:
            master.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            if can_id == 0x190:
                valid += await asyncio.wait_for(statuses.get(), PATIENCE_S)
        ended.set()
        await asyncio.wait_for(serving, PATIENCE_S)
    return valid, bytes([boot_up.arbitration_id & 0xFF, *boot_up.data])


def test_the_asyncio_program() -> None:
    (block,) = blocks(page("service"), "python")
    names: dict[str, Any] = {"__name__": "program"}
    exec(block, names)
    assert asyncio.run(session(names)) == (5, b"\x20\x00")


MOST_WORDS = 2500
EVERY_PAGE = [
    *(ROOT / "docs").rglob("*.md"),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "CHANGELOG.md",
]
FENCED = re.compile(r"^(```|~~~).*?^\1[^\n]*$|`[^`\n]+`", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)[^)\s]*\)")


def test_every_page_is_in_the_order_once() -> None:
    index = ROOT / "docs" / "index.md"
    listed = re.findall(r"^/?\w[\w/-]*$", index.read_text(encoding="utf-8"), re.MULTILINE)
    pages = [ROOT / f"docs/{name}.md" if name[0] != "/" else ROOT / f"{name[1:]}.md" for name in listed]
    assert Counter(pages) == Counter(page for page in EVERY_PAGE if page != index)


@pytest.mark.parametrize("page", EVERY_PAGE, ids=lambda page: page.name)
def test_a_page_is_short_and_its_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(text.split()) <= MOST_WORDS or page.name == "CHANGELOG.md"
    targets = [one for one in LINK.findall(FENCED.sub("", text)) if not re.match(r"[a-z]+:", one)]
    assert not [one for one in targets if not (page.parent / one).is_file()]
