"""The pages of docs/reference: the help of every command, every key of the YAML, the object dictionaries.

Generated from the parser of the command line, the configuration classes with their docstrings, the EDS files.
"""

import argparse
import dataclasses
import inspect
from collections.abc import Iterator, Mapping
from functools import partial
from itertools import groupby
from typing import NamedTuple

from canfb import Conditioning, ModuleConfig, SecondPositionConfig, eds_path
from canfb.cli.commands import build_parser
from canfb.configuration import Config, RealtimeConfig
from canfb.device.od import eds
from canfb.interface.encoder_interface import InterfaceConfig
from canfb.sdo.object_description import ObjectDescription, ObjectDescriptions
from canfb.sdo.sdo_tasks import in_words, type_name, words_of
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.scenario import EncoderScenario, HarmonicConfig, MotionConfig, SimulationConfig
from canfb.sources.protocol import source_kinds
from tools.site.text import FIELD, plain, table

HELP_COLUMNS = 100
COMMANDS_TEXT = """# Commands

Made from the parser of `canfb`; `canfb COMMAND --help` prints the same. Exit status: 0 done, 1 the job
failed, 2 wrong use or configuration. An error is one line on standard error; `--debug` shows its traceback.

## Completion in the shell

With the extra `completion` (argcomplete) the TAB key completes commands, options, files, the node-IDs of the
configuration on the line, and the CAN interfaces of this computer:

```sh
pip install 'canfb[completion]'
eval "$(register-python-argcomplete canfb)"
```

The second line is for bash and zsh: put it into `~/.bashrc` or `~/.zshrc`. For fish:
`register-python-argcomplete --shell fish canfb | source`. In an environment made by `make`, install with
`.venv/bin/pip install -e '.[completion]'`, and activate the environment first.

## canfb

"""


def commands_page() -> str:
    parser = build_parser()
    parts = [COMMANDS_TEXT, _help(parser)]
    parts += [f"\n## {command.prog}\n\n{_help(command)}" for command in commands_of(parser)]
    return "".join(parts)


def commands_of(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of all commands below ``parser``, each before its own."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                if command.prog.endswith(f" {name}"):  # skip aliases
                    yield command
                    yield from commands_of(command)


def _help(parser: argparse.ArgumentParser) -> str:
    parser.formatter_class = partial(argparse.RawDescriptionHelpFormatter, width=HELP_COLUMNS)
    return f"```text\n{parser.format_help()}```\n"


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
KEYS_TEXT = """# Configuration keys

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
    """A row for a key, as text; the default of a required key is empty."""

    name: str
    default: str
    text: str


def described(kind: type) -> dict[str, str]:
    """Description of each field from the docstrings of a class and its bases."""
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
    texts = described(Config)
    sections = ((f"`{field.name}`", plain(texts[field.name])) for field in dataclasses.fields(Config))
    lines = [KEYS_TEXT, *table(("section", "meaning"), sections), BUS]
    kinds = [
        (f"modules: source, kind {name}", kind, plain((kind.__doc__ or "").split("\n")[0]))
        for name, kind in source_kinds().items()
    ]
    for title, kind, about in (*SECTIONS[:2], *kinds, *SECTIONS[2:]):
        lines += [f"\n## {title}", "", about[0].upper() + about[1:].rstrip(".") + ".", ""]
        rows = ((f"`{key.name}`", key.default or "required", plain(key.text)) for key in keys_of(kind))
        lines += table(("key", "default", "meaning"), rows)
    return "\n".join(lines) + "\n"


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


DEVICES = (
    ("canfb-module", 0x20, "The feedback module"),
    ("encoder-interface", 0x10, "The simulated encoder interface"),
    ("drive", 0x30, "The simulated drive"),
)
AREAS = ((0x6000, "Device profile"), (0x2000, "Manufacturer objects"), (0x1000, "Communication (CiA 301)"))
HEAD = ("object", "name", "type", "access", "PDO", "unit", "default", "range")
OBJECTS_TEXT = """# Object dictionary

All objects of the feedback module, and of the two devices that `canfb simulate` plays. The list is made
from the EDS files in `eds/`, which the programs load at run time. Numbers are hexadecimal where they end in
h. `rwr` and `rww` may be mapped into a TPDO or an RPDO. An empty range is that of the type. An empty
default is a live value, or belongs to the single device. Read and write them by name: [canfb
sdo](../monitor.md#one-object-of-a-node-canfb-sdo); services and error codes: [the CANopen
side](../canopen.md).
"""


def objects_page() -> str:
    return "\n".join([OBJECTS_TEXT, *(line for device in DEVICES for line in _device(*device))]) + "\n"


def _device(name: str, node_id: int, title: str) -> Iterator[str]:
    path = eds_path(name)
    described = ObjectDescriptions(path, node_id)
    contents = eds.read(path)
    sections = eds.sections(contents)
    yield from (f"\n## {title}", "", f"`eds/{name}.eds`; defaults with $NODEID depend on the node-ID.", "")
    entries = sorted(described, key=lambda entry: entry.place)
    for area, of_area in groupby(
        entries, key=lambda one: next(a for first, a in AREAS if one.index >= first)
    ):
        yield from (f"### {title}: {area}", "")
        yield from table(HEAD, (_row(entry, contents[sections[entry.place]]) for entry in of_area))
        yield ""
    worded = [(entry, list(_words(described.product, entry))) for entry in entries]
    if any(words for _, words in worded):
        yield from (f"### {title}: values in words", "")
        rows = ((f"`{e.number}`", e.title, ", ".join(words)) for e, words in worded if words)
        yield from table(("object", "name", "values"), rows)
    notes = [line for key, line in contents.get("Comments", {}).items() if key != "Lines"]
    if notes:
        yield from ("", f"### {title}: notes in the EDS", "", *(f"- {plain(note)}" for note in notes))


def _words(product: str, entry: ObjectDescription) -> Iterator[str]:
    for word, value in words_of(product, entry.place).items():
        is_bits = value and not value & (value - 1) and in_words(product, entry.place, 0) == "nothing set"
        if value > 0xFFFF:
            yield f"{word} ({value:08X}h)"
        else:
            yield f"bit {value.bit_length() - 1} {word}" if is_bits else f"{value} {word}"


def _row(entry: ObjectDescription, section: Mapping[str, str]) -> tuple[str, ...]:
    """Row of an object: its description, and default, mapping and limits as written in the file."""
    default = section.get("DefaultValue", "").strip()
    limits = (section.get("LowLimit", "").strip(), section.get("HighLimit", "").strip())
    mapped = section.get("PDOMapping", "0").strip() == "1"
    return (
        *(f"`{entry.number}`", plain(entry.title), type_name(entry.data_type), entry.access),
        *("yes" if mapped else "", plain(entry.unit), f"`{default}`" if default else ""),
        "..".join(limits) if any(limits) else "",
    )
