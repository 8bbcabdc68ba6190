"""docs/security.md: its configuration, its commands, and the limits that it names."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from canfb import objects as od
from canfb.bus import frame_sender, line_output, scope_server, state_files
from canfb.cli.parser import build_parser
from canfb.configuration import load_config
from canfb.device.sdo import transfer
from canfb.device.storage import writing
from canfb.module.module_config import WRITE_LOCKS
from canfb.objects import WriteLockMode
from canfb.scope import scope_page

PAGE = (Path(__file__).parents[2] / "docs" / "security.md").read_text(encoding="utf-8")


def test_the_configuration_loads(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
    path = tmp_path / "feedback.yaml"
    path.write_text("bus: {interface: virtual, channel: test}\n" + block)
    (module,) = load_config(path).modules
    assert module.write_lock == "preop"


def test_the_commands_are_commands() -> None:
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        assert words[0] == "canfb"
        build_parser().parse_args(words[1:])
    assert od.WRITE_LOCK_UNLOCK_CODE == (0x2040, 2)


def test_the_modes_are_those_of_the_code() -> None:
    said = dict(re.findall(r"(\d) `(\w+)`:", PAGE))
    assert {name: WriteLockMode(int(number)) for number, name in said.items()} == WRITE_LOCKS


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a table 65 536 bytes", transfer.LARGEST_DOWNLOAD == 65536),
        ("| 4; then 08000022h |", writing.MOST_WAITING == 4),
        ("| 256; then they", frame_sender.LONGEST_QUEUE == 256),
        ("| 1 MB; CRC-32", state_files.LARGEST_FILE == 1 << 20),
        ("| 1000 |", line_output.MOST_LINES == 1000),
        (
            "| 16 kB; 500 kB; 16 |",
            (scope_server.LARGEST_HEAD, scope_page.LARGEST_MESSAGE, scope_server.MOST_PAGES)
            == (1 << 14, 500_000, 16),
        ),
    ],
)
def test_the_limits(text: str, value: bool) -> None:
    assert text in PAGE
    assert value
