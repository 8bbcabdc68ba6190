"""reference/commands.md: the help of every command, from the parser of the command line."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial

from canfb.cli.commands import build_parser

WIDTH = 100
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
    parts = [INTRODUCTION, _help(parser)]
    parts += [f"\n## {command.prog}\n\n{_help(command)}" for command in commands_of(parser)]
    return "".join(parts)


def commands_of(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of all commands below ``parser``, each before its own."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                if command.prog.endswith(f" {name}"):  # not another name of it
                    yield command
                    yield from commands_of(command)


def _help(parser: argparse.ArgumentParser) -> str:
    parser.formatter_class = partial(argparse.RawDescriptionHelpFormatter, width=WIDTH)
    return f"```text\n{parser.format_help()}```\n"
