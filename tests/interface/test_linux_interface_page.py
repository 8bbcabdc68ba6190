"""docs/linux-interface.md: its configuration loads, its keys and messages are those of the program."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
from pathlib import Path

import pytest

from canfb.cia301.codes import AbortCode, EmergencyCode
from canfb.cli.main import build_parser, main
from canfb.configuration import INTERFACES, load_config
from canfb.interface.interface_config import InterfaceConfig
from canfb.sources.iio_source import IioSourceConfig

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "linux-interface.md").read_text(encoding="utf-8")


def test_the_configuration_of_the_page_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.S)
    path = tmp_path / "interface.yaml"
    path.write_text(text.replace("/var/lib/canfb", str(tmp_path)), encoding="utf-8")
    (interface,) = load_config(path, INTERFACES).interfaces
    assert isinstance(interface.source, IioSourceConfig)
    assert interface.times, "what the page recommends"
    assert main(["config", "check", str(path)]) == 0
    assert capsys.readouterr().out.endswith("valid; interfaces: 10h\n")


def test_its_commands_are_those_of_the_parser() -> None:
    (block,) = re.findall(r"```sh\n(.*?)```", PAGE, re.S)
    for line in block.splitlines():
        build_parser().parse_args(shlex.split(line)[1:])
    options = set(re.findall(r"`(--[\w-]+|-\w)`", PAGE)) - {"--phase-error"}
    assert options == {"--ready-file", "--json", "-v"}
    build_parser().parse_args(["interface", "x.yaml", "--ready-file", "r", "--json", "-v"])


def test_every_key_has_its_row() -> None:
    rows = dict(re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|([^|]*)\|", PAGE, re.M))
    defaults: dict[str, str] = {}
    for names, values in rows.items():
        keys = re.findall(r"\w+", names)
        defaults |= dict(zip(keys, (value.strip("` ") for value in values.split(",")), strict=True))
    told = {name: value for name, value in defaults.items() if value}
    fields = {field.name: field for field in dataclasses.fields(InterfaceConfig)}
    assert set(defaults) == set(fields)
    assert told == {
        name: str(field.default).lower()
        for name, field in fields.items()
        if field.default not in (None, dataclasses.MISSING)
    }


def test_its_codes_are_those_of_the_program() -> None:
    assert f"EMCY {EmergencyCode.HARDWARE:04X}h" in PAGE
    assert f"({AbortCode.DEVICE_STATE:08X}h)" in PAGE


PLAN = re.findall(r"^    canfb (plan .*)$", PAGE, re.M)[0].split()


def holds(rpm: float, cycles: int, phase_error: float, capsys: pytest.CaptureFixture[str]) -> bool:
    words = PLAN[: PLAN.index("--rpm")]
    code = main([*words, f"--rpm={rpm}", f"--cycles={cycles}", f"--phase-error={phase_error}", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert code == (0 if result["holds"] else 1)
    assert result["holds"] or result["tightest"]["limit"] in ("residual", "acceleration", "speed")
    return bool(result["holds"])


def test_the_speeds_are_those_of_the_plan(capsys: pytest.CaptureFixture[str]) -> None:
    """0.0125 + v (e + d / 2) cycles: each speed holds, and one a tenth higher does not."""
    assert main(PLAN) == 0
    capsys.readouterr()
    rows = re.findall(r"^\| (\d+) µs \| (\d+) µs \| (\d+) \| (\d+) \|", PAGE, re.M)
    assert len(rows) == 6
    for jitter_us, delay_us, *speeds in rows:
        for rpm, cycles in zip(speeds, (2500, 512), strict=True):
            for times, allowed in ((1.0, True), (1.1, False)):
                speed = times * float(rpm)
                sampled = speed / 60 * cycles * (float(jitter_us) + float(delay_us) / 2) * 1e-6
                assert holds(speed, cycles, 0.0125 + sampled, capsys) is allowed, (rpm, cycles, times)


def test_the_noise_of_the_residual_tells_the_jitter() -> None:
    """Second differences weigh independent errors by sqrt(1 + 4 + 1)."""
    (factor,) = re.findall(r"65536 \* ([\d.]+) \* v", PAGE)
    assert float(factor) == pytest.approx(6**0.5, abs=0.005)


def test_the_overlay_is_whole() -> None:
    (overlay,) = re.findall(r"```dts\n(.*?)```", PAGE, re.S)
    assert overlay.count("{") == overlay.count("}")
    assert all(line.rstrip().endswith((";", "{", "}")) for line in overlay.splitlines())


def test_the_links_lead_somewhere() -> None:
    for name in re.findall(r"\]\(([^)#]+)", PAGE):
        assert (DOCS / name).exists(), name
