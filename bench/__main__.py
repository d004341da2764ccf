"""``./run bench NAME``: measure, and print the tables of `docs/measured.md`."""

from importlib import import_module
from pathlib import Path

import click

from bench.report import BenchOptions, BenchReport
from tactiled.cli import run_command
from tactiled.cli.options import FILE, need_extra
from tactiled.progress import ProgressBar

# Name of a bench to its module; each has a function `bench_NAME(progress, options) -> BenchReport`.
BENCHES = {
    "clock": "bench.daemon.clock",
    "faults": "bench.daemon.faults",
    "latency": "bench.latency.bench",
    "throughput": "bench.throughput.bench",
    "boards": "bench.boards.bench",
    "soak": "bench.daemon.soak",
    "paper": "bench.paper.bench",
    "contact": "bench.contact.bench",
    "slip": "bench.slip.bench",
    "grip": "bench.grip.bench",
    "hold": "bench.hold.bench",
    "force": "bench.force.bench",
    "texture": "bench.texture.bench",
    "sensors": "bench.sensors.bench",
    "web": "bench.web.bench",
    "ros2": "bench.ros2",
    "fleet": "bench.fleet.bench",
}
WITH_PLOT = ("contact", "slip", "grip", "hold", "force", "texture")
WITH_ABLATION = ("grip",)
WITH_JOBS = ("force", "grip", "hold", "slip", "texture")
WITH_JSON = ("slip", "force", "texture", "sensors", "web")


@click.command()
@click.argument("name", type=click.Choice(list(BENCHES)))
@click.option("--quick", is_flag=True, help="Fewer seeds and cases: about a minute, coarser numbers.")
@click.option("--plot", type=FILE, help=f"{', '.join(WITH_PLOT)}: also write a picture.")
@click.option("--json", "numbers", type=FILE, help=f"{', '.join(WITH_JSON)}: also write every number.")
@click.option("--ablate", is_flag=True, help="grip: also without each part of the model, a few minutes more.")
@click.option(
    "--dask", metavar="ADDRESS", help=f"{', '.join(WITH_JOBS)}: use the workers of this Dask scheduler."
)
def bench(
    name: str, quick: bool, plot: Path | None, numbers: Path | None, ablate: bool, dask: str | None
) -> None:
    """Measure, and print tables of what was measured.

    clock: errors of the instants of scans. paper: the published experiments, ours beside theirs. contact:
    cost and errors of each contact model. latency: from a scan's last byte to a subscriber, beside a C
    program. throughput: scans a second, files in times real time, processor and memory. boards: cost,
    memory and latency of many boards in one process, by their number. soak: days of board time, every
    frame accounted for. faults: faults of line and board, done to a daemon on a pty. slip: detection
    latency and false alarms. grip: margins and forecasts of the contact model over worlds drawn at
    random. hold: drops and grip force of a controller that follows the contact model's margin, beside
    fixed grips and slip events. force: errors of calibrated forces on rigs drawn at random, beside ridge
    regression and the bound. texture: errors of groove estimates over the Cramer-Rao bound, and windows
    that break the model. sensors: slides of six kinds of sensor in their own units, beside the strongest
    line of a spectrum. web: delays of the live page in a browser, and what server and page cost. ros2:
    delay and cost of the bridge to ROS 2. fleet: losses over cut links, delays and bytes of many boards
    through two routers of zenoh.

    Example: ./run bench slip --plot slip.png --json slip.json
    """
    for option, file, names in (("--plot", plot, WITH_PLOT), ("--json", numbers, WITH_JSON)):
        if file is not None and name not in names:
            raise click.UsageError(f"{option} is for {', '.join(f'`bench {one}`' for one in names)}")
    if ablate and name not in WITH_ABLATION:
        raise click.UsageError(f"--ablate is for {', '.join(f'`bench {one}`' for one in WITH_ABLATION)}")
    if dask is not None and name not in WITH_JOBS:
        raise click.UsageError(f"--dask is for {', '.join(f'`bench {one}`' for one in WITH_JOBS)}")
    if plot is not None:
        need_extra("matplotlib", "plot", "bench --plot")
    measure = getattr(import_module(BENCHES[name]), f"bench_{name}")
    options = BenchOptions(quick, plot, numbers, ablate, dask)
    with ProgressBar(f"bench {name}", None) as progress:
        report: BenchReport = measure(progress, options)
    report.write(options)
    click.echo(report.text)


if __name__ == "__main__":
    run_command(bench)
