"""Processor time of `detect` for a recording, without the start of the interpreter.

Usage: ``python -m bench.throughput.files FILE``. Prints the seconds.
"""

import contextlib
import gc
import io
import sys
import time
from pathlib import Path

from tactiled.offline import detect_file

if __name__ == "__main__":
    gc.freeze()  # as `tactiled detect` does
    began_s = time.process_time()
    with contextlib.redirect_stdout(io.StringIO()):
        detect_file(Path(sys.argv[1]))
    print(time.process_time() - began_s)
