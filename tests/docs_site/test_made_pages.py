"""The pages made of the code: every object, key, command and name is there, with what belongs to it."""

import argparse
import dataclasses
import re
from functools import cache

import pytest

import canfb
from canfb.cli.commands import build_parser
from canfb.sources.motion_source import MotionSourceConfig
from canfb.sources.protocol import source_kinds
from eds_text import eds_of
from tools.site.reference import SECTIONS, commands_of, commands_page, keys_of, keys_page, objects_page
from tools.site.text import as_rst

DIMENSIONLESS = {
    "predict",
    "serial_number",
    "unlock_code",
    "node_id",
    "encoder_interface",
    "priority",
    "cpu",
    "seed",
    "order",
}
DIMENSIONLESS |= {"sine_gain", "cosine_gain", "bus_load", "cob_id"}
DIMENSIONLESS |= {name for name in canfb.Conditioning().words if name.startswith("harmonic")}
# A unit is the end of a name, or stands in the text.
UNIT_OF_A_NAME = re.compile(
    r"(?:^|_)(?:rad_per_s|rad(?:_s[23]?)?|kg_m2|nm(?:_s)?|counts|scale|cycles_per_revolution|samples|scans|bits"
    r"|samples_per_sync|scans_per_sync|noise_margin|periods|lsb|rpm|hz|[un]?s|ppm|revolutions|increments|bytes)$"
)
UNIT = re.compile(r"\b(?:cycles?|bit/s|of the (?:full scale|amplitude)|counts|V)\b")
NUMBER = r"-?(?:\d+(?:\.\d+)?(?:e-?\d+)?|pi/3)(?:\^\d+(?: - \d+)?)?"
RANGE = re.compile(
    rf"{NUMBER}\.\.{NUMBER}(?: or its negative)?|{NUMBER} < \w+ <= {NUMBER}"
    rf"|above {NUMBER}(?:, at most {NUMBER})?|more than {NUMBER}"
    r"|any finite value|any number of counts"
)
KINDS = [kind for _, kind, _ in SECTIONS] + list(source_kinds().values())


commands, keys, objects = cache(commands_page), cache(keys_page), cache(objects_page)


@pytest.mark.parametrize("name", ["canfb-module", "encoder-interface", "drive"])
def test_every_object_is_there_with_its_unit_and_default(name: str) -> None:
    eds = eds_of(f"{name}.eds", 32)
    part = objects().partition(f"`eds/{name}.eds`")[2].partition("\n## ")[0]
    rows = {
        cells[0].strip("`"): cells
        for line in part.splitlines()
        if len(cells := [one.strip() for one in re.split(r"(?<!\\)\|", line)[1:-1]]) == 8
    }
    for index, subindex, section in eds.listed():
        options = eds.sections[section]
        if options["ObjectType"] not in ("0x8", "0x9"):
            row = rows[f"{index:04X}:{subindex or 0:02X}"]
            assert options["ParameterName"].lower() in row[1].replace("\\", "").lower()
            assert row[6].strip("`") == options.get("DefaultValue", "").strip()
    units = {  # read by other means than the page
        f"{index.upper()}:{int(sub or '0', 16):02X}": unit
        for unit, index, sub in re.findall(r"^;Unit=(.*)\n\[(\w{4})(?:sub(\w+))?\]", eds.text, re.MULTILINE)
    }
    assert units
    for number, unit in units.items():
        assert rows[number][5].replace("\\", "") == unit
    assert not [number for number, row in rows.items() if ":" in number and row[5] and number not in units]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_key_is_there_and_a_number_has_unit_and_range(kind: type) -> None:
    every = list(keys_of(kind))
    assert [key.name for key in every] == [
        f.name for f in dataclasses.fields(kind) if f.metadata.get("key", True)
    ]
    for key in every:
        assert f"| `{key.name}` | {key.default or 'required'} |" in keys()
        assert key.text, f"{kind.__name__}.{key.name}: its docstring says nothing of it"
        if key.name in numbers_of(kind) and key.name not in ("time_column", "columns"):
            assert RANGE.search(key.text), f"{kind.__name__}.{key.name}: no range in its docstring"
            unit = UNIT_OF_A_NAME.search(key.name) or UNIT.search(key.text) or key.name in DIMENSIONLESS
            assert unit, f"{kind.__name__}.{key.name}: no unit"


def numbers_of(kind: type) -> set[str]:
    return {f.name for f in dataclasses.fields(kind) if re.search(r"\b(int|float)\b", str(f.type))}


REQUIRED = {"node_id": 5, "order": 3, "device": "x", "file": "x", "source": MotionSourceConfig()}


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_the_ranges_are_those_that_the_classes_hold(kind: type) -> None:
    required = {
        f.name: REQUIRED[f.name]
        for f in dataclasses.fields(kind)
        if f.default is f.default_factory is dataclasses.MISSING
    }
    for key in keys_of(kind):
        said = RANGE.search(key.text)
        found = re.fullmatch(r"(-?[\d.e-]+)\.\.([\d.e-]+)", said[0]) if said else None
        if found and key.name in numbers_of(kind) - {"bus_load", "node_id"}:
            ends = float(found[1]), float(found[2])
            whole = not re.search(r"[.e]", found[1] + found[2])
            for outside in (ends[0] - 1, ends[1] + max(1, abs(ends[1]) * 0.01)):
                value = int(outside) if whole else outside
                with pytest.raises((ValueError, TypeError), match=key.name):
                    kind(**{**required, key.name: value})


def test_every_command_is_there_with_its_options() -> None:
    text = commands()
    every = list(commands_of(build_parser()))
    assert {"canfb run", "canfb table write", "canfb config dcf"} <= {one.prog for one in every}
    for command in every:
        part = text.partition(f"\n## {command.prog}\n")[2].partition("\n## ")[0]
        assert part, command.prog
        for action in command._actions:
            for name in () if action.help == argparse.SUPPRESS else action.option_strings:
                assert re.search(rf"(?m)^  .*{name}[ ,\n]", part), (command.prog, name)


def test_columns_of_a_docstring_become_fields() -> None:
    lines = [
        "What it is.",
        "",
        "first, second   a * b",
        "                more",
        "third_s         seconds",
        "",
        "After.",
    ]
    assert [*as_rst(lines)] == [
        "What it is.",
        "",
        "",
        ":first, second: a \\* b",
        "    more",
        ":third_s: seconds",
        "",
        "After.",
    ]
