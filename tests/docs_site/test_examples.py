"""Every command on a page is one that the parser takes, every whole configuration is one that loads.

Tests of single pages run their examples; the reference pages, which have every option, key and object, are
made of the code (test_made_pages.py).
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from canfb.cli.aliases import current
from canfb.cli.commands import build_parser
from canfb.configuration import ANY_NODES, parse_config

ROOT = Path(__file__).parents[2]
PAGES = [*(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")), "README.md"]
ENDS = {">", ">>", "2>", "|", "&", "&&", ";"}
"""What a shell takes for itself, and not for an argument."""
FENCE = r"^```{}\n(.*?)^```"
parser = cache(build_parser)


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def commands_of(page: str) -> Iterator[list[str]]:
    """The arguments of each line of a shell that runs canfb."""
    text = text_of(page)
    blocks = [*re.findall(FENCE.format("sh"), text, re.M | re.S), *re.findall(r"(?:^    .*\n)+", text, re.M)]
    for line in "\n".join(blocks).replace("\\\n", " ").splitlines():
        found = re.match(r"\s*(?:sudo )?canfb (.*)", line)
        if found:
            words = shlex.split(found[1], comments=True)
            yield words[: min([words.index(one) for one in ENDS & {*words}], default=len(words))]


COMMANDS = [(page, words) for page in PAGES for words in commands_of(page)]
CONFIGURATIONS = [
    (page, block)
    for page in PAGES
    for block in re.findall(FENCE.format("yaml"), text_of(page), re.M | re.S)
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
