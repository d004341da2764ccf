"""The number of cores makes no difference to any event, and the kind of processor none to forces."""

import json
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.simulate import Simulation
from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.writer import RecordingWriter

THREADS_OF = """
import json, sys
{before}
{then}
from threadpoolctl import threadpool_info
json.dump([each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"], sys.stdout)
"""


def threads_of_blas(before: str, then: str) -> list[int]:
    """Threads of each BLAS of a new process that could have two, after statements that import."""
    environ = os.environ | {"OPENBLAS_NUM_THREADS": "2", "MKL_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", THREADS_OF.format(before=before, then=then)],
        env=environ, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    threads: list[int] = json.loads(done.stdout)
    return threads


@pytest.mark.parametrize(
    ("before", "then"),
    [
        ("", "import tactiled.pipeline"),
        ("import numpy, scipy.linalg", "import tactiled.pipeline"),
        ("import numpy, scipy.linalg", "import tactiled.emulator.simulate"),
    ],
)
def test_every_blas_has_one_thread_even_where_numpy_was_there_before(before: str, then: str) -> None:
    threads = threads_of_blas(before, then + "\nimport scipy.optimize, scipy.sparse.linalg")
    assert threads
    assert set(threads) == {1}


def test_the_client_leaves_the_threads_of_its_program_alone() -> None:
    assert set(threads_of_blas("import numpy", "import tactiled.client")) == {2}


FORCES = """
import numpy as np
from tactiled.array import load_array
from tactiled.force.calibration import load_calibration
from tactiled.force.estimator import ForceEstimator
from tactiled.samples.block import regular_block
readings = np.random.default_rng(0).normal(0.1, 0.03, (200, 36))
estimator = ForceEstimator(load_array("wang2019-3x3"), load_calibration("wang2019-3x3"))
print(estimator.process(regular_block(readings, 100.0)))
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="names of kinds of x86_64")
def test_forces_are_the_same_bit_by_bit_on_processors_for_which_blas_has_other_code() -> None:
    found = [
        subprocess.run(
            [sys.executable, "-c", FORCES],
            env=os.environ | {"OPENBLAS_CORETYPE": kind}, capture_output=True, check=True, timeout=120,
        ).stdout
        for kind in ("Nehalem", "Haswell")
    ]  # fmt: skip
    assert b"fz_n" in found[0]
    assert found[0] == found[1]


DETECT = """
import numpy  # before tactiled, as in a program that uses it as a library
from pathlib import Path
import sys
from tactiled.offline import detect_file
detect_file(Path(sys.argv[1]))
"""


def test_events_are_the_same_bit_by_bit_on_any_number_of_threads(tmp_path: Path) -> None:
    """The demo's slides over grooves, of which the fits take matrices that BLAS would share out."""
    source = load_board("board-v1", "wang2019-3x3")
    with RecordingWriter(tmp_path / "slide.mcap", Header(source)) as writer:
        for now_s, data in Simulation(load_scene("demo"), source.layout, duration_s=20.5):
            writer.read(Read(now_s, 0.0, data))
    found = [
        subprocess.run(
            [sys.executable, "-c", DETECT, tmp_path / "slide.mcap"],
            env=os.environ | {"OPENBLAS_NUM_THREADS": str(n)}, capture_output=True, check=True, timeout=300,
        ).stdout
        for n in (1, 2)
    ]  # fmt: skip
    assert b'"status": "ok"' in found[0]
    assert found[0] == found[1]
