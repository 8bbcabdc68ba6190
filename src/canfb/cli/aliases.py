"""Old commands and options, kept for one release: each is replaced by the new words before parsing.

A command line that begins with an old command gives one line on stderr with the new one.
"""

from __future__ import annotations

from collections.abc import Sequence

NODE = "NODE"  # In the words of an old command: a node-ID, which is kept.

COMMANDS = {
    "dump": "monitor --frames",
    "scope --demo": "try",
    "scope": "monitor --web",
    "diagnose": "why --bundle",
    "bus scan": "node list",
    "nmt reset-comm": "node reset --communication",
    "nmt": "node",
    "reset": "node reset",
    "record": "log record",
    "replay": "log replay",
    "interface": "run",
    "table upload": "table write",
    "table download": "table read",
    "restore": "backup restore",
    f"backup {NODE}": "backup save",
}
SHORT = {"demo": "try --story"}  # Short forms that are not deprecated.

# By command: old option -> new option; NODE: only its value is kept; None: dropped, it is now the default.
#
# An option after the command is a condition: with ``--samples`` there is no SYNC, and ``--rate`` is the old
# spelling of the rate of the file.
OPTIONS: dict[str, dict[str, str | None]] = {
    "": {"--answer-within": "--timeout"},  # for all commands
    "try": {"--no-scope": "--no-page"},
    "monitor": {"--rate": "--updates"},
    "simulate": {"--module": NODE},
    "config dcf": {"--module": NODE, "--node": NODE},
    "log replay": {"--module": NODE},
    "backup restore": {"--node": NODE},
    "calibrate --samples": {"--rate": "--sample-rate"},
    "calibrate": {"--module": NODE, "--sync": "--rate", "--no-save": None},
    "commission": {"--module": NODE, "--sync": "--rate"},
}


def current(words: Sequence[str]) -> tuple[list[str], str]:
    """The line in new words; the message on an old command, or ""."""
    at = next((n for n, word in enumerate(words) if not word.startswith("-")), len(words))
    before, line = list(words[:at]), list(words[at:])
    said = ""
    for old, new in (*SHORT.items(), *COMMANDS.items()):
        pattern = old.split()
        if _begins(line, pattern):
            line = [*new.split(), *line[len(pattern) - (NODE in pattern) :]]
            said = "" if old in SHORT else f"'canfb {old}' is now 'canfb {new}'"
            break
    for command, options in OPTIONS.items():
        begin, _, condition = command.partition(" --")
        if _begins(line, begin.split()) and (not condition or f" --{condition}" in " ".join(line)):
            line = _renamed(line, len(begin.split()), options)
    return before + line, said


def _begins(line: Sequence[str], pattern: Sequence[str]) -> bool:
    return len(line) >= len(pattern) and all(
        word == old or (old == NODE and word[:1].isdecimal())
        for word, old in zip(line, pattern, strict=False)
    )


def _renamed(line: Sequence[str], length: int, options: dict[str, str | None]) -> list[str]:
    done: list[str] = []
    nodes: list[str] = []
    words = iter(line)
    for word in words:
        option, equals, value = word.partition("=")
        new = options.get(option, option)
        if option not in options:
            done.append(word)
        elif new == NODE:
            nodes += [value if equals else next(words, "")]
        elif new is not None:
            done.append(f"{new}{equals}{value}")
    return done[:length] + nodes + done[length:]
