"""Ten minutes of the example firmware in qemu with resets, and the daemon of this host at the other end."""

import time
from pathlib import Path

from bench.machine.board_in_qemu import (
    RATE_HZ,
    BoardInQemu,
    accounts,
    compile_firmware,
    daemon_on,
    reset_often,
)
from bench.machine.qemu import version
from bench.report import aims_table, load_words, never, table


def soak(folder: Path, duration_s: float, resets: int) -> list[str]:
    """Let the board run for a time with resets spread over it, and account for every scan."""
    with (
        BoardInQemu(compile_firmware(folder), folder) as board,
        daemon_on(board, folder) as daemon,
    ):
        began_s = time.monotonic()
        reset_often(board, daemon, resets, round(duration_s * RATE_HZ / (resets + 1)))
        took_s = time.monotonic() - began_s
        sent, aims = accounts(board, daemon, resets)
    aims.append(never("boots without an answer to set_rate and one to a ping", sent.unanswered))
    counted = {
        "scans sent": len(sent.scans),
        "published": len(daemon.volts),
        "missing, flagged by the firmware": sent.overrun,
        "resets": sent.boots - 1,
        "frames that a reset cut": sent.truncated,
    }
    return [
        f"Example firmware in {version('qemu-system-arm')} (Cortex-M3), daemon of this host with "
        f"{load_words()}; {took_s:.0f} s at {RATE_HZ:g} Hz. A scan that waits in the board at a reset has no "
        "number after it, and is not counted.",
        aims_table(aims),
        table([{name: f"{n:,}" for name, n in counted.items()}]),
    ]
