"""``python -m tactiled.emulator.mechanics.fem MESH [RUN ...]``; the run ``compliance`` needs no felupe."""

import sys

from tactiled.emulator.mechanics.fem.compliance import write_compliance


def main(arguments: list[str]) -> None:
    mesh, names = arguments[0], arguments[1:]
    if names == ["compliance"]:
        print(write_compliance(mesh), file=sys.stderr)
        return
    from tactiled.emulator.mechanics.fem.runs import produce  # the optional extra is needed from here on

    produce(mesh, names, lambda line: print(line, file=sys.stderr, flush=True))


main(sys.argv[1:])
