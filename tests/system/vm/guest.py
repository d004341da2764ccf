"""A virtual machine with emulated FTDI adapters: its image, its processes, and what the host sees of it."""

import contextlib
import json
import os
import queue
import shutil
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
CHECKOUT = HERE.parents[2]
sys.path.insert(0, str(HERE.parent))
from nspawn import PACKAGES, SUITE, make_wheels  # noqa: E402  (the folder above is no package)

SERIALS = ("TS0001", "TS0002")
ANSWER_S = 120.0  # no KVM: everything is some twenty times slower
MEMORY = "768M"
DISK = "3G"


def make_image(folder: Path) -> None:
    """Kernel, initrd and a disk with tactiled as docs/service.md says; needs root and the network."""
    root, wheels = folder / "root", folder / "wheels"
    make_wheels(wheels, "0.0.1")
    packages = f"{PACKAGES},udev,kmod,linux-image-amd64"
    _run("mmdebstrap", "--quiet", "--variant=minbase", f"--include={packages}", SUITE, str(root))
    shutil.copytree(wheels, root / "wheels", ignore=shutil.ignore_patterns("source*"))
    _run("chroot", str(root), "python3", "-m", "venv", "/opt/tactiled")
    pip = ("/opt/tactiled/bin/pip", "install", "--quiet", "--no-index", "--find-links=/wheels", "tactiled")
    _run("chroot", str(root), *pip)
    # Compiled now: a cold start of numpy and scipy takes minutes without.
    _run("chroot", str(root), "/opt/tactiled/bin/python", "-m", "compileall", "-q", "/opt/tactiled/lib")
    shutil.rmtree(root / "wheels")
    shutil.copy(CHECKOUT / "systemd/tactiled@.service", root / "etc/systemd/system")
    shutil.copy(CHECKOUT / "systemd/99-tactiled.rules", root / "etc/udev/rules.d")
    (root / "etc/sysusers.d").mkdir(exist_ok=True)
    shutil.copy(CHECKOUT / "systemd/tactiled.sysusers", root / "etc/sysusers.d/tactiled.conf")
    _run("chroot", str(root), "systemd-sysusers")
    (root / "etc/tactiled").mkdir()
    for serial in SERIALS:
        (root / f"etc/tactiled/{serial}.toml").write_text(
            f'[port]\nurl = "/dev/tactiled-{serial}"\n[session]\nboard_serial = "{serial}"\n'
            '[publish]\nendpoints = ["ipc://{runtime}/events.ipc"]\n'
            f'[record]\ndirectory = "/var/lib/tactiled/{serial}"\nmin_free_mb = 1.0\n'
        )
    for name in ("agent.py", "watch.py"):
        shutil.copy(HERE / name, root / "opt")
    (root / "etc/systemd/system/agent.service").write_text(
        "[Service]\nExecStart=/usr/bin/python3 /opt/agent.py\nRestart=always\nRestartSec=1\n"
    )
    wants = root / "etc/systemd/system/multi-user.target.wants"
    (wants / "agent.service").symlink_to("../agent.service")
    for name, pattern in (("kernel", "vmlinuz-*"), ("initrd", "initrd.img-*")):
        shutil.copy(next((root / "boot").glob(pattern)), folder / name)
    raw = folder / "disk.raw"
    _run("mkfs.ext4", "-q", "-d", str(root), str(raw), DISK)
    _run("qemu-img", "convert", "-O", "qcow2", str(raw), str(folder / "disk.qcow2"))
    raw.unlink()
    shutil.rmtree(root)
    shutil.rmtree(wheels)


class Board:
    """An emulated board in a process of its own, behind TCP, as the adapter's other side."""

    def __init__(self, folder: Path, serial: str) -> None:
        identity = folder / f"{serial}.toml"
        identity.write_text(f'board_serial = "{serial}"\n')
        command = [sys.executable, "-m", "tactiled", "emulate", "--scene", "rest", "--tcp", "127.0.0.1:0"]
        self._process = subprocess.Popen(
            [*command, "--board", str(identity)], stdout=subprocess.PIPE, text=True, cwd=CHECKOUT
        )
        assert self._process.stdout is not None
        ready = json.loads(self._process.stdout.readline())
        self.port = int(ready["link"].rsplit(":", 1)[1])

    def close(self) -> None:
        self._process.kill()
        self._process.wait()


class Guest:
    """A running machine.

    Parameters
    ----------
    folder : Path
        With what `make_image` left there.
    snapshot : str, optional
        State to start from; left out: a cold boot.
    """

    def __init__(self, folder: Path, snapshot: str | None = None) -> None:
        self._folder = folder
        command = [
            "qemu-system-x86_64", "-accel", "tcg", "-cpu", "max", "-smp", "2", "-m", MEMORY,
            "-display", "none", "-nic", "none", "-no-reboot", "-serial", f"file:{folder}/console.log",
            "-kernel", str(folder / "kernel"), "-initrd", str(folder / "initrd"),
            "-append", "root=/dev/vda rw console=ttyS0 quiet",
            "-drive", f"file={folder}/disk.qcow2,if=virtio",
            "-device", "piix3-usb-uhci,id=usb",  # with xHCI the second replug hangs
            "-device", "virtio-serial",
            "-qmp", f"unix:{folder}/qmp.sock,server=on,wait=off",
        ]  # fmt: skip
        for name in ("agent", "watch"):
            command += ["-chardev", f"socket,id={name},path={folder}/{name}.sock,server=on,wait=off"]
            command += ["-device", f"virtserialport,chardev={name},name={name}"]
        if snapshot is not None:
            command += ["-loadvm", snapshot]
        self._process = subprocess.Popen(command)
        self._qmp = self._connect("qmp")
        self._qmp.readline()
        self.qmp("qmp_capabilities")
        self._agent = self._connect("agent")
        self.seen: queue.Queue[tuple[float, str, str, Any]] = queue.Queue()
        """What `watch` says: guest's clock, serial, what, value."""
        threading.Thread(target=self._watch, args=(self._connect("watch"),), daemon=True).start()

    def _connect(self, name: str) -> Any:
        path = str(self._folder / f"{name}.sock")
        until_s = time.monotonic() + ANSWER_S
        while True:
            link = socket.socket(socket.AF_UNIX)
            try:
                link.connect(path)
            except OSError:
                link.close()
                if time.monotonic() > until_s or self._process.poll() is not None:
                    raise
                time.sleep(0.1)
            else:
                return link.makefile("rwb", buffering=0)

    def _watch(self, stream: Any) -> None:
        with contextlib.suppress(OSError):
            while line := stream.readline():
                with contextlib.suppress(ValueError):  # the first may be cut
                    self.seen.put(tuple(json.loads(line)))

    def qmp(self, command: str, **arguments: Any) -> Any:
        """Ask the machine itself."""
        self._qmp.write(json.dumps({"execute": command, "arguments": arguments}).encode() + b"\n")
        while True:
            answer = json.loads(self._qmp.readline())
            if "error" in answer:
                raise RuntimeError(f"{command}: {answer['error']['desc']}")
            if "return" in answer:
                return answer["return"]

    def monitor(self, line: str) -> None:
        """A command of the human monitor, which is silent when it goes well."""
        if words := self.qmp("human-monitor-command", **{"command-line": line}).strip():
            raise RuntimeError(f"{line}: {words}")

    def run(self, command: str) -> str:
        """Run a shell command in the guest, which must end well."""
        self._agent.write(json.dumps(command).encode() + b"\n")
        code, words = json.loads(self._agent.readline())
        if code != 0:
            raise RuntimeError(f"in the guest, {command}: {words}")
        return str(words)

    def plug(self, board: Board, serial: str, port: int | None = None) -> None:
        """Plug in the adapter of a board; `port` is the socket on the hub."""
        backend = {
            "addr": {"type": "inet", "data": {"host": "127.0.0.1", "port": str(board.port)}},
            "server": False,
        }
        self.qmp("chardev-add", id=serial, backend={"type": "socket", "data": backend})
        where = {} if port is None else {"port": str(port)}
        self.qmp(
            "device_add", driver="usb-serial", id=f"usb-{serial}", chardev=serial, serial=serial,
            **{"always-plugged": True}, **where,
        )  # fmt: skip

    def unplug(self, serial: str) -> None:
        """Pull it out; what the board sends from now on goes nowhere."""
        self.qmp("device_del", id=f"usb-{serial}")
        until_s = time.monotonic() + ANSWER_S
        while True:
            try:
                self.qmp("chardev-remove", id=serial)
            except RuntimeError:  # the adapter still holds it
                if time.monotonic() > until_s:
                    raise
                time.sleep(0.02)
            else:
                return

    def cut_power(self) -> None:
        self._process.kill()
        self._process.wait()


def _run(*command: str) -> None:
    """Run a tool of the host; pip's settings here do not hold in the root that it makes."""
    environ = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "PYTHON"))}
    subprocess.run(command, check=True, timeout=1200, env=environ)
