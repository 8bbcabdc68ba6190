# PYTHON_ARGCOMPLETE_OK: argcomplete looks for it here
"""The command line: ``canfb COMMAND``."""


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns its exit code, 130 after Ctrl-C (128 + SIGINT, as in shells)."""
    try:
        from canfb.cli.command_line import run  # imported here, where Ctrl-C is handled

        return run(arguments)
    except KeyboardInterrupt:
        return 130
