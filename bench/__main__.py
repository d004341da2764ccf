"""``./run bench NAME``: measure, and print the tables of `docs/measured.md`."""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import click

from bench.report import BenchOptions, as_json
from tactiled.cli import run_command
from tactiled.cli.options import FILE, FILES
from tactiled.progress import ProgressBar

# Name of a bench to its module; each has a function `bench_NAME(progress, options)`.
BENCHES = {
    "clock": "bench.clock",
    "latency": "bench.latency.bench",
    "native": "bench.native.bench",
    "throughput": "bench.throughput.bench",
    "slip": "bench.slip.bench",
    "grip": "bench.grip.bench",
    "hands": "bench.grip.hands",
    "hold": "bench.hold.bench",
    "texture": "bench.texture.bench",
    "recordings": "bench.recordings.bench",
    "web": "bench.web.bench",
    "machine": "bench.machine.bench",
}


@click.command()
@click.argument("name", type=click.Choice(list(BENCHES)), metavar="NAME")
@click.option("--quick", is_flag=True, help="Fewer seeds and cases: about a minute, coarser numbers.")
@click.option("--json", "numbers", type=FILE, help="Also write commit, date, machine and tables.")
@click.option("--data", type=FILES, help="recordings: folder of the checkouts.")
def bench(name: str, quick: bool, numbers: Path | None, data: Path | None) -> None:
    """Measure, and print tables of what was measured.

    clock: errors of the instants of scans. latency: from a scan's last byte to a subscriber, processor
    and memory, beside a C program. native: latency and cost of the client of C++, beside a bare zmq_recv.
    throughput: scans a second, and files in times real time. slip: slip events of every setting, on
    random worlds of two generators, on gratings and over minutes. grip: sliding, margins and forecasts of
    the contact filter on worlds of a generator that it never saw. hands: false alarms of hands that hold,
    over two hours. hold: drops and grip force of a controller that follows the filter's margin, beside
    slip events. texture: errors of groove estimates over the Cramer-Rao bound, and wrong
    answers. recordings: public recordings of other groups, beside simple rules and trees. web: bytes,
    layout shifts, processor and delay of the live page in Chromium. machine: the Debian package in a
    virtual machine with USB adapters: setup, boot, replugs, clock, disk, memory, power cuts.

    Example: ./run bench slip --quick --json slip.json
    """
    if data is not None and name != "recordings":
        raise click.UsageError("--data is for `bench recordings`")
    measure = getattr(import_module(BENCHES[name]), f"bench_{name}")
    with ProgressBar(f"bench {name}", None) as progress:
        sections: Sequence[str] = measure(progress, BenchOptions(quick, data))
    if numbers is not None:
        numbers.write_text(as_json(name, quick, sections))
    click.echo("\n\n".join(sections))


if __name__ == "__main__":
    run_command(bench)
