"""`canfb config`: the example is itself valid, and what is wrong is told."""

from __future__ import annotations

from pathlib import Path

import pytest

import canfb
from canfb.cli.main import main


@pytest.fixture
def example(capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["config", "example"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    return said.out


def test_the_example_is_itself_valid(
    example: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "example.yaml"
    path.write_text(example)
    assert main(["config", "check", str(path)]) == 0
    said = capsys.readouterr()
    assert said.out == f"{path}: valid; modules: 20h\n"
    assert said.err == ""
    config = canfb.load_config(path)
    assert config.bus["interface"] == "socketcan"
    assert config.modules == [
        canfb.ModuleConfig(
            node_id=0x20,
            times=True,
            residual_limit=0.3333,
            max_acceleration_rad_s2=0.25,
            coast_samples=30,
            sync_timeout_periods=20,
        )
    ]
    assert config.simulation.motion.rpm == 61


def test_what_the_example_has_in_comments_is_valid_too(example: str, tmp_path: Path) -> None:
    """The keys that are shown but left out: without their marks they must load."""
    path = tmp_path / "example.yaml"
    lines = []
    for line in example.splitlines():
        stripped = line.lstrip()
        shown = stripped.startswith(
            ("# conditioning:", "#   {", "# realtime:", "# predict:", "# state_dir:", "# source:", "# drive:")
        )
        words = stripped.removeprefix("# ").partition(" # ")[0].partition("   # offset")[0]
        indent = " " * (len(line) - len(stripped))
        lines.append(f"{indent}{words}" if shown else line)
    path.write_text("\n".join(lines))
    config = canfb.load_config(path)
    assert config.realtime.priority == 80
    module = config.modules[0]
    assert module.conditioning == canfb.Conditioning()
    assert (module.predict, module.state_dir) == (True, "/var/lib/canfb/x")
    assert module.source is not None
    assert module.source.kind == "iio"
    assert config.simulation.drive is not None


def test_several_modules_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.yaml"
    path.write_text("modules: [{node_id: 1}, {node_id: 127}]\n")
    assert main(["config", "check", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: valid; modules: 01h, 7Fh\n"
