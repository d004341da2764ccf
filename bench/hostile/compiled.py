"""Arrays of any size through the compiled path, on a small stack."""

import subprocess
import sys
from pathlib import Path

from bench.hostile.attack import Attack, Outcome

# A thread of musl has 128 kB, one of glibc 8 MB; an array of variable length beyond it ends the process.
STACK_KB = 256
# A contact that is pulled until it slides, and its readings, in a thread; what is left is how it ended.
_PLAY = """
import sys, threading
import numpy as np
from tactiled import compiled
from tactiled.array import ArrayFile, build
from tactiled.detect.contact.grip_detector import GripDetector
from tactiled.detect.contact.readings import TaxelReadings
from tactiled.detect.signal.quantise import Quantiser
from tactiled.samples.block import regular_block

side, side_read, stack_kb = map(int, sys.argv[1:])
seen = []

def wide(side):
    places = [2.0 * k for k in range(side)]
    kinds = [{"name": name, "kind": kind} for name, kind in
             (("X", "shear_x"), ("Y", "shear_y"), ("Z", "normal"))]
    return build(ArrayFile.model_validate({
        "name": "wide", "unit": "V", "range": [0.0, 5.0], "grids": [{"x_mm": places, "y_mm": places}],
        "taxel_channels": kinds,
    }))

def contact():
    array = wide(side)
    volts = np.zeros((8, array.n_channels))
    volts[2:, 2::3], volts[4:, 0::3] = 1.0, 0.3
    events = GripDetector(array).process(regular_block(volts, 100.0))
    seen.append(len(events) == 6 and all(np.isfinite(event.utilisation) for event in events))

def readings():
    array = wide(side_read)
    of_all = TaxelReadings(array, 100.0)
    block = regular_block(np.ones((4, array.n_channels)), 100.0)
    of_all.begin_block(Quantiser(array).process(block), block.channel_offset_s)
    for scan in range(4):
        of_all.take(scan, True, True)
        seen.append(np.isfinite(of_all.load))

threading.stack_size(stack_kb * 1024)
for part in (contact, readings):
    thread = threading.Thread(target=part)
    thread.start()
    thread.join()
print(compiled.path_words(), len(seen) == 5 and all(seen))
"""


def _wide(_folder: Path, scale: float) -> Outcome:
    side, side_read = (64, 24) if scale >= 1.0 else (32, 12)
    command = [sys.executable, "-c", _PLAY, str(side), str(side_read), str(STACK_KB)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    seen = done.stdout.strip() or f"ended with {done.returncode}: {done.stderr.strip()[-200:]}"
    return Outcome(seen, held=done.returncode == 0 and seen.endswith("True"))


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "compiled path: arrays beyond the stack",
        f"a contact of 64 x 64 taxels and readings of 24 x 24 of three axes, in a thread of {STACK_KB} kB",
        "finite numbers; no crash",
        _wide,
        short=0.5,
    ),
)
