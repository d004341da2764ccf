"""Group of all commands, and the entry point: every error ends in one line and an exit code."""

import os
import sys

import click

from tactiled.cli import (
    analysis,
    live,
    recordings,
    upkeep,
)  # fmt: skip
from tactiled.cli.packages import OpenGroup
from tactiled.errors import TactiledError
from tactiled.progress import tell
from tactiled.version import __version__

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


@click.group(cls=OpenGroup, context_settings=CONTEXT)
@click.version_option(__version__, prog_name="tactiled")
def cli() -> None:
    """Tactile-sensing daemon: serial taxel arrays in, slip and texture events out.

    Start with `tactiled demo`: it needs no hardware.
    """


for verb in (
    live.run, live.listen, live.command, live.top,
    recordings.record, recordings.replay, recordings.recover, recordings.export,
    analysis.detect,
    upkeep.check_config, upkeep.doctor, upkeep.keys, upkeep.setup,
):  # fmt: skip
    cli.add_command(verb)


def main() -> None:
    """Run `tactiled` as a program."""
    run_command(cli)


def run_command(command: click.Command) -> None:
    """Run a command as a program: each error ends in one line on stderr and an exit code."""
    try:
        sys.exit(command.main(standalone_mode=False))
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except click.Abort:
        sys.exit(130)
    except TactiledError as error:
        tell(f"tactiled: {error}")
        sys.exit(error.exit_code)
    except BrokenPipeError:  # the reader of stdout has closed the pipe: a regular end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
