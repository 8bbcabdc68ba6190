"""docs/monitor.md: its page is that of the program, its commands are understood, its program runs."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest
from test_monitor_panels import printed

from canfb.cli.main import build_parser
from monitored_network import MonitoredNetwork

PAGE = (Path(__file__).parents[2] / "docs" / "monitor.md").read_text(encoding="utf-8")
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    for line in block.splitlines()
    if line.startswith("canfb monitor")
]


def without_figures(text: str) -> str:
    """Lines without what depends on the moment: figures, bars, dots."""
    return "\n".join(
        re.sub(r"[0-9.]+|[\u2581-\u2593\u2800-\u28ff]+|\s+", " ", line).strip() for line in text.splitlines()
    )


def test_the_page_is_that_of_the_program() -> None:
    network = MonitoredNetwork(jitter_us=20.0)
    network.run(2.0)
    network.source.lost = True
    network.run(0.0035)
    network.source.lost = False
    network.run(1.0)
    shown = re.findall(r"```text\n(.*?)```", PAGE, re.S)[0]
    real = "\n".join(printed(network.model.snapshot(network.bus.now), (80, 24)))
    assert re.sub(r" +", " ", without_figures(shown)) == re.sub(r" +", " ", without_figures(real))


@pytest.mark.parametrize("command", COMMANDS)
def test_the_commands_are_understood(command: str) -> None:
    words = shlex.split(command.partition(">")[0])
    options = build_parser().parse_args(words[1:])
    assert options.command == "monitor"


def test_every_option_is_there() -> None:
    with contextlib.redirect_stdout(io.StringIO()) as out, pytest.raises(SystemExit):
        build_parser().parse_args(["monitor", "--help"])
    own = out.getvalue().partition("\noptions:")[2].partition("bus arguments")[0]
    options = set(re.findall(r"--[a-z-]+", own))
    assert {option for option in options if option not in PAGE} <= {"--help", "--debug", "--channel"}


def test_the_program_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    exec(compile(program, "monitor.md", "exec"), {})
    assert capsys.readouterr().out == "OPERATIONAL valid 0.008636474609375\n"
