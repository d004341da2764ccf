"""In the guest: runs each command that the host sends, one JSON line each way."""

import json
import subprocess

with open("/dev/virtio-ports/agent", "r+b", buffering=0) as port:  # noqa: PTH123 - no file, a port
    while line := port.readline():
        done = subprocess.run(json.loads(line), shell=True, capture_output=True, text=True, check=False)
        port.write(json.dumps([done.returncode, done.stdout + done.stderr]).encode() + b"\n")
