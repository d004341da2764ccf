"""The compiled path: the same bits as numpy, built by the hook, refused where it is stale."""

import importlib.util
import itertools
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touches import Touch, pieces, run, splits

from tactiled import compiled
from tactiled.array import Array, load_array
from tactiled.detect.contact.detector import GripDetector
from tactiled.detect.contact.readings import taxel_readings
from tactiled.detect.signal.contact import ContactParams, ContactTracker
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.signal.stuck_channels import StuckChannelDetector
from tactiled.detect.signal.wavelet import SwtBank
from tactiled.samples.block import ScanBlock, regular_block
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Scan
from tactiled.wire.framing import make_framer
from tactiled.wire.layout import Layout, load_layout

ROOT = Path(__file__).resolve().parent.parent
ARRAYS = [load_array(name) for name in ("wang2019-3x3", "normal-4x4", "xyz-two-pads-4x4")]

needs_library = pytest.mark.skipif(
    compiled.path.functions is None, reason=f"no compiled path: {compiled.path.words}"
)
every_array = pytest.mark.parametrize("array", ARRAYS, ids=[array.name for array in ARRAYS])


@contextmanager
def on_numpy() -> Iterator[None]:
    """Make objects without the compiled path."""
    before, compiled.path = compiled.path, compiled.CompiledPath(None, "a test")
    try:
        yield
    finally:
        compiled.path = before


def of_both(make: Callable[[], Any]) -> tuple[Any, Any]:
    """Return what `make` makes, with the compiled path and on numpy."""
    with on_numpy():
        plain = make()
    return make(), plain


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


def is_same(one: Any, other: Any) -> bool:
    """Compare numbers by their bits, except that there is one zero."""
    return np.array_equal(np.asarray(one), np.asarray(other), equal_nan=np.asarray(one).dtype.kind == "f")


@needs_library
@every_array
@given(seed=st.integers(0, 2**32), data=st.data())
@settings(max_examples=6, deadline=None)
def test_readings_contact_bank_and_stuck_channels_have_the_bits_of_numpy(
    array: Array, seed: int, data: st.DataObject
) -> None:
    block = touched(array, seed)
    params = ContactParams(contact_volts=0.2, release_volts=0.1, loading_volts_s=0.05)
    given_levels = data.draw(st.booleans())
    quantisers = of_both(lambda: Quantiser(array))
    stuck_channels = of_both(lambda: StuckChannelDetector(array))
    gates = of_both(lambda: ContactTracker(array, params if given_levels else ContactParams(), block.rate_hz))
    banks = of_both(lambda: SwtBank(array))
    for piece in pieces(block, data.draw(splits(len(block)))):
        held, plain = (quantiser.process(piece) for quantiser in quantisers)
        assert is_same(held.steps, plain.steps)
        assert is_same(held.ok, plain.ok)
        assert held.all_ok == plain.all_ok
        stuck, plain_stuck = (detector.process(plain.steps) for detector in stuck_channels)
        assert is_same(stuck, plain_stuck)
        found, wanted = (gate.measure(piece, plain, stuck) for gate in gates)
        for name, value in vars(wanted).items():
            assert is_same(getattr(found, name), value), name
        for start in range(0, len(piece), 1024):
            one, other = (bank.filter_steps(plain.steps[start : start + 1024]) for bank in banks)
            assert is_same(one, other)


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


@needs_library
@every_array
@given(seed=st.integers(0, 2**32), data=st.data())
@settings(max_examples=6, deadline=None)
def test_loads_and_noise_of_a_contact_have_the_bits_of_numpy(
    array: Array, seed: int, data: st.DataObject
) -> None:
    block = touched(array, seed)
    block = block[: round(4 * block.rate_hz)]
    rng = np.random.default_rng(seed)
    both = of_both(lambda: taxel_readings(array, block.rate_hz))
    in_contact = is_pressed = False
    for piece in pieces(block, data.draw(splits(len(block)))):
        for readings in both:
            readings.begin(piece)
        for scan in range(len(piece)):
            is_pressed = in_contact and (is_pressed or bool(rng.random() < 0.1))
            found, wanted = (
                readings.take(scan, in_contact=in_contact, is_pressed=is_pressed) for readings in both
            )
            assert found == wanted
            for name in ("history", "dropped", "switched", "keeps_enough"):
                assert is_same(getattr(both[0], name), getattr(both[1], name)), name
            ends = in_contact and rng.random() < 0.02
            in_contact = not ends and (in_contact or bool(rng.random() < 0.02))
            for readings in both:
                if not in_contact:
                    readings.rest(0.1)
                if ends:
                    readings.release()
        if rng.random() < 0.2:
            for readings in both:
                readings.interrupt()


@needs_library
@pytest.mark.parametrize("array", [ARRAYS[0], ARRAYS[2]], ids=["wang2019-3x3", "xyz-two-pads-4x4"])
@given(seed=st.integers(0, 2**32), data=st.data())
@settings(max_examples=2, deadline=None)
def test_grip_events_are_those_of_numpy(array: Array, seed: int, data: st.DataObject) -> None:
    block = touched(array, seed)
    block = block[: round(6 * block.rate_hz)]
    both = of_both(lambda: GripDetector(array))
    cuts = data.draw(splits(len(block)))
    for _ in range(2):  # after `reset` as before
        found, wanted = (run(detector, pieces(block, cuts)) for detector in both)
        assert found == wanted
        for detector in both:
            detector.reset()


@needs_library
@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_frames_are_those_of_python(layouts: list[Layout], data: st.DataObject) -> None:
    layout = data.draw(st.sampled_from(layouts))
    decoders = of_both(lambda: Decoder(layout))
    stream = data.draw(streams(layout))
    for piece in data.draw(st.lists(st.integers(0, max(len(stream), 1))).map(lambda cuts: cut(stream, cuts))):
        found, wanted = (decoder.feed(piece) for decoder in decoders)
        assert found == wanted
    counted = [(d.bytes_in, d.bytes_framed, d.bytes_discarded, d.bytes_pending) for d in decoders]
    assert counted[0] == counted[1]


@needs_library
def test_the_library_reads_the_scans_of_both_layouts(layouts: list[Layout]) -> None:
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


def hook() -> ModuleType:
    """Return `hatch_build.py` as a module."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Folder with the C sources where the hook looks for them."""
    (tmp_path / "tactiled").mkdir()
    for source in compiled.SOURCES:
        shutil.copy(source, tmp_path / "tactiled")
    return tmp_path


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_hook_builds_a_library_that_loads_and_one_of_another_source_is_refused(tree: Path) -> None:
    build = hook()
    assert build.compile_library(tree)
    library, sources = tree / build.LIBRARY, [tree / source for source in build.SOURCES]
    assert [source.name for source in sources] == [source.name for source in compiled.SOURCES]
    assert compiled.load(library, sources).words == "compiled"
    for source in sources:
        text = source.read_text()
        source.write_text(text + "/* changed */\n")
        assert "install again" in compiled.load(library, sources).words
        source.write_text(text)
        assert compiled.load(library, sources).words == "compiled"


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_an_array_of_variable_length_does_not_compile(tree: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """On the stack of a thread, an array of many taxels would end the process."""
    build = hook()
    source = tree / build.SOURCES[-1]
    grown = "\nreal grown(ptrdiff_t n) { real all[n]; all[n - 1] = 1; return all[n - 1]; }\n"
    source.write_text(source.read_text() + grown)
    assert not build.compile_library(tree)
    assert "variable length array" in capsys.readouterr().err


@pytest.mark.parametrize("compiler", ["no-such-compiler", "false"])
def test_without_a_compiler_the_hook_leaves_no_library(
    tree: Path, compiler: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    build = hook()
    (tree / build.LIBRARY).write_bytes(b"of an older build")
    monkeypatch.setenv("CC", compiler)
    assert not build.compile_library(tree)
    left = {path.name for path in (tree / "tactiled").iterdir()}
    assert left == {source.name for source in compiled.SOURCES}
    assert "numpy" in capsys.readouterr().err
    assert compiled.load(tree / build.LIBRARY, compiled.SOURCES).words == (
        "numpy (built without a C compiler)"
    )


def test_a_file_that_is_no_library_is_refused(tree: Path) -> None:
    library = tree / "tactiled" / "_compiled.so"
    library.write_bytes(b"\x7fELF of nothing")
    found = compiled.load(library)
    assert found.functions is None
    assert "does not load" in found.words


def test_the_environment_forces_numpy() -> None:
    script = "from tactiled import compiled; import json; print(json.dumps(compiled.path.words))"
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"TACTILED_COMPILED": "0", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert json.loads(done.stdout) == "numpy (TACTILED_COMPILED=0)"
