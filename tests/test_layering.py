"""The house as the design has it: imports point one way, time is an argument, files stay small."""

import ast
import sys
from dataclasses import dataclass
from pathlib import Path

import canfb
from folding import each
from tools.suite import house

PACKAGE = Path(canfb.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
LONGEST_FILE = 500

# What every part that speaks CANopen, or says what it found, may use.
WORDS = {"checks", "cia301", "errors", "files", "objects", "rows"}
# What each part may import of canfb, beyond itself: the table of docs/architecture.md, from which this is
# read. The files beside the folders are parts of their own. All but a source's samples, the word of signal,
# comes to it as an argument (Surroundings): the simulated machine, and the threads and clocks of bus; so
# module, simulation and bus build on sources. Time is an argument for replay, too: frames of a log in, what
# the module made of them out. Pictures (report) need what is measured, and nothing of how: so the demo and
# every tool on top may use them. The limits in force (view) are arithmetic of signal. Monitoring knows what
# others tell of themselves on the bus: so it may watch modules that are not ours. Planning is arithmetic over
# module, wire and simulated motion: it needs no bus, so it is not in a part that has one. The public names
# (__init__) have hosting for StateFiles, when it is asked for.
ALLOWED = house.imports()

# What runs a source must not care which: a new kind is one file in sources/. A recording is what calibrate
# and simulate play.
MAY_NAME_A_KIND = {"simulation", "calibrate", "cli"}

# What each part may import of other packages. canopen reads the EDS for the device, and is the master of
# the demo and of the tools; python-can has the words of the command line, and argcomplete completes them;
# libiio has the converter of a source, which a thread of bus waits for; rich draws the page of the monitor.
FOREIGN: dict[str, set[str]] = {
    "signal": {"numpy"}, "calibration": {"numpy"}, "sources": {"numpy", "iio"}, "interface": {"numpy"},
    "simulation": {"numpy"}, "planning": {"numpy"}, "replay": {"numpy"}, "configuration": {"yaml"},
    "marked_yaml": {"yaml"}, "report": {"numpy"}, "master": {"numpy", "canopen", "can"},
    "sdo": {"numpy", "yaml"}, "calibrate": {"numpy"}, "commission": {"numpy"}, "scope": {"numpy"},
    "bus": {"can", "canopen"}, "hosting": {"can"}, "logfile": {"can"}, "logs": {"numpy", "pyarrow"},
    "demo": {"numpy", "canopen"}, "monitoring": {"can", "rich"}, "cli": {"can", "argcomplete", "rich"},
}  # fmt: skip
# Clocks, threads and sockets have two places, and the files beyond them that wait for a bus or a browser.
WITH_A_CLOCK = {"logfile/bus_logs.py", "logs/log_replay.py", "monitoring/watching.py",
                "monitoring/sdo_reading.py", "scope/page_server.py"}  # fmt: skip
OUTSIDE_WORLD = {"time", "threading", "socket", "select", "selectors", "asyncio", "datetime", "signal",
                 "multiprocessing", "concurrent", "sched", "queue", "subprocess"}  # fmt: skip


@dataclass(frozen=True)
class Import:
    file: Path
    line: int
    name: str
    types_only: bool

    @property
    def package(self) -> str:
        return self.name.partition(".")[0]

    @property
    def part(self) -> str:
        """The part of canfb that is imported; `canfb` itself is __init__."""
        words = self.name.split(".")
        return words[1] if len(words) > 1 else "__init__"

    def __str__(self) -> str:
        return f"{self.file.relative_to(PACKAGE)}:{self.line} imports {self.name}"


def part_of(file: Path) -> str:
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports_of(file: Path) -> list[Import]:
    tree = ast.parse(file.read_text(encoding="utf-8"))
    guarded = {
        inner
        for outer in ast.walk(tree)
        if isinstance(outer, ast.If) and ast.unparse(outer.test) == "TYPE_CHECKING"
        for inner in ast.walk(outer)
    }
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}:{node.lineno}: relative import; write canfb.…"
            assert node.module is not None
            names = [node.module]
            if node.module == "canfb":  # `from canfb import device` imports the part device
                names = [f"canfb.{alias.name}" for alias in node.names]
        else:
            continue
        found += [Import(file, node.lineno, name, node in guarded) for name in names]
    return found


IMPORTS = [found for file in FILES for found in imports_of(file)]


def test_every_part_has_its_rule_and_the_walk_sees_the_imports_that_are_there() -> None:
    assert {part_of(file) for file in FILES} == set(ALLOWED)
    seen = {(part_of(one.file), one.part) for one in IMPORTS if one.package == "canfb"}
    assert {("module", "signal"), ("module", "device"), ("cli", "bus"), ("__main__", "cli")} <= seen


def test_imports_point_one_way() -> None:
    wrong = [
        str(one)
        for one in IMPORTS
        if one.package == "canfb" and one.part not in ALLOWED[part_of(one.file)] | {part_of(one.file)}
    ]
    assert wrong == []


def test_what_runs_a_source_names_no_kind() -> None:
    naming = [
        one for one in IMPORTS if one.name.startswith("canfb.sources.") and one.name.endswith("_source")
    ]
    assert [str(one) for one in naming if part_of(one.file) not in MAY_NAME_A_KIND] == []
    assert {part_of(one.file) for one in naming} == MAY_NAME_A_KIND, "a rule that nothing needs any more"


def test_the_rules_themselves_have_no_circle() -> None:
    done: list[str] = []
    while len(done) < len(ALLOWED):
        ready = [part for part, below in ALLOWED.items() if part not in done and below <= set(done)]
        assert ready, f"a circle among {sorted(set(ALLOWED) - set(done))}"
        done += ready


def test_no_file_imports_itself_round_about() -> None:
    """Among the files of one part imports point one way as well, also those for the type checker alone."""
    known = {_name(file): file for file in FILES}
    below = {
        name: {one.name for one in imports_of(file) if one.name in known and _counts(one)} - {name}
        for name, file in known.items()
    }
    while below:
        ready = [name for name, wanted in below.items() if not wanted & set(below)]
        assert ready, f"a circle among {sorted(below)}"
        for name in ready:
            del below[name]


def _counts(one: Import) -> bool:
    return not (one.types_only and part_of(one.file) == "__init__")


def _name(file: Path) -> str:
    return ".".join(("canfb", *file.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")


def test_clocks_threads_and_sockets_are_in_few_places() -> None:
    outside = [one for one in IMPORTS if one.package in OUTSIDE_WORLD]
    beyond = {
        one.file.relative_to(PACKAGE).as_posix()
        for one in outside
        if part_of(one.file) not in ("bus", "hosting")
    }
    assert beyond == WITH_A_CLOCK
    assert {one.package for one in outside} >= {"time", "signal"}


def test_other_packages_are_where_they_belong() -> None:
    foreign = [
        one for one in IMPORTS if one.package != "canfb" and one.package not in sys.stdlib_module_names
    ]
    wrong = [str(one) for one in foreign if one.package not in FOREIGN.get(part_of(one.file), set())]
    assert wrong == []
    assert {(part, name) for part, names in FOREIGN.items() for name in names} == {
        (part_of(one.file), one.package) for one in foreign
    }, "a rule that nothing needs any more"


@each("file", FILES)
def test_files_stay_small(file: Path) -> None:
    assert len(file.read_text(encoding="utf-8").splitlines()) <= LONGEST_FILE


def test_no_name_stands_twice() -> None:
    """Neither of a file nor of a class: what is read about one is not meant for the other."""
    files = [file.stem for file in FILES if file.stem != "__init__"]
    classes = [
        node.name
        for file in FILES
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    ]
    assert [name for names in (files, classes) for name in set(names) if names.count(name) > 1] == []


# A command parses, calls and prints; what it does has a room of its own. A file has the commands of one task
# with all of their options; a step of a command, beside the options, is short.
LONGEST_COMMAND, LONGEST_STEP = 240, 40


@each("file", [file for file in FILES if part_of(file) == "cli"])
def test_commands_stay_thin(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= (LONGEST_COMMAND if "def register(" in text else LONGEST_FILE)
    steps = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    steps = [step for step in steps if "option(" not in (ast.get_source_segment(text, step) or "")]
    lengths = {step.name: (step.end_lineno or 0) - step.lineno + 1 for step in steps}
    assert max(lengths.values(), default=0) <= LONGEST_STEP, lengths
