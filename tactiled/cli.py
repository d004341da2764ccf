"""The command line. Machine output goes to stdout as JSON lines, everything for people to stderr.

Exit codes: 0 good, 1 the operation failed, 2 usage or configuration. Heavy rooms are imported by the
command that needs them, so that ``--help`` and ``listen`` start at once.
"""

import json
import logging
import os
import sys
from pathlib import Path

import click

from tactiled import __version__
from tactiled.errors import TactiledError

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
FILE = click.Path(path_type=Path, dir_okay=False)
SPEED = click.FloatRange(0, 1000)  # mm/s, as in the configuration; never negative: directions are found
CONFIG_ENV = "TACTILED_CONFIG"


@click.group(context_settings=CONTEXT)
@click.version_option(__version__, prog_name="tactiled")
def cli() -> None:
    """Tactile-sensing daemon: serial taxel arrays in, slip and texture events out.

    Begin with `tactiled demo`: it needs no hardware.
    """


@cli.command()
@click.option("--out", type=FILE, default=Path("demo.png"), show_default=True, help="Picture to write.")
def demo(out: Path) -> None:
    """Run the whole path on an emulated board: three processes, half a minute, a table and a picture.

    Example: tactiled demo --out /tmp/demo.png
    """
    from tactiled.demo import run_demo

    sys.exit(0 if run_demo(out) else 1)


@cli.command()
@click.option("-c", "--config", type=FILE, envvar=CONFIG_ENV, help="tactiled.toml of this board.")
@click.option("-p", "--port", help="Serial port or pyserial URL; takes the place of port.url.")
@click.option("--record", "recording", type=FILE, help="Also record into this file (.mcap).")
@click.option("-v", "--verbose", is_flag=True, help="Log what usually does not matter.")
def run(config: Path | None, port: str | None, recording: Path | None, verbose: bool) -> None:
    """Read the board and publish events until stopped.

    Example: tactiled run --config /etc/tactiled/left.toml
    """
    _use_one_blas_thread()
    from tactiled.config import Setup, default_config, load_config
    from tactiled.daemon.log import set_up
    from tactiled.daemon.recorder import Recorder
    from tactiled.daemon.service import ServiceParams, run_service

    if config is None and port is None:
        raise click.UsageError("say --config FILE, or --port PORT to run with defaults")

    def load() -> Setup:
        return default_config(port or "") if config is None else load_config(config, port)

    def again() -> ServiceParams:
        new = load().config
        for name in ("board", "samples", "detect"):
            if getattr(new, name) != getattr(setup.config, name):
                logging.getLogger("tactiled").warning("[%s] changed: takes effect at the next start", name)
        return new.service

    set_up(10 if verbose else 20)
    setup = load()
    with Recorder(setup.config.record, setup.recording_header(), recording) as recorder:
        code = run_service(
            setup.config.service,
            setup.make_pipeline(),
            setup.layout,
            setup.array,
            None if config is None else again,
            recorder,
        )
    sys.exit(code)


@cli.command()
@click.argument("endpoint", default="tcp://127.0.0.1:9872")
@click.option("-t", "--topic", "topics", multiple=True, help="slip, texture, contact, scan, status, ...")
@click.option("-n", "--count", type=click.IntRange(1), help="Stop after this many messages.")
@click.option(
    "--timeout", "timeout_s", type=click.FloatRange(0), help="Stop after so many seconds; 1 if nothing came."
)
@click.option("--keys", type=FILE, help="Our file of `tactiled keys make`.")
def listen(
    endpoint: str, topics: tuple[str, ...], count: int | None, timeout_s: float | None, keys: Path | None
) -> None:
    """Print what a daemon publishes, one JSON line a message.

    Example: tactiled listen --topic slip --topic texture
    """
    from tactiled.client.listen import listen as run_listener
    from tactiled.events.types import EVENT_TYPES

    if strangers := sorted(set(topics) - set(EVENT_TYPES)):
        raise click.UsageError(f"no topic {', '.join(strangers)}; there are: {', '.join(EVENT_TYPES)}")
    sys.exit(run_listener(endpoint, topics, count=count, timeout_s=timeout_s, keys=keys))


@cli.command()
@click.option(
    "-s", "--scene", default="demo", show_default=True,
    help="Shipped scene, TOML file, plate of the paper, or FAMILY-SEED.",
)  # fmt: skip
@click.option("--link", type=FILE, help="Name under which the emulated serial port appears.")
@click.option("--tcp", help="Listen here instead (host:port), for socket://host:port.")
@click.option("--protocol", default="board-v1", show_default=True, help="Shipped layout or TOML file.")
@click.option("--board", type=FILE, help="TOML of the board: serial number, rate, crystal, ...")
@click.option("--faults", type=FILE, help="TOML of what goes wrong on the line.")
@click.option("--seed", default=0, show_default=True, help="Of the faults.")
@click.option("--scans", is_flag=True, help="Report the true instant of each scan.")
@click.option("--control", help="Where a controller moves the grip: unix:///PATH or tcp://HOST:PORT.")
@click.option("--explain", "explains", is_flag=True, help="Only say which contact model plays it, and why.")
def emulate(
    scene: str,
    link: Path | None,
    tcp: str | None,
    protocol: str,
    board: Path | None,
    faults: Path | None,
    seed: int,
    scans: bool,
    control: str | None,
    explains: bool,
) -> None:
    """Be a board: play a scene on a pty or a TCP port, and tell the truth about it on stdout.

    A name that is not there is answered with all that are. stick-slip-7 is the family stick-slip, seed 7.

    Example: tactiled emulate --scene demo --link /tmp/board
    """
    from tactiled import tomlfile
    from tactiled.emulator.faults import FaultParams
    from tactiled.emulator.identity import BoardParams
    from tactiled.emulator.named import named_scene
    from tactiled.emulator.shell import run_emulator
    from tactiled.wire.layout import load_layout

    played = named_scene(scene)
    if explains:
        from tactiled.emulator.contact import explain

        click.echo(explain(played))
        return
    if (link is None) == (tcp is None):
        raise click.UsageError("say either --link NAME or --tcp HOST:PORT")
    run_emulator(
        played,
        load_layout(protocol),
        link=link,
        tcp=tcp,
        board=None if board is None else tomlfile.load(board, BoardParams),
        faults=None if faults is None else tomlfile.load(faults, FaultParams),
        seed=seed,
        report=lambda what: print(json.dumps(what), flush=True),
        with_scans=scans,
        control=control,
    )


BENCHES = ("clock", "paper", "contact", "soak", "faults", "slip", "texture")


@cli.command()
@click.argument("name", type=click.Choice(BENCHES))
@click.option("--quick", is_flag=True, help="Fewer seeds and cases: about a minute, coarser numbers.")
@click.option("--plot", type=FILE, help="contact, slip, texture: also write a picture.")
@click.option("--json", "numbers", type=FILE, help="slip, texture: also write every number, case by case.")
def bench(name: str, quick: bool, plot: Path | None, numbers: Path | None) -> None:
    """Measure, and print the table that README shows.

    clock: how true are the instants of scans? paper: the published experiments, ours beside theirs. contact:
    what each contact model costs and what it gets wrong. soak: days of board time, every frame accounted for.
    faults: what a line and a board can do wrong, done to a daemon on a pty. slip: how soon a slip is said,
    and how often one that was none. texture: grooves against the Cramer-Rao bound, and what spoils them.

    Example: tactiled bench slip --plot slip.png --json slip.json
    """
    from importlib import import_module

    if plot is not None and name not in ("contact", "slip", "texture"):
        raise click.UsageError("--plot is for `bench contact`, `bench slip` and `bench texture`")
    if numbers is not None and name not in ("slip", "texture"):
        raise click.UsageError("--json is for `bench slip` and `bench texture`")
    measure = getattr(import_module(f"tactiled.bench.{name}"), f"bench_{name}")
    written = {"picture": plot, "numbers": numbers}
    more = {"contact": {"picture": plot}, "slip": written, "texture": written}.get(name, {})
    click.echo(measure(lambda words: click.echo(words, err=True), quick=quick, **more))


@cli.command("fit-material")
@click.argument("file", type=FILE)
@click.option("--level", default=0.95, type=click.FloatRange(0.5, 0.999), show_default=True)
def fit_material(file: Path, level: float) -> None:
    """Fit Yeoh's three constants to a stress-strain curve, and say where the material stays stable.

    FILE is a CSV with a header: `strain` or `stretch`, and `stress_mpa` (nominal, uniaxial). JSON on stdout,
    words on stderr.

    Example: tactiled fit-material rubber.csv
    """
    from tactiled.emulator.mechanics.fit import fit_material_file

    fit = fit_material_file(file, level)
    click.echo(json.dumps(fit.as_map(), allow_nan=False))
    click.echo(fit.in_words(), err=True)


@cli.command("check-config")
@click.argument("file", type=FILE, required=False, envvar=CONFIG_ENV)
@click.option("--schema", is_flag=True, help="Print the JSON Schema of the file, for editors.")
def check_config(file: Path | None, schema: bool) -> None:
    """Check a configuration and all files that it names, without touching the port.

    Example: tactiled check-config /etc/tactiled/left.toml
    """
    from tactiled.config import Config, load_config

    if schema:
        click.echo(json.dumps(Config.model_json_schema(), indent=2))
        return
    if file is None:
        raise click.UsageError("say which FILE, or --schema")
    setup = load_config(file)
    click.echo(json.dumps(setup.config.model_dump(mode="json")))
    click.echo(f"{file}: good ({setup.array.name}, {setup.layout.name})", err=True)


@cli.command()
@click.argument("file", type=FILE)
@click.option("--array", help="Array of the log: shipped name or TOML file. A recording knows its own.")
@click.option("--rate", "rate_hz", type=click.FloatRange(0, min_open=True), help="Scans a second.")
@click.option("--speed", "speed_mm_s", type=SPEED, help="Sliding speed (mm/s), for texture.")
@click.option("--setting", help="Named set of detectors; wang2019: the published methods.")
@click.option("--plot", type=FILE, help="Write a picture of the log and what was found in it.")
def detect(
    file: Path,
    array: str | None,
    rate_hz: float | None,
    speed_mm_s: float | None,
    setting: str | None,
    plot: Path | None,
) -> None:
    """Find slip, contact and texture in a recording, a CSV or an npz file.

    CSV: a header with `time_s`, then one column a channel in channel order, volts. Every event is one
    JSON line on stdout, with times in the file's own clock.

    Example: tactiled detect log.csv --array xyz-two-pads-4x4 --speed 5 --plot log.png
    """
    from tactiled.offline import detect_file

    found = detect_file(file, array, rate_hz, speed_mm_s, setting, plot)
    click.echo(f"{file}: {found} events", err=True)


RECORDINGS = click.argument("files", type=FILE, nargs=-1, required=True)


@cli.command()
@click.argument("file", type=FILE)
@click.option("-c", "--config", type=FILE, envvar=CONFIG_ENV, help="tactiled.toml of this board.")
@click.option("-p", "--port", help="Serial port or pyserial URL; takes the place of port.url.")
@click.option("--seconds", "duration_s", type=click.FloatRange(0, min_open=True), help="Stop after so many.")
def record(file: Path, config: Path | None, port: str | None, duration_s: float | None) -> None:
    """Record a board into FILE (.mcap) without publishing, until stopped.

    Beside a running daemon use its own `[record]` table or `tactiled run --record`: a port has one reader.

    Example: tactiled record slide.mcap --port /dev/ttyUSB0 --seconds 60
    """
    _use_one_blas_thread()
    from tactiled.config import default_config, load_config
    from tactiled.daemon.log import set_up
    from tactiled.daemon.recorder import Recorder
    from tactiled.daemon.service import run_service

    if config is None and port is None:
        raise click.UsageError("say --config FILE, or --port PORT to run with defaults")
    set_up(20)
    setup = default_config(port or "") if config is None else load_config(config, port)
    service = setup.config.service.without_publishing()
    pipeline = setup.make_pipeline()
    with Recorder(setup.config.record, setup.recording_header(), file) as recorder:
        run_service(service, pipeline, setup.layout, setup.array, recorder=recorder, duration_s=duration_s)
    n_scans = pipeline.health().scans
    click.echo(f"{file}: {n_scans} scans", err=True)
    sys.exit(0 if n_scans else 1)


@cli.command()
@RECORDINGS
@click.option("-t", "--topic", "topics", multiple=True, help="slip, texture, contact, scan.")
@click.option(
    "--speed",
    default=0.0,
    type=click.FloatRange(0),
    help="1 is real time; 0, the default, as fast as can be.",
)
@click.option("--verify", is_flag=True, help="Print nothing; compare with the events that were live.")
@click.option(
    "--link", type=FILE, help="Play the bytes on a serial port of this name instead, for any driver."
)
def replay(
    files: tuple[Path, ...], topics: tuple[str, ...], speed: float, verify: bool, link: Path | None
) -> None:
    """Run recordings through the pipeline again and print the events, bit for bit those that were live.

    Parts of a rotated recording belong together: give all of them. With --link the bytes appear on a
    pseudo-terminal instead, with their own timing (or --speed), as soon as a driver opens it.

    Example: tactiled replay slide.mcap --topic slip
    """
    from tactiled.recording.playback import play
    from tactiled.recording.replay import replay as run_again

    if link is not None:
        if verify or topics:
            raise click.UsageError("--link plays bytes; it prints and compares no events")
        source = click.get_current_context().get_parameter_source("speed")
        is_default = source == click.core.ParameterSource.DEFAULT
        played = play(files, link, 1.0 if is_default else speed)
        click.echo(f"{played.n_bytes} bytes played, at most {played.latest_s * 1000:.0f} ms late", err=True)
        return
    verdict = run_again(files, (lambda _: None) if verify else click.echo, topics=topics, speed=speed)
    if verify:
        click.echo(verdict.words(), err=True)
        sys.exit(0 if verdict.is_good else 1)


@cli.command()
@click.argument("file", type=FILE)
@click.option("--out", type=FILE, help="The finished file; default: the name without .active.")
def recover(file: Path, out: Path | None) -> None:
    """Make a recording of all that is whole in one that was cut or damaged; the original is only read.

    Example: tactiled recover slide.mcap.active
    """
    from tactiled.recording.recover import recover as save

    click.echo(save(file, out).words(), err=True)


@cli.command()
@RECORDINGS
@click.option("--csv", "csv_out", type=FILE, help="Write a CSV file.")
@click.option("--npz", "npz_out", type=FILE, help="Write a numpy file.")
def export(files: tuple[Path, ...], csv_out: Path | None, npz_out: Path | None) -> None:
    """Write the scans of recordings as a table; `tactiled detect` reads it back.

    Example: tactiled export slide.mcap --csv slide.csv
    """
    from tactiled.recording.export import export_csv, export_npz

    if csv_out is None and npz_out is None:
        raise click.UsageError("say --csv OUT, --npz OUT or both")
    for out, write in ((csv_out, export_csv), (npz_out, export_npz)):
        if out is not None:
            click.echo(f"{out}: {write(files, out)} scans", err=True)


@cli.command()
@click.argument("name")
@click.argument("fields", nargs=-1, metavar="[FIELD=VALUE]...")
@click.option("--endpoint", default="tcp://127.0.0.1:9872", show_default=True, help="Where it publishes.")
@click.option("--who", default="command line", show_default=True, help="Our name, for the record.")
@click.option("--keys", type=FILE, help="Our file of `tactiled keys make`.")
def command(name: str, fields: tuple[str, ...], endpoint: str, who: str, keys: Path | None) -> None:
    """Ask a running daemon for something, and print its reply as JSON; 1 when it refused.

    NAME is tare, speed, inhibit, expect-load-change, thresholds, rate, record, mark or state; fields:
    protocols/control.md.

    Example: tactiled command thresholds slip.false_alarms_per_hour=0.5
    """
    from tactiled.client.commander import Commander, fields_of

    arguments = fields_of(name, fields)
    with Commander(endpoint, who, keys=keys) as daemon:
        reply = daemon.send(name, **arguments)
    click.echo(json.dumps(reply.data))
    if not reply.ok:
        click.echo(f"{name}: {reply.reason}", err=True)
    sys.exit(0 if reply.ok else 1)


@cli.group()
def keys() -> None:
    """Keys of those who may connect from other hosts: one folder a daemon, named in publish.keys.

    Example: tactiled keys make left-gripper --folder /etc/tactiled/keys
    """


FOLDER = click.option("--folder", type=click.Path(path_type=Path), default=Path("keys"), show_default=True)


@keys.command("make")
@click.argument("name")
@FOLDER
@click.option("--out", type=FILE, help="What the client carries; default: NAME.toml here.")
def keys_make(name: str, folder: Path, out: Path | None) -> None:
    """Make the keys of a client, and the daemon's if there are none. Move the file to the client's host.

    Example: tactiled keys make left-gripper --folder /etc/tactiled/keys
    """
    from tactiled.daemon.security import KeyFolder

    carry = out or Path(f"{name}.toml")
    KeyFolder(folder).make(name, carry)
    click.echo(f"{carry}: for {name}, secret; {folder} lets it in", err=True)


@keys.command("list")
@FOLDER
def keys_list(folder: Path) -> None:
    """Print who may connect, one JSON line a client.

    Example: tactiled keys list --folder /etc/tactiled/keys
    """
    from tactiled.daemon.security import KeyFolder

    folder_keys = KeyFolder(folder)
    click.echo(f"{folder}: the daemon is {folder_keys.pair()[0].decode()}", err=True)
    for key, name in sorted(folder_keys.clients().items(), key=lambda entry: entry[1]):
        click.echo(json.dumps({"name": name, "public_key": key.decode()}))


@cli.command()
@click.option("-c", "--config", type=FILE, envvar=CONFIG_ENV, help="tactiled.toml of this board.")
@click.option("-p", "--port", help="Serial port or pyserial URL; takes the place of port.url.")
@click.option(
    "--speed", "speed_mm_s", type=SPEED, default=0.0, help="Sliding speed (mm/s), for what is resolved."
)
@click.option("--json", "json_lines", is_flag=True, help="One JSON line a check.")
def doctor(config: Path | None, port: str | None, speed_mm_s: float, json_lines: bool) -> None:
    """Check port, board, array, endpoints, disk and installation, and say what to do. 1 if a check fails.

    Example: tactiled doctor --config /etc/tactiled/left.toml
    """
    from tactiled.doctor.examine import run_doctor

    if config is None and port is None:
        raise click.UsageError("say --config FILE, or --port PORT to check with defaults")
    report, code = run_doctor(config, port, json_lines=json_lines, speed_mm_s=speed_mm_s)
    click.echo(report)
    sys.exit(code)


@cli.command()
@click.argument("endpoint", default="tcp://127.0.0.1:9872")
@click.option("--quiet", type=FILE, help="Recording, CSV or npz of an object held still, instead.")
@click.option("--motion", type=FILE, help="The same, moved as in work.")
@click.option(
    "--false-alarms-per-hour", "per_hour", default=1.0, show_default=True,
    type=click.FloatRange(0, 3600, min_open=True), help="How many you put up with.",
)  # fmt: skip
@click.option(
    "--quiet-s", default=20.0, show_default=True, type=click.FloatRange(5, 3600), help="Of the hold."
)
@click.option(
    "--motion-s", default=30.0, show_default=True, type=click.FloatRange(5, 14_400), help="Of the motion."
)
@click.option(
    "--array", help="Array of a table, or of a board whose array is not shipped: name or TOML file."
)
@click.option("--keys", type=FILE, help="Our file of `tactiled keys make`.")
def tune(
    endpoint: str,
    quiet: Path | None,
    motion: Path | None,
    per_hour: float,
    quiet_s: float,
    motion_s: float,
    array: str | None,
    keys: Path | None,
) -> None:
    """Propose slip parameters from your own noise and motion, with false alarms and latency of each setting.

    Listens to a running daemon while you hold an object still, then move it without slip; or takes two files.
    Words and TOML on stderr, all numbers as one JSON line on stdout.

    Example: tactiled tune --quiet hold.mcap --motion carry.mcap
    """
    _use_one_blas_thread()
    from tactiled.tune.run import tune_files, tune_live

    if (quiet is None) != (motion is None):
        raise click.UsageError("say both --quiet FILE and --motion FILE, or neither to record them now")
    if quiet is not None and motion is not None:
        tune_files(quiet, motion, array, per_hour)
    else:
        tune_live(endpoint, quiet_s, motion_s, array, keys, per_hour)


def _use_one_blas_thread() -> None:
    """Before numpy is imported: more would only wake every core for 36 channels, which costs latency."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    """Entry point: every fault of an operator or a board ends in one clear line."""
    try:
        sys.exit(cli.main(standalone_mode=False))
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except click.Abort:
        sys.exit(130)
    except TactiledError as error:
        click.echo(f"tactiled: {error}", err=True)
        sys.exit(error.exit_code)
    except BrokenPipeError:  # the reader of our lines went away: that is how it says "enough"
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(0)
