"""The Debian package on a kernel of its own with udev and an FTDI adapter: the short form of `bench machine`.

Where qemu-system-x86_64 is missing the test is skipped, also in CI, which does not install it. On two idle
processors, Debian takes 70 s once, package and disk 105 s after each change, and the part 80 s.
"""

import subprocess

import pytest

from bench.machine.bench import bench_machine
from bench.machine.image import make_image
from bench.report import BenchOptions, Table
from tactiled.errors import OperatorError
from tactiled.progress import ProgressBar

pytestmark = [pytest.mark.system, pytest.mark.alone, pytest.mark.timeout(1200)]


def test_users_have_their_rights_and_a_journal_to_read() -> None:
    try:
        make_image("bookworm")
    except (OperatorError, subprocess.SubprocessError) as reason:  # no program, no root, no network
        pytest.skip(f"not tested in a virtual machine: {reason}")
    sections = bench_machine(ProgressBar("machine", None), BenchOptions(parts=("users",)))
    aims = [row for part in sections if isinstance(part, Table) for row in part.rows]
    assert len(aims) == 4
    assert [aim for aim in aims if not aim["measured"].startswith("met: ")] == []
