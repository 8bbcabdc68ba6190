"""reference/keys.md: every key of the YAML, from the configuration classes and their docstrings."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Iterator
from typing import NamedTuple

from canfb.configuration import Config, RealtimeConfig
from canfb.interface.encoder_interface import InterfaceConfig
from canfb.module.module_config import ModuleConfig, SecondPositionConfig
from canfb.signal.conditioning import Conditioning
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.scenario import EncoderScenario, HarmonicConfig, MotionConfig, SimulationConfig
from canfb.sources.protocol import source_kinds
from tools.site.markdown import FIELD, plain, table

SECTIONS: tuple[tuple[str, type, str], ...] = (
    ("modules", ModuleConfig, "a list: one part for each module"),
    ("modules: conditioning", Conditioning, "the errors of the tracks, corrected before the table (2002h)"),
    (
        "modules: second_position",
        SecondPositionConfig,
        "another sensor of the machine (2014h); see [the second position](../homing.md)",
    ),
    (
        "interfaces",
        InterfaceConfig,
        "a list, for `canfb run`; see [a Linux computer as the interface](../local-adc.md)",
    ),
    ("realtime", RealtimeConfig, "see [real time](../service.md#real-time)"),
    ("simulation", SimulationConfig, "what `canfb simulate` plays; see [simulation](../simulation.md)"),
    ("simulation: encoder", EncoderScenario, "the errors of the simulated encoder"),
    ("simulation: encoder: harmonics", HarmonicConfig, "a list"),
    ("simulation: motion", MotionConfig, "the motion of the machine"),
    ("simulation: drive", DriveConfig, "a CiA 402 drive that moves the machine instead of `motion`"),
)
INTRODUCTION = """# Configuration keys

The YAML of `canfb run`, `canfb run`, `canfb simulate` and the commands with `--config`. Every key is a
field of a class of canfb; this page is made from those classes. `canfb config example` prints a file to start
from, `canfb config check` names file, line and key of a mistake. A key without default is required.
"""
BUS = """
## bus

python-can's own words: `interface`, `channel`, `bitrate` (bit/s), and what else the interface takes. All
may be left to the command line (`-i`, `-c`, `-b`), to the environment or to the configuration file of
python-can.
"""
# The unit is the end of the name; of other names it stands behind the range.
SUFFIXES = {
    "rad_per_s": "rad/s",
    "rad_s2": "rad/s²",
    "rad_s": "rad/s",
    "rad_s3": "rad/s³",
    "kg_m2": "kg m²",
    "nm_s": "Nm s/rad",
    "nm": "Nm",
    "rad": "rad",
    "counts": "ADC counts",
    "scale": "ADC counts",
    "cycles_per_revolution": "cycles",
    "samples_per_sync": "samples",
    "noise_margin": "standard deviations",
    "scans_per_sync": "scans",
    "periods": "SYNC periods",
    "lsb": "LSB",
    "rpm": "1/min",
    "hz": "Hz",
    "us": "µs",
    "ns": "ns",
    "s": "s",
    **{name: name for name in ("revolutions", "increments", "bytes", "samples", "scans", "bits", "ppm")},
}
UNITS = (
    "cycles",
    "cycle",
    "bit/s",
    "Hz",
    "µs",
    "us",
    "Nm",
    "of the full scale",
    "of the amplitude",
    "counts",
    "V",
)
NUMBER = r"-?(?:\d+(?:\.\d+)?(?:e-?\d+)?|pi/3)(?:\^\d+(?: - \d+)?)?"
RANGE = re.compile(
    rf"{NUMBER}\.\.{NUMBER}(?: or its negative)?|{NUMBER} < \w+ <= {NUMBER}"
    rf"|above {NUMBER}(?:, at most {NUMBER})?|more than {NUMBER}"
    r"|any finite value|any number of counts"
)


class Key(NamedTuple):
    """One row: range, unit and default as text; an empty default for a key that is required."""

    name: str
    default: str
    unit: str
    range: str
    text: str
    is_number: bool


def described(kind: type) -> dict[str, str]:
    """What the docstrings of a class and its bases say of each field."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        names: list[str] = []
        for line in inspect.cleandoc(base.__dict__.get("__doc__") or "").splitlines():
            if start := FIELD.match(line):
                names = start[1].split(", ")
                found.update(dict.fromkeys(names, start[2]))
            elif line.startswith("  ") and names:
                found.update({name: f"{found[name]} {line.strip()}" for name in names})
            else:
                names = []
    return found


def keys_of(kind: type) -> Iterator[Key]:
    texts = described(kind)
    for field in dataclasses.fields(kind):
        if not field.metadata.get("key", True):
            continue
        text = texts.get(field.name, "")
        limits = RANGE.search(text)
        is_flag = str(field.type) == "bool"
        yield Key(
            field.name,
            _default(field),
            _unit(field.name, text, limits),
            "true, false" if is_flag else limits[0] if limits else "",
            text,
            bool(re.search(r"\b(int|float)\b", str(field.type))),
        )


def keys_page() -> str:
    lines = [INTRODUCTION, *_top(), BUS]
    kinds = [(f"modules: source, kind {name}", kind, _summary(kind)) for name, kind in source_kinds().items()]
    for title, kind, about in (*SECTIONS[:2], *kinds, *SECTIONS[2:]):
        lines += [f"\n## {title}", "", about[0].upper() + about[1:].rstrip(".") + ".", ""]
        rows = (
            (f"`{key.name}`", key.default or "required", key.unit, key.range, plain(key.text))
            for key in keys_of(kind)
        )
        lines += table(("key", "default", "unit", "range", "meaning"), rows)
    return "\n".join(lines) + "\n"


def _top() -> Iterator[str]:
    texts = described(Config)
    rows = ((f"`{field.name}`", plain(texts[field.name])) for field in dataclasses.fields(Config))
    yield from table(("section", "meaning"), rows)


def _summary(kind: type) -> str:
    return plain((kind.__doc__ or "").split("\n")[0])


def _default(field: dataclasses.Field[object]) -> str:
    if field.default_factory is not dataclasses.MISSING:
        made = field.default_factory()
        return "none" if made in ([], {}) else "see below"
    if field.default is dataclasses.MISSING:
        return ""
    if field.default is None:
        return "none"
    if isinstance(field.default, bool):
        return f"`{str(field.default).lower()}`"
    if dataclasses.is_dataclass(field.default):
        return "see below"
    if field.name in ("node_id", "encoder_interface"):
        return f"`0x{field.default:02X}`"
    if isinstance(field.default, tuple):
        return f"`[{', '.join(map(str, field.default))}]`"
    return f"`{field.default:.6g}`" if isinstance(field.default, float) else f"`{field.default}`"


def _unit(name: str, text: str, limits: re.Match[str] | None) -> str:
    for ending, unit in SUFFIXES.items():
        if name == ending or name.endswith(f"_{ending}"):
            return unit
    behind = text[limits.end() :].lstrip() if limits else ""
    unit = next((unit for unit in UNITS if re.match(rf"{re.escape(unit)}(?!\w)", behind)), "")
    if unit:
        return unit
    return next((unit for unit in UNITS if text.startswith(f"{unit} ")), "")
