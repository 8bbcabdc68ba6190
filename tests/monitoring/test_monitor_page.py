"""docs/monitor.md: its page is that of the program, its program runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from test_monitor_panels import printed

from monitored_network import MonitoredNetwork

PAGE = (Path(__file__).parents[2] / "docs" / "monitor.md").read_text(encoding="utf-8")


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


def test_the_program_runs(capsys: pytest.CaptureFixture[str]) -> None:
    program = re.findall(r"```python\n(.*?)```", PAGE, re.S)[0]
    exec(compile(program, "monitor.md", "exec"), {})
    assert capsys.readouterr().out == "OPERATIONAL valid 0.008636474609375\n"
