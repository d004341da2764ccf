"""The command line. Machine output goes to stdout as JSON lines, everything for people to stderr.

Exit codes: 0 good, 1 the operation failed, 2 usage or configuration. Heavy rooms are imported by the
command that needs them, so that ``--help`` and ``listen`` start at once.

`entry` is the group and `main`. The verbs lie by what one does with them:

- `live`: run, listen, command
- `recordings`: record, replay, recover, export
- `emulation`: emulate, demo
- `analysis`: detect, tune
- `upkeep`: check-config, doctor, keys, fit-material
"""

from tactiled.cli.entry import cli, main, run_command

__all__ = ["cli", "main", "run_command"]
