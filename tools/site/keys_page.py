"""reference/keys.md: every key of the YAML, from the configuration classes and their docstrings."""

from __future__ import annotations

import dataclasses
import inspect
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

The YAML of `canfb run`, `canfb simulate` and the commands with `--config`. Every key is a
field of a class of canfb; this page is made from those classes. `canfb config example` prints a file to start
from, `canfb config check` names file, line and key of a mistake. A key without default is required.
"""
BUS = """
## bus

python-can's own words: `interface`, `channel`, `bitrate` (bit/s), and what else the interface takes. All
may be left to the command line (`-i`, `-c`, `-b`), to the environment or to the configuration file of
python-can.
"""


class Key(NamedTuple):
    """One row, as text; an empty default for a key that is required."""

    name: str
    default: str
    text: str


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
        if field.metadata.get("key", True):
            yield Key(field.name, _default(field), texts.get(field.name, ""))


def keys_page() -> str:
    lines = [INTRODUCTION, *_top(), BUS]
    kinds = [(f"modules: source, kind {name}", kind, _summary(kind)) for name, kind in source_kinds().items()]
    for title, kind, about in (*SECTIONS[:2], *kinds, *SECTIONS[2:]):
        lines += [f"\n## {title}", "", about[0].upper() + about[1:].rstrip(".") + ".", ""]
        rows = ((f"`{key.name}`", key.default or "required", plain(key.text)) for key in keys_of(kind))
        lines += table(("key", "default", "meaning"), rows)
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
