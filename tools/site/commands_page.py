"""reference/commands.md: every command with its options, from the parser of the command line."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

from canfb.cli.commands import build_parser, examples_of
from tools.site.markdown import plain, table

INTRODUCTION = """# Commands

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
    lines = [INTRODUCTION, *_one(parser)]
    for command in commands_of(parser):
        lines += ["", f"## {command.prog}", "", *_one(command)]
    return "\n".join(lines) + "\n"


def commands_of(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of all commands below ``parser``, each before its own."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                if command.prog.endswith(f" {name}"):  # not another name of it
                    yield command
                    yield from commands_of(command)


def _one(parser: argparse.ArgumentParser) -> Iterator[str]:
    if parser.description:
        yield from (plain(parser.description[0].upper() + parser.description[1:]).rstrip(".") + ".", "")
    usage = " ".join(["canfb", *_usage(parser)])
    yield from ("```text", usage, "```", "")
    rows = [row for action in parser._actions if (row := _row(parser, action))]
    if rows:
        yield from table(("argument", "default", "meaning"), rows)
    examples = examples_of(parser.prog)
    if examples:
        yield from ("", "```sh", *(line.removeprefix("  ") for line in examples.splitlines()[1:]), "```")


def _usage(parser: argparse.ArgumentParser) -> Iterator[str]:
    yield from parser.prog.split()[1:]
    options = [action for action in parser._actions if action.option_strings]
    for action in options:
        if action.required:
            yield f"{action.option_strings[-1]} {_value(action)}".rstrip()
    yield "[options]"
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield "COMMAND ..."
        elif not action.option_strings:
            name = _value(action)
            yield {"?": f"[{name}]", "*": f"[{name} ...]", "+": f"{name} ..."}.get(str(action.nargs), name)


def _row(parser: argparse.ArgumentParser, action: argparse.Action) -> tuple[str, str, str] | None:
    if (
        isinstance(action, argparse._SubParsersAction)
        or action.help == argparse.SUPPRESS
        or action.dest == "help"
    ):
        return None
    value = _value(action)
    names = [f"`{name} {value}`" if value else f"`{name}`" for name in action.option_strings] or [
        f"`{value}`"
    ]
    text = plain(_help(parser, action))
    if action.choices is not None:
        text += f" One of {', '.join(f'`{one}`' for one in action.choices)}."
    return ", ".join(names), _default(action), text.strip()


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    formatter = parser._get_formatter()
    return formatter._expand_help(action) if action.help else ""


def _value(action: argparse.Action) -> str:
    """The word for its value, "" for a switch."""
    if action.nargs == 0:
        return ""
    word = action.metavar or action.dest.upper()
    return " ".join(word) if isinstance(word, tuple) else str(word)


def _default(action: argparse.Action) -> str:
    default = action.default
    if default in (None, False, argparse.SUPPRESS) or action.nargs == 0 or default == []:
        return ""
    return f"`{default}`"
