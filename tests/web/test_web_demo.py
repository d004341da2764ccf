"""``tactiled demo --web`` as a user starts it."""

import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest
from patience import PATIENCE_S

pytestmark = pytest.mark.system


def test_the_demo_serves_a_page_until_ctrl_c(tmp_path: Path) -> None:
    words = tmp_path / "words"
    with words.open("wb") as err:
        command = [sys.executable, "-m", "tactiled", "demo", "--web", "--no-browser", "--port", "0"]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=err) as demo:
            try:
                until_s = time.monotonic() + PATIENCE_S
                while (found := re.search(r"http://127\.0\.0\.1:\d+/", words.read_text())) is None:
                    assert time.monotonic() < until_s, words.read_text()
                    time.sleep(0.1)
                with urllib.request.urlopen(found[0]) as answer:
                    assert b"tactiled" in answer.read()
                demo.send_signal(signal.SIGINT)
                assert demo.wait(PATIENCE_S) in (0, 130), words.read_text()
            finally:
                if demo.poll() is None:
                    demo.kill()
    assert "Traceback" not in words.read_text()
