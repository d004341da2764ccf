"""``python -m tools.fem MESH [RUN ...]``: make the reference data in config/contact/.

Example: ``python -m tools.fem coarse load flat-0.6``. No RUN is every run; the run
``compliance`` is linear and needs no felupe.
"""

import argparse
import sys

from tactiled.errors import TactiledError
from tools.fem.compliance import write_compliance
from tools.fem.mesh import MESHES
from tools.fem.runs import RUNS, produce


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def main() -> int:
    """Make the reference data that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m tools.fem", description=__doc__)
    parser.add_argument("mesh", choices=list(MESHES))
    parser.add_argument("run", nargs="*", help=f"compliance, {', '.join(RUNS)}")
    asked = parser.parse_args()
    try:
        if "compliance" in asked.run:
            _report(str(write_compliance(asked.mesh)))
        names = [name for name in asked.run if name != "compliance"]
        if names or not asked.run:
            produce(asked.mesh, names, _report)
    except TactiledError as error:
        _report(str(error))
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
