"""``canfb use``: the default bus, used if neither options nor a configuration name one."""

import argparse
import json

from canfb.bus.opening import check_words, describe
from canfb.cli.options import (
    BUS_WORDS,
    Commands,
    add_bus_options,
    add_command,
    default_bus_file,
    given_bus,
    option,
    remembered,
)
from canfb.errors import ConfigError
from canfb.files import write_whole


def register(commands: Commands) -> None:
    add_command(
        commands,
        "use",
        use,
        option("--forget", action="store_true", help="remove the default bus"),
        add_bus_options,
        idle=(((*BUS_WORDS, "bus_kwargs"), "forget", False, "not with --forget"),),
    )


def use(options: argparse.Namespace) -> int:
    words = given_bus(options)
    if options.forget:
        default_bus_file().unlink(missing_ok=True)
    elif words:
        if "interface" not in words:
            raise ConfigError("-i is required, for example: canfb use -i socketcan -c can0")
        check_words(words)
        default_bus_file().parent.mkdir(parents=True, exist_ok=True)
        write_whole(default_bus_file(), json.dumps(words, indent=2).encode())
    known = remembered()
    print(f"default bus: {describe(known)} ({default_bus_file()})" if known else "no default bus")
    return 0
