"""``./run bench NAME``: measure, and print the tables that `docs/` shows."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import click

from bench.report import BenchOptions, as_json
from tactiled.cli import run_command
from tactiled.cli.options import FILE, FILES
from tactiled.progress import ProgressBar

_WORLDS = ("tactiled/detect", "bench/worlds", "bench/hold", "packages/emulator")
_FILTER = (*_WORLDS, "config/learnt")
_ANSWERS = "bench.worlds.answers"
_LIVE = ("tactiled/daemon", "tactiled/detect", "packages/client/tactiled/events")


class Bench(NamedTuple):
    """Module with `bench_NAME(progress, options)`, and the paths of what measures and of what is measured."""

    module: str
    code: tuple[str, ...]
    answers: str = ""
    """Module with `answers()` to a few inputs, which a test compares with those of a figure."""


BENCHES = {
    "clock": Bench("bench.clock", ("tactiled/samples", "tactiled/wire", "bench/clock.py"), "bench.clock"),
    "latency": Bench("bench.latency.bench", (*_LIVE, "bench/latency")),
    "native": Bench("bench.native.bench", ("protocols/cpp", "bench/native")),
    "throughput": Bench("bench.throughput.bench", (*_LIVE, "bench/throughput")),
    "slip": Bench("bench.slip.bench", (*_FILTER, "bench/slip"), _ANSWERS),
    "grip": Bench("bench.grip.bench", (*_WORLDS, "bench/train", "bench/grip"), _ANSWERS),  # it trains its own
    "hands": Bench("bench.grip.hands", (*_FILTER, "bench/grip", "bench/slip/cases.py"), _ANSWERS),
    "hold": Bench(
        "bench.hold.bench",
        (*_FILTER, "packages/client/tactiled/client/grip_controller.py"),
        "bench.hold.answers",
    ),
    "texture": Bench("bench.texture.bench", ("tactiled/detect", "bench/texture"), "bench.texture.answers"),
    "recordings": Bench(
        "bench.recordings.bench",
        ("tactiled/detect", "tactiled/force", "packages/calibration", "config/learnt", "bench/recordings"),
    ),
    "machine": Bench(
        "bench.machine.bench",
        ("tactiled", "packages/debian", "protocols/c", "systemd", "hatch_build.py", "bench/machine"),
    ),
}


@click.command()
@click.argument("name", type=click.Choice(list(BENCHES)), metavar="NAME")
@click.option("--quick", is_flag=True, help="Fewer seeds and cases: about a minute, coarser numbers.")
@click.option("--json", "numbers", type=FILE, help="Also write a figure: commit, date, machine and tables.")
@click.option("--data", type=FILES, help="recordings: folder of the checkouts.")
@click.option("--only", "parts", multiple=True, metavar="PART", help="machine: only this part.")
def bench(name: str, quick: bool, numbers: Path | None, data: Path | None, parts: tuple[str, ...]) -> None:
    """Measure, and print tables of what was measured.

    clock: errors of the instants of scans. latency: from a scan's last byte to a subscriber, processor
    and memory, beside a C program. native: latency and cost of the client of C++, beside a bare zmq_recv,
    and latency of the ROS 2 node where a workspace with it is sourced. throughput: scans a second, and
    files in times real time. slip: slip events of every setting, on worlds of two generators, on
    gratings and over minutes. grip: sliding, margins and forecasts of the contact filter on worlds of a
    generator that it never saw. hands: false alarms of hands that hold, over two hours. hold: drops and
    grip force of a controller that follows the filter's margin. texture: errors of groove estimates over
    the Cramer-Rao bound, and wrong answers. recordings: public recordings of other groups, beside simple
    rules and trees. machine: the Debian package in a virtual machine with USB adapters, in the parts
    setup, users, usb, clock, suspend, shortage, power, boot, newer; its package for aarch64; firmware.

    Example: ./run bench slip --quick --json docs/figures/slip.json
    """
    if data is not None and name != "recordings":
        raise click.UsageError("--data is for `bench recordings`")
    if parts and name != "machine":
        raise click.UsageError("--only is for `bench machine`")
    if numbers is not None and not numbers.parent.is_dir():
        raise click.UsageError(f"--json: there is no folder {numbers.parent}")
    measure = getattr(import_module(BENCHES[name].module), f"bench_{name}")
    with ProgressBar(f"bench {name}", None) as progress:
        sections: Sequence[str] = measure(progress, BenchOptions(quick, data, parts))
    click.echo("\n\n".join(sections))
    if numbers is not None:
        only = [f"--only {part}" for part in parts]
        words = ["./run bench", name, *["--data DIR"] * (data is not None), *only, *["--quick"] * quick]
        command = " ".join(words)
        source = BENCHES[name].answers
        answers = import_module(source).answers() if source else None
        numbers.write_text(as_json(command, BENCHES[name].code, sections, answers), "utf-8")


if __name__ == "__main__":
    run_command(bench)
