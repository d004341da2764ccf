"""Virtual machine with emulated USB adapters, a root shell, and a plug for its power."""

import base64
import json
import re
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import Self

from bench.machine.image import CONTROL, Image
from bench.machine.qemu import PATIENCE_S, Qemu
from bench.processes import TACTILED, next_line
from tactiled import child
from tactiled.errors import OperatorError

RATE_HZ = 25.0  # of the boards: the usual 100 Hz would take all of the emulated processor
_MEMORY_MB = 1024
PROCESSORS = 2  # with one, two daemons starting together are too slow for their watchdogs
_END = re.compile(rb"\n\x01(\d+)\x02\n")  # after the output of a command: its exit status


class Board:
    """Emulated board on this host, behind TCP as the other side of an adapter."""

    def __init__(self, folder: Path, serial: str) -> None:
        self.serial = serial
        self._identity = folder / f"{serial}.toml"
        self._identity.write_text(f'board_serial = "{serial}"\nrate_hz = {RATE_HZ}\n')
        self._start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        child.end(self._process)
        assert self._process.stdout is not None
        self._process.stdout.close()

    def restart(self) -> None:
        """Switch the board off and on, as a cut of the power of its host does."""
        self.__exit__()
        self._start()

    def _start(self) -> None:
        command = [*TACTILED, "emulate", "--scene", "rest", "--tcp", "127.0.0.1:0", "--board"]
        self._process = subprocess.Popen(
            [*command, str(self._identity)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.port = json.loads(next_line(self._process))["link"].rpartition(":")[2]


class Guest(Qemu):
    """Virtual machine that runs from `boot` until `cut_power`; its disk lasts as long as the folder.

    Each boot writes into a new layer (qcow2) over what was there. qemu notes in the file which blocks a layer
    has when the guest flushes its disk: after a cut, blocks that were new and not flushed are lost, as in a
    disk with a volatile cache. The folder has layers, sockets, and `share`, which the guest can mount.
    """

    def __init__(self, image: Image, folder: Path) -> None:
        super().__init__()
        self._image, self._folder, self._layer = image, folder, image.disk
        self._layers = 0
        self.share = folder / "share"
        self.share.mkdir(parents=True)

    def boot(self, *boards: Board, masked_unit: str = "") -> None:
        """Switch the power on, with boards plugged in, and wait for the root shell; a masked unit is off."""
        self._layers += 1
        layer = self._folder / f"{self._layers}.qcow2"
        form = "raw" if self._layer == self._image.disk else "qcow2"
        command = ["qemu-img", "create", "-q", "-f", "qcow2", "-F", form, "-b", str(self._layer), str(layer)]
        subprocess.run(command, check=True)
        self._layer = layer
        mask = f" systemd.mask={masked_unit}" if masked_unit else ""
        control = self._folder / "control"
        control.unlink(missing_ok=True)
        self._start(
            ["qemu-system-x86_64", "-accel", "tcg", "-cpu", "max", "-smp", str(PROCESSORS),
             "-m", str(_MEMORY_MB), "-nic", "none",
             "-serial", f"file:{self._folder}/console.log",
             "-kernel", str(self._image.kernel), "-initrd", str(self._image.initrd),
             "-append", f"root=/dev/vda ro console=ttyS0 quiet{mask}",
             "-drive", f"file={layer},if=virtio",
             "-device", "piix3-usb-uhci,id=usb",
             "-virtfs", f"local,path={self.share},mount_tag=share,security_model=none",
             "-chardev", f"socket,id={CONTROL},path={control},server=on,wait=off", "-device", "virtio-serial",
             "-device", f"virtserialport,chardev={CONTROL},name={CONTROL}"],
            self._folder,
        )  # fmt: skip
        self._control = self._connect(control)
        for board in boards:
            self.plug(board)
        self.run("true")

    def copy_disk(self, copy: Path) -> float:
        """Copy the disk as a power cut would leave it now, and return the time of this host at the copy.

        qemu is stopped meanwhile, so that the copy has what its file has after a kill.
        """
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)
        at_s = time.time()
        try:
            shutil.copy(self._layer, copy)
        finally:
            self._process.send_signal(signal.SIGCONT)
        return at_s

    def run(self, command: str, timeout_s: float = PATIENCE_S) -> str:
        """Run a command of the shell in the guest, which must succeed, and return what it printed."""
        self._control.settimeout(timeout_s)
        self._control.sendall(f"( {command}\n) </dev/null 2>&1; printf '\\n\\1%d\\2\\n' $?\n".encode())
        printed = b""
        while (end := _END.search(printed)) is None:
            try:
                more = self._control.recv(65536)
            except TimeoutError:
                more = b""
            if not more:
                raise OperatorError(
                    f"in the guest, no end of {command!r} within {timeout_s:g} s: {printed!r}"
                )
            printed += more
        words = printed[: end.start()].decode(errors="replace").strip()
        if end[1] != b"0":
            raise OperatorError(f"in the guest, {command!r} has exit status {end[1].decode()}: {words}")
        return words

    def until(self, command: str) -> None:
        """Wait until a command of the shell in the guest succeeds, asked every 2 s."""
        self.run(f"until {command} >/dev/null; do sleep 2; done")

    def plug(self, board: Board, socket_number: int = 1) -> None:
        """Plug the adapter of a board into a USB socket of the guest."""
        address = {"type": "inet", "data": {"host": "127.0.0.1", "port": board.port}}
        self.qmp(
            "chardev-add",
            id=board.serial,
            backend={"type": "socket", "data": {"addr": address, "server": False}},
        )
        adapter = {
            "driver": "usb-serial",
            "serial": board.serial,
            "chardev": board.serial,
            "always-plugged": True,
        }
        self.qmp("device_add", id=f"adapter-{board.serial}", port=str(socket_number), **adapter)

    def unplug(self, board: Board) -> None:
        """Pull the adapter of a board out; what the board sends from now on is lost."""
        self.qmp("device_del", id=f"adapter-{board.serial}")
        until_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < until_s:
            with suppress(OperatorError):  # the adapter has not gone yet
                self.qmp("chardev-remove", id=board.serial)
                return
            time.sleep(0.02)
        raise OperatorError(f"qemu does not let the adapter of {board.serial} go")

    def until_suspended(self) -> None:
        """Wait until the guest has suspended itself to memory."""
        until_s = time.monotonic() + PATIENCE_S
        while self.qmp("query-status")["status"] != "suspended":
            if time.monotonic() > until_s:
                raise OperatorError("the guest does not suspend itself")
            time.sleep(0.1)

    def copy_out(self, path: str) -> Path:
        """Copy a file into the folder of this host, also after a suspend, which 9p does not survive."""
        copy = self.share / Path(path).name
        copy.write_bytes(base64.b64decode(self.run(f"base64 -w 0 {path}")))
        return copy

    def mount_share(self) -> None:
        """Mount the shared folder of this host at /mnt in the guest."""
        self.run("mount -t 9p -o trans=virtio,version=9p2000.L share /mnt")
