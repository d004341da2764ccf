"""Processor time of `detect` or `replay` for a recording, without the start of the interpreter.

Usage: ``python -m bench.throughput.files detect|replay FILE``. Prints the seconds.
"""

import contextlib
import gc
import io
import sys
import time
from pathlib import Path

from tactiled.offline import detect_file
from tactiled.recording.replay import replay


def main(verb: str, path: Path) -> None:
    """Run a verb on a file, and print the processor time in seconds."""
    gc.freeze()  # as `tactiled detect` does
    began_s = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()) as out:
        if verb == "detect":
            detect_file(path)
        else:
            replay([path], lambda line: print(line, file=out))
    print(time.process_time() - began_s)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
