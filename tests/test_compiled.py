"""The compiled path: the same bits as plain Python, built by the hook, refused where it is stale."""

import importlib.util
import itertools
import os
import re
import shutil
import subprocess
import sys
from array import array as array_of
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touches import Touch, run, splits

from tactiled import compiled
from tactiled.array import Array, ArrayFile, Channel, TaxelPlace, build, load_array
from tactiled.detect.signal import front_end, pressure
from tactiled.detect.signal.contact_gate import ContactParams, ContactTracker
from tactiled.detect.signal.fast import Readings
from tactiled.detect.signal.front_end import response_weights
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.suite import DetectParams, build_suite
from tactiled.samples.block import ScanBlock, regular_block
from tactiled.wire import framing, good_scans
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Scan
from tactiled.wire.framing import make_framer
from tactiled.wire.layout import Layout, load_layout

ROOT = Path(__file__).resolve().parent.parent
ARRAYS = [load_array(name) for name in ("wang2019-3x3", "normal-4x4", "xyz-two-pads-4x4")]

needs_compiled = pytest.mark.skipif(
    bool(compiled.reason_plain) and "TACTILED_CI" not in os.environ,
    reason=f"no compiled path: {compiled.path_words()}",
)
every_array = pytest.mark.parametrize("array", ARRAYS, ids=[array.name for array in ARRAYS])


def both(plain: ModuleType) -> list[ModuleType]:
    """Return a plain module and its compiled form."""
    found = compiled.compiled_module(plain.__name__)
    assert found is not None
    return [plain, found]


def touched(array: Array, seed: int) -> ScanBlock:
    """Return a slide with noise, missing and impossible readings, and a channel that sticks."""
    rng = np.random.default_rng(seed)
    rate_hz = float(rng.choice([35.7, 100.0, 400.0]))
    block = Touch(grooves=(2.0, 20.0), speed_mm_s=4.0, ripple=0.1).block(
        array, rate_hz, np.linspace(0, 0.5 / rate_hz, array.n_channels)
    )
    volts = block.volts + rng.choice([0.0, 1e-4, 5e-3]) * rng.standard_normal(block.volts.shape)
    spoiled = rng.random(volts.shape) < rng.choice([0.0, 1e-4, 1e-2])
    volts[spoiled] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -5.0, 0.0], spoiled.sum())
    if rng.random() < 0.5:
        channel, since = rng.integers(array.n_channels), rng.integers(1, len(volts))
        volts[since:, channel] = volts[since, channel]
    valid = rng.random(volts.shape) > rng.choice([0.0, 1e-3])
    offset_s = rng.choice([0.0, 1.0]) * np.linspace(0, 0.5 / rate_hz, array.n_channels)
    return regular_block(volts, rate_hz, valid=valid, channel_offset_s=offset_s)


def is_same(one: object, other: object) -> bool:
    """Compare numbers by their bits, except that there is one zero."""
    return np.array_equal(np.asarray(one), np.asarray(other), equal_nan=True)


@needs_compiled
@every_array
@given(seed=st.integers(0, 2**32), data=st.data())
@settings(max_examples=5, deadline=None)
def test_rounding_stuck_channels_and_filters(array: Array, seed: int, data: st.DataObject) -> None:
    rng, n, n_channels = np.random.default_rng(seed), 300, array.n_channels
    readings = rng.standard_normal((n, n_channels))
    spoiled = rng.random(readings.shape) < 0.05
    readings[spoiled] = rng.choice([np.nan, np.inf, -np.inf, 1e308, -9.0, 8.0], spoiled.sum())
    readings[rng.integers(150, 200) :, : rng.integers(1, n_channels)] = 0.5
    valid = (rng.random(readings.shape) < 0.97).astype(np.uint8)
    taps = [rng.integers(-9, 9, length).astype(np.float64) for length in (2, 6)]
    cuts = [0, *data.draw(splits(n)), n]
    found = []
    for one, gate in zip(both(front_end), both(pressure), strict=True):
        hold = gate.Hold(array)
        search = one.StuckChannels(array, hold.volts_per_step)
        bank = one.Bank(n_channels, taps)
        rows, out = np.zeros((5 + n) * n_channels), np.zeros(n * 2 * n_channels)
        ok, stuck = np.zeros((2, n * n_channels), dtype=np.uint8)
        answers: list[object] = []
        for start, end in itertools.pairwise(cuts):
            flat, kept = slice(start * n_channels, end * n_channels), rows[(5 + start) * n_channels :]
            n_piece = end - start
            answers.append(hold.take(n_piece, readings.ravel()[flat], valid.ravel()[flat], kept, ok[flat]))
            answers.append(search.take(n_piece, 0, kept, stuck[flat]))
            bank.take(n_piece, 5 + start, rows, out[2 * start * n_channels :])
        found.append([rows, ok, stuck, out, answers])
    assert all(map(is_same, *found))


@needs_compiled
@given(seed=st.integers(0, 2**32), is_field=st.booleans(), data=st.data())
@settings(max_examples=15, deadline=None)
def test_pressure(seed: int, is_field: bool, data: st.DataObject) -> None:
    rng, n, taxels = np.random.default_rng(seed), 40, 3
    rate_hz = float(rng.choice([17.0, 25.0]))  # too slow to tell wandering from noise, or not
    pad = build(
        ArrayFile(
            name="pad",
            unit="uT" if is_field else "V",
            range=(-1000.0, 1000.0),
            zero="first 0.5 s",
            taxels=[TaxelPlace(x_mm=k, y_mm=0.0, pad=k % 2) for k in range(taxels)],
            channels=[
                Channel(
                    name=str(k),
                    kind="shear_x" if is_field and k == 0 else "normal",
                    sign=-1 if rng.random() < 0.5 else 1,
                    taxel=int(rng.integers(taxels)),
                )
                for k in range(12)
            ],
        )
    )
    volts = rng.integers(-1000, 1000, n * 12) / 4.0
    volts[rng.random(n * 12) < rng.choice([0.0, 0.01])] = rng.choice([np.nan, np.inf, 1e9])
    valid = (rng.random(n * 12) > rng.choice([0.0, 0.01])).astype(np.uint8)
    given_levels = rng.uniform(1, 100, 3) * rng.integers(0, 2, 3)
    cuts = [0, *data.draw(splits(n)), n]
    gap = data.draw(st.sampled_from(cuts))  # before which scans are missing
    found = []
    for one in both(pressure):
        of = one.Pressure(pad, rate_hz, one.Levels(*given_levels, 1.0), 5.0)
        answers: list[object] = []
        for start, end in itertools.pairwise(cuts):
            if start == gap:
                of.interrupt(400)
            flat, some = slice(start * 12, end * 12), end - start
            of.take(some, volts[flat], valid[flat])
            answers += [np.array(of.steps)[: some * 12], np.array(of.ok)[: some * 12]]
            answers += [
                np.array(of.slope)[:some],
                np.array(of.loading)[:some],
                np.array(of.touched)[: 3 * some],
            ]
            answers += [(of.step(scan), len(of.state), len(of.previous)) for scan in range(some)]
            answers += [np.array(of.set), np.array(of.rest.noise), np.array(of.swing.power)]
        found.append(answers)
    assert all(map(is_same, *found))


@needs_compiled
@given(seed=st.integers(0, 2**32))
@settings(max_examples=15, deadline=None)
def test_jumps_relieved_sides_and_noise(seed: int) -> None:
    array, taxels, channels = ARRAYS[0], 9, 36
    found = []
    for one in both(front_end):
        draw = np.random.default_rng(seed)
        jumps = one.Jumps(array)
        relief = one.RelievedSides(array)
        floor = one.NoiseFloor(channels, 1e-6, 10.0)
        answers: list[object] = []
        for k in range(40):
            readings = array_of(
                "d", 1.0 + (draw.random(channels) < 0.03) + 1e-4 * draw.standard_normal(channels)
            )
            loads = array_of("d", draw.uniform(0.0, 1.0, taxels))
            jumps.take(readings, 0, loads, floor.sd, k > 5)
            answers += [list(jumps.found), list(jumps.accepted)]
            response = array_of("d", np.concatenate([loads, draw.standard_normal(2 * taxels)]))
            relief.correct(array_of("d", draw.uniform(-0.2, 2.0, channels)), 0, response)
            answers += [list(response), list(relief.relieved)]
            floor.take(readings, array_of("d", 1e-4 * draw.standard_normal(2 * channels)))
            answers.append(list(floor.sd))
        found.append(answers)
    assert all(map(is_same, *found))


_EVENTS = """
import sys
sys.path[:0] = [{helpers!r}, {tests!r}]
from test_compiled import ARRAYS, play
for line in play(ARRAYS[int(sys.argv[1])], 1):
    print(line)
"""


def play(array: Array, seed: int) -> list[str]:
    """Return the events of both settings for a slide with faults."""
    block = touched(array, seed)
    block = block[: round(3 * block.rate_hz)]
    cuts = np.random.default_rng(seed).integers(0, len(block), 12).tolist()
    pieces_of = [block[a:b] for a, b in itertools.pairwise([0, *sorted(cuts), len(block)]) if a < b]
    suites = [build_suite(array, DetectParams(setting=setting)) for setting in ("balanced", "wang2019")]
    words = [repr(event) for suite in suites for event in run(suite, pieces_of)]
    return [re.sub(r"np\.float64\(([^()]*)\)", r"\1", one) for one in words]


@needs_compiled
@pytest.mark.parametrize("number", range(len(ARRAYS)), ids=[array.name for array in ARRAYS])
def test_events_are_those_of_plain_python(number: int) -> None:
    script = _EVENTS.format(helpers=str(ROOT / "tests" / "helpers"), tests=str(ROOT / "tests"))
    done = subprocess.run(
        [sys.executable, "-c", script, str(number)],
        env=os.environ | {compiled.SETTING: "0", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    wanted = play(ARRAYS[number], 1)
    assert wanted
    assert done.stdout.splitlines() == wanted


@every_array
@given(seed=st.integers(0, 2**32))
@settings(max_examples=6, deadline=None)
def test_steps_are_those_of_numpy(array: Array, seed: int) -> None:
    block, grid = touched(array, seed), Quantiser(array)
    held = grid.process(block)
    ok = block.valid & (np.abs(block.volts) <= grid.full_scale_volts)
    newest = np.maximum.accumulate(np.where(ok, np.arange(1, len(block) + 1)[:, np.newaxis], 0), axis=0)
    limit = grid.full_scale_volts
    rounded = np.rint(np.clip(block.volts, -limit, limit) / grid.volts_per_step)  # a power of two: exact
    steps = np.concatenate([np.zeros((1, array.n_channels)), rounded])
    np.testing.assert_array_equal(held.steps, np.take_along_axis(steps, newest, axis=0))
    np.testing.assert_array_equal(held.ok, ok)
    assert held.all_ok == ok.all()


def test_loads_and_noise_are_those_of_matrices() -> None:
    array, rng, n = ARRAYS[2], np.random.default_rng(0), 400
    volts = 1.0 + 1e-2 * rng.standard_normal((n, array.n_channels))
    gate, block = ContactTracker(array, ContactParams(), 100.0), regular_block(volts, 100.0)
    readings, weights = Readings(array, 100.0, gate.volts_per_step), response_weights(array)
    gate.measure(block)
    readings.follow(gate, block.channel_offset_s)
    for scan in range(n):
        readings.take(scan, True, False)
        np.testing.assert_allclose(readings.recent[-1], weights @ volts[scan], atol=1e-5)
    loads, *shears = np.einsum("ktc,nc->knt", weights, volts)
    assert readings.load_sd == pytest.approx(loads.mean(axis=1).std(), rel=0.2)
    assert readings.total_sd == pytest.approx(np.mean([s.sum(axis=1).std() for s in shears]), rel=0.2)
    assert readings.shear_sd == pytest.approx(np.mean([s.std() for s in shears]), rel=0.2)


@pytest.fixture(scope="module")
def layouts(tmp_path_factory: pytest.TempPathFactory) -> list[Layout]:
    """Layout of the board, and one with another byte order, narrow and signed numbers and no ticks."""
    text = (ROOT / "protocols" / "board-v1.toml").read_text()
    scan, rest = text.split('name = "scan"')[1].split("[[messages]]", 1)
    for old, new in (("u16", "u8"), ("u32", "u16"), ('"counts", type = "u8"', '"counts", type = "i16"')):
        scan = scan.replace(old, new)
    scan = "\n".join(line for line in scan.splitlines() if '"ticks"' not in line)
    text = text.split('name = "scan"')[0] + f'name = "scan"{scan}\n[[messages]]{rest}'
    path = tmp_path_factory.mktemp("layouts") / "other.toml"
    path.write_text(text.replace('"little"', '"big"').replace("ibm-3740", "xmodem"))
    return [load_layout("board-v1"), load_layout(str(path))]


@needs_compiled
@given(data=st.data())
@settings(max_examples=50, deadline=None)
def test_frames_are_those_of_python(layouts: list[Layout], data: st.DataObject) -> None:
    layout = data.draw(st.sampled_from(layouts))
    readers = [None, *(one.GoodScans for one in both(good_scans))]
    decoders = []
    for reader in readers:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(framing, "_READER", reader)
            decoders.append(Decoder(layout))
    stream = data.draw(streams(layout))
    for piece in data.draw(st.lists(st.integers(0, max(len(stream), 1))).map(lambda cuts: cut(stream, cuts))):
        wanted, *found = (decoder.feed(piece) for decoder in decoders)
        assert found == [wanted, wanted]
    counted = [
        (d.framer.bytes_in, d.framer.bytes_framed, d.framer.bytes_discarded, d.framer.bytes_pending)
        for d in decoders
    ]
    assert len(set(counted)) == 1


@needs_compiled
def test_scans_of_both_layouts_are_read_in_one_pass(layouts: list[Layout]) -> None:
    for layout in layouts:
        scan = Scan(200, np.arange(36), None if layout.tick_s is None else 7, 5)
        framer = make_framer(layout, "board-to-host")
        assert list(framer.feed(2 * Encoder(layout).encode(scan))) == [scan, scan]


def cut(stream: bytes, cuts: list[int]) -> list[bytes]:
    bounds = [0, *sorted(cuts), len(stream)]
    return [stream[a:b] for a, b in itertools.pairwise(bounds)]


@st.composite
def streams(draw: st.DrawFn, layout: Layout) -> bytes:
    """Draw good frames, damaged ones, and noise."""
    encoder = Encoder(layout)
    least = -1 if layout.messages["scan"].dtype["counts"].base.kind == "i" else 0
    counts = st.lists(st.sampled_from([least, 0, 1, 255, 256, 4095]), min_size=36, max_size=36)
    answer = encoder.encode(Acknowledge(1, "ping", "ok", ticks=5))
    parts = []
    for number in range(draw(st.integers(0, 6))):
        frame = encoder.encode(Scan(number, np.array(draw(counts)), ticks=number * 1000))
        kind = draw(st.sampled_from(["good", "answered", "damaged", "short", "noise", "idle"]))
        if kind == "damaged":
            at = draw(st.integers(0, len(frame) - 1))
            frame = frame[:at] + bytes([draw(st.integers(0, 255))]) + frame[at + 1 :]
        elif kind == "short":
            frame = frame[: draw(st.integers(0, len(frame)))]
        elif kind == "answered":
            frame += answer
        parts.append(draw(st.binary(max_size=200)) if kind == "noise" else b"\0" if kind == "idle" else frame)
    return b"".join(parts)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Folder with one plain module that has types of C, and the list of it."""
    package = tmp_path / "tactiled"
    package.mkdir()
    shutil.copy(ROOT / "tactiled" / "compiled.py", package)
    (package / "small.py").write_text("def twice(x):\n    return 2 * x\n")
    (package / "small.pxd").write_text("cpdef double twice(double x)\n")
    text = (package / "compiled.py").read_text()
    first, last = text.index("MODULES = ("), text.index("SETTING =")
    (package / "compiled.py").write_text(f'{text[:first]}MODULES = ("tactiled.small",)\n{text[last:]}')
    return tmp_path


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@needs_compiled
def test_the_hook_compiles_a_module_and_one_of_another_source_is_refused(tree: Path) -> None:
    hook, names = load(ROOT / "hatch_build.py"), load(tree / "tactiled" / "compiled.py")
    assert "without a C compiler" in names.why_plain()
    (library,) = hook.compile_modules(tree)
    assert names.why_plain() == ""
    assert names.compiled_module("tactiled.small").twice(2) == 4.0
    source = tree / "tactiled" / "small.py"
    source.write_text(source.read_text() + "# changed\n")
    assert "install again" in names.why_plain()
    assert names.compiled_module("tactiled.small") is None
    assert hook.compile_modules(tree) != [library]
    assert not library.exists()


@needs_compiled
def test_the_hook_removes_old_libraries_and_nothing_else(tree: Path) -> None:
    """A library that another process is about to finish, and a source with a longer name, stay."""
    hook, names = load(ROOT / "hatch_build.py"), load(tree / "tactiled" / "compiled.py")
    source = tree / "tactiled" / "small.py"
    library = names.module_library(source)
    old = library.with_name(library.name.replace("_small_", "_small_0"))
    others = {library.with_suffix(".12345"), source.with_name("_small_parts.py")}
    for path in (old, *others):
        path.touch()
    assert hook.compile_modules(tree) == [library]
    assert set(source.parent.glob("_small_*")) == {library, *others}


@pytest.mark.parametrize("compiler", ["no-such-compiler", "false"])
def test_without_a_compiler_scans_take_plain_python(
    tree: Path, compiler: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hook, names = load(ROOT / "hatch_build.py"), load(tree / "tactiled" / "compiled.py")
    monkeypatch.setenv("CC", compiler)
    assert hook.compile_modules(tree) == []
    assert "plain Python" in capsys.readouterr().err
    assert names.compiled_module("tactiled.small") is None


def test_the_environment_forces_plain_python() -> None:
    done = subprocess.run(
        [sys.executable, "-c", "from tactiled import compiled; print(compiled.path_words())"],
        env={compiled.SETTING: "0", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "plain Python (TACTILED_COMPILED=0)\n"
