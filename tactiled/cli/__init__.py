"""The command line. JSON lines go to stdout, text for people goes to stderr; a terminal has events in words.

Exit codes: 0 success, 1 the operation failed, 2 usage or configuration error. Slow imports happen inside the
command that needs them, so that ``--help`` and ``listen`` start at once.

`entry` holds the group and `main`; the commands are in these modules:

- `live`: run, listen, command, top
- `recordings`: record, replay, recover, export
- `analysis`: detect
- `upkeep`: check-config, doctor, keys, setup
- `packages`: how the verbs of other distributions are found, which are in `tactiled.commands`
"""

from tactiled.cli.entry import cli, main, run_command

__all__ = ["cli", "main", "run_command"]
