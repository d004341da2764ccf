"""Recovery of recordings that earlier runs left unfinished, in a separate process.

Recovering a file takes seconds of computing, which would delay the event loop even from a thread (Python runs
one thread at a time). The process has a low priority. `recover` locks each file, so that a file which another
process still writes is not touched.
"""

import contextlib
import logging
import os
import subprocess
import sys
from pathlib import Path

from tactiled.recording.directory import unfinished
from tactiled.recording.rotation import RecordingProgress

logger = logging.getLogger(__name__)

# Niceness of the process: the smallest share of a busy processor that never becomes zero, as that of
# SCHED_IDLE may.
_NICE = 19
_CLOSE_S = 1.0  # a copy that is incomplete then is made again by the next run


class Leftovers:
    """Recover unfinished recordings of a directory each time that recording in it begins.

    Parameters
    ----------
    min_free_mb : float
        A file is not recovered while its copy would leave less free space than this on the disk (10^6 bytes).
    """

    def __init__(self, directory: Path, min_free_mb: float) -> None:
        self._directory = directory
        self._min_free_mb = min_free_mb
        self._was_recording = False
        self._child: subprocess.Popen[bytes] | None = None

    def look(self, progress: RecordingProgress) -> None:
        """Start the process when recording in the directory has begun; never waits for it."""
        if self._child is not None and (code := self._child.poll()) is not None:
            if code != 0:
                logger.warning("%s: not every unfinished recording could be recovered", self._directory)
            self._child = None
        is_recording = progress.state == "recording" and Path(progress.file).parent == self._directory
        if is_recording and not self._was_recording and self._child is None:
            self._start()
        self._was_recording = is_recording

    def close(self) -> None:
        """End the process."""
        if self._child is None:
            return
        self._child.terminate()
        try:
            self._child.wait(_CLOSE_S)
        except subprocess.TimeoutExpired:  # it waits for the disk, and ignores SIGTERM meanwhile
            self._child.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._child.wait(_CLOSE_S)

    def _start(self) -> None:
        try:
            if not (files := unfinished(self._directory)):
                return
            logger.info("recovering %d unfinished recordings in %s", len(files), self._directory)
            command = [sys.executable, "-P", "-m", "tactiled", "recover", str(self._directory)]
            environ = {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}
            self._child = subprocess.Popen(
                [*command, "--min-free-mb", str(self._min_free_mb)],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=environ,
            )  # fmt: skip
        except OSError as error:
            logger.warning("unfinished recordings in %s: not recovered: %s", self._directory, error.strerror)
            return
        with contextlib.suppress(OSError):  # it has ended already
            os.setpriority(os.PRIO_PROCESS, self._child.pid, _NICE)
