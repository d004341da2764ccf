"""Disks of the virtual machine: Debian 12 and 13 as a small robot host has them, made once."""

import hashlib
import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from bench.processes import need_programs
from tactiled.errors import OperatorError

SUITES = {"bookworm": "3.11", "trixie": "3.13"}
"""Names of Debian 12 and 13 with the version of their python3."""
# The system, and what the Debian package of tactiled depends on: the guest has no network.
PACKAGES = "linux-image-amd64,initramfs-tools,systemd-sysv,udev,kmod,dbus,procps,python3,libstdc++6"
CONTROL = "control"
"""Name of the virtual serial port to the root shell of the guest."""
_PROGRAMS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "qemu-img": "qemu-utils",
    "mmdebstrap": "mmdebstrap",
    "mke2fs": "e2fsprogs",
    "dpkg-deb": "dpkg",
}
_SIZE = "3G"  # Debian and tactiled take 1.1 GB; recordings pause below 0.5 GB of free space
_DOWNLOAD_S = 600.0  # a host without the network would wait for longer
_SHELL = f"""\
[Unit]
Description=Root shell for the host of this virtual machine
[Service]
ExecStart=/bin/bash -c 'exec <>/dev/virtio-ports/{CONTROL} >&0 2>&1; exec bash'
Restart=always
"""
_FILES = {
    "etc/fstab": "/dev/vda / ext4 defaults 0 1\n",
    "etc/hostname": "machine\n",
    "etc/systemd/system/control.service": _SHELL,
}
_WANTS = f"etc/systemd/system/dev-virtio\\x2dports-{CONTROL}.device.wants/control.service"


@dataclass(frozen=True)
class Image:
    """Disk without tactiled, which is only read, with the kernel and initrd that boot it."""

    disk: Path
    kernel: Path
    initrd: Path


def make_image(suite: str) -> Image:
    """Return the image of a Debian in the cache of this user; make it where there is none like it.

    Raises
    ------
    OperatorError
        A program or the rights of root are missing.
    """
    need_programs(_PROGRAMS)
    digest = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:12]
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "tactiled-machine"
    folder = cache / f"{suite}-{digest}"
    image = Image(folder / "disk.raw", folder / "vmlinuz", folder / "initrd.img")
    if folder.exists():
        return image
    if os.geteuid() != 0:
        raise OperatorError("bench machine makes its disk as root, once: sudo ./run bench machine")
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache) as scratch:
        root, made = Path(scratch, "root"), Path(scratch, "made")
        made.mkdir()
        command = ["mmdebstrap", "--quiet", "--variant=minbase", f"--include={PACKAGES}", suite, str(root)]
        subprocess.run(command, check=True, timeout=_DOWNLOAD_S)
        for name, text in _FILES.items():
            (root / name).write_text(text)
        (root / _WANTS).parent.mkdir()
        (root / _WANTS).symlink_to("../control.service")
        for path in (image.kernel, image.initrd):
            shutil.copy(root / path.name, made)
        disk = made / image.disk.name
        subprocess.run(
            ["mke2fs", "-q", "-t", "ext4", "-d", str(root), str(disk), _SIZE],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        made.rename(folder)
    return image
