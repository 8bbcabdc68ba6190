"""Pages of the documentation, and the marked blocks in them that tests run."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[1]
SHELL = {">", ">>", "2>", "|", "&", "&&", ";"}
"""What a shell takes for itself, and not for an argument."""


def page(name: str) -> str:
    """``name`` is relative to docs/, without its suffix."""
    return (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def commands(text: str) -> list[list[str]]:
    """The arguments of each line of a shell that runs canfb."""
    lines = "\n".join(blocks(text, "sh") + re.findall(r"(?:^    .*\n)+", text, re.MULTILINE)).replace(
        "\\\n", " "
    )
    found = [
        shlex.split(one, comments=True)
        for one in re.findall(r"^\s*(?:sudo )?canfb (.*)", lines, re.MULTILINE)
    ]
    return [words[: min(map(words.index, SHELL & {*words}), default=len(words))] for words in found]
