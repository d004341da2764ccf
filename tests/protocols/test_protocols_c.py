"""The C encoder and the Python codec are independent witnesses of the same bytes.

The C program is built anew for each kind of octet: in 16-bit words as on the C28x, in bytes, in 32-bit
words. It traps on undefined behaviour. A missing compiler is a failure: without it nothing is proven.
"""

import re
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tactiled import resources
from tactiled.wire import cobs
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Frame, Hello, Scan
from tactiled.wire.framing import crc16
from tactiled.wire.layout import load_layout

SOURCES = resources.shipped("protocols", "c")
VECTORS = resources.shipped("protocols", "vectors", "board-v1.txt")
LAYOUT = load_layout("board-v1")
COMMANDS = {m.name: m.id for m in LAYOUT.incoming("host-to-board").values()}
NAMES = {id_: name for name, id_ in COMMANDS.items()}
RESULTS = LAYOUT.file.results
Answer = Callable[[Iterable[str]], list[str]]


def build(folder: Path, octet: str) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.fail("no C compiler: the golden vectors cannot be checked; install gcc (cc)")
    program = folder / "vectors"
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    flags += ["-fsanitize=undefined", "-fsanitize-undefined-trap-on-error", f"-DTACTILED_OCTET={octet}"]
    sources = [str(SOURCES / "vectors.c"), str(SOURCES / "tactiled_board.c")]
    done = subprocess.run([compiler, *flags, "-o", str(program), *sources], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return program


def run(program: Path, requests: Iterable[str] | None) -> str:
    arguments = [str(program)] if requests is None else [str(program), "-"]
    lines = None if requests is None else "".join(f"{line}\n" for line in requests)
    done = subprocess.run(arguments, input=lines, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module", params=["uint_least16_t", "unsigned char", "uint_least32_t"])
def program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("c"), request.param)


@pytest.fixture(scope="module")
def answer(program: Path) -> Answer:
    """What the C program answers to each request."""
    return lambda requests: [line.split(" =>", 1)[1].strip() for line in run(program, requests).splitlines()]


def request_of(frame: Frame) -> str:
    """A frame in the line protocol of vectors.c."""
    if isinstance(frame, Scan):
        numbers: list[int | None] = [frame.sequence, frame.ticks, frame.flags, *frame.counts]
        return f"scan {' '.join(map(str, numbers))}"
    if isinstance(frame, Hello):
        texts = " ".join(f'"{t}"' for t in (frame.firmware_version, frame.board_serial, frame.array_id))
        numbers = [
            frame.boot_count, int(frame.streaming), frame.ticks, round(frame.rate_hz * 1000), frame.adc_bits,
            round(frame.adc_reference_v * 1000), *(round(s * 1e6) for s in frame.channel_offset_s),
        ]  # fmt: skip
        return f"hello {frame.protocol_version} {texts} {' '.join(map(str, numbers))}"
    assert isinstance(frame, Acknowledge)
    command = COMMANDS.get(frame.command) or int(frame.command, 16)
    return f"acknowledge {frame.token} {command:#04x} {RESULTS[frame.result]} {frame.ticks}"


def board_frames(n: int, seed: int) -> list[Frame]:
    """Random frames of all three kinds, with many zeros, extremes and wraps among their values."""
    rng = np.random.default_rng(seed)

    def number(top: int) -> int:
        return [0, 1, 255, 256, top - 1, top, int(rng.integers(0, top + 1))][int(rng.integers(7))] & top

    def text(size: int) -> str:
        letters: list[str] = [chr(c) for c in range(32, 127) if chr(c) not in "\"'\\"]
        return "".join(
            rng.choice(letters, [0, 1, size, int(rng.integers(0, size + 1))][int(rng.integers(4))])
        )

    def scan() -> Scan:
        top = int(rng.choice([1, 255, 4095, 65535]))
        counts = rng.integers(0, top + 1, 36) * rng.integers(0, 2, 36)
        return Scan(number(65535), counts, number(2**32 - 1), number(65535))

    def hello() -> Hello:
        return Hello(
            protocol_version=number(255), firmware_version=text(12), board_serial=text(16), array_id=text(24),
            boot_count=number(65535), streaming=bool(rng.integers(2)), ticks=number(2**32 - 1),
            rate_hz=max(number(2**32 - 1), 1) / 1000, adc_bits=int(rng.integers(1, 33)),
            adc_reference_v=max(number(65535), 1) / 1000,
            channel_offset_s=tuple(number(65535) / 1e6 for _ in range(36)),
        )  # fmt: skip

    def acknowledge() -> Acknowledge:
        command = [*COMMANDS, "0x7f", "0xff"][int(rng.integers(7))]
        return Acknowledge(number(65535), command, list(RESULTS)[int(rng.integers(5))], number(2**32 - 1))

    kinds: list[Callable[[], Frame]] = [scan, hello, acknowledge]
    return [kinds[int(rng.integers(3))]() for _ in range(n)]


def test_checked_in_vectors_are_what_the_program_prints(program: Path) -> None:
    assert run(program, None) == VECTORS.read_text()


def test_python_reads_and_writes_the_golden_frames() -> None:
    seen = []
    for line in VECTORS.read_text().splitlines():
        request, octets = line.split(" => ")
        verb = request.split()[0]
        if verb in ("scan", "hello", "acknowledge"):
            (frame,) = Decoder(LAYOUT).feed(bytes.fromhex(octets))
            assert shlex.split(request_of(frame)) == shlex.split(request)  # type: ignore[arg-type]
            assert Encoder(LAYOUT).encode(frame).hex() == octets  # type: ignore[arg-type]
            seen.append(verb)
    assert (seen.count("scan"), seen.count("hello"), seen.count("acknowledge")) == (5, 3, 3)


def test_golden_commands_are_ours() -> None:
    golden = dict(line.split(" => ") for line in VECTORS.read_text().splitlines())
    expected = {
        "body 0x10 1 0": Command("start", 1),
        "body 0x11 2 0": Command("stop", 2),
        "body 0x12 3 0 0xa0 0x86 0x01 0": Command("set_rate", 3, 100.0),
        "body 0x13 4 0": Command("ping", 4),
        "body 0x14 5 0": Command("identify", 5),
    }
    for request, command in expected.items():
        assert Encoder(LAYOUT).encode(command).hex() == golden[request]


@cache
def frames() -> list[tuple[str, str]]:
    """Random frames as requests and as octets written and read by Python."""
    drawn = board_frames(4000, seed=11)
    written = [Encoder(LAYOUT).encode(frame) for frame in drawn]
    assert Decoder(LAYOUT).feed(b"".join(written)) == drawn
    return [(request_of(frame), octets.hex()) for frame, octets in zip(drawn, written, strict=True)]


def test_thousands_of_frames_are_the_same_octets(answer: Answer) -> None:
    assert answer(request for request, _ in frames()) == [octets for _, octets in frames()]


@cache
def commands() -> list[tuple[str, str]]:
    """Random commands as requests, and what the board understands."""
    rng = np.random.default_rng(12)
    found = []
    for _ in range(3000):
        name = str(rng.choice(list(COMMANDS)))
        token, millihertz = int(rng.integers(0, 65536)), int(rng.integers(0, 2**32))
        rate_hz = millihertz / 1000 if name == "set_rate" else None
        octets = Encoder(LAYOUT).encode(Command(name, token, rate_hz))
        # What stands above the octet in a 16-bit word of the C28x is not ours to trust.
        words = [
            octet | int(rubbish) << 8
            for octet, rubbish in zip(octets, rng.integers(0, 256, 99), strict=False)
        ]
        understood = f"command {COMMANDS[name]:#04x} {token} {millihertz if rate_hz is not None else 0};"
        found.append(("receive " + " ".join(map(hex, words)), understood))
    return found


def test_thousands_of_commands_are_understood_by_the_board(answer: Answer) -> None:
    assert answer(request for request, _ in commands()) == [understood for _, understood in commands()]


def test_long_bodies_are_stuffed_alike(answer: Answer) -> None:
    """Runs of 254 and more octets without a zero, which no message of version 1 is long enough for."""
    bodies = [b"\x55" * n for n in (*range(248, 260), *range(505, 515))]
    bodies += [b"\0" + body for body in bodies] + [body + b"\0" for body in bodies] + [b"\0" * 600]
    expected = [(cobs.encode(body + crc16(body).to_bytes(2, "little")) + b"\0").hex() for body in bodies]
    assert answer("body " + " ".join(map(str, body)) for body in bodies) == expected


@cache
def noisy() -> list[tuple[bytes, list[Command]]]:
    """Noise around commands, and what Python takes for commands."""
    rng = np.random.default_rng(13)
    lines = [b"".join(noise(rng) for _ in range(8)) for _ in range(2000)]
    items = [Decoder(LAYOUT, "host-to-board").feed(line) for line in lines]
    understood = [[item for item in found if isinstance(item, Command)] for found in items]
    return list(zip(lines, understood, strict=True))


def test_any_octets_the_board_accepts_the_host_would_too(answer: Answer) -> None:
    """What C takes for a command Python takes too (and rescues some more)."""
    said = answer("receive " + " ".join(map(str, line)) for line, _ in noisy())
    n_accepted = 0
    for (line, understood), answers in zip(noisy(), said, strict=True):
        heard = iter(understood)
        accepted = [command for text in answers.split(";") if (command := command_of(text))]
        assert all(command in heard for command in accepted), line.hex()
        n_accepted += len(accepted)
    assert n_accepted > 2000


def noise(rng: np.random.Generator) -> bytes:
    """A command, a stranger of up to 32 octets, a part of either, or rubbish."""
    name = str(rng.choice(["start", "stop", "ping", "identify"]))
    command = Encoder(LAYOUT).encode(Command(name, int(rng.integers(0, 65536))))
    stranger = sealed(bytes([rng.integers(0x20, 0x100)]) + rng.bytes(int(rng.integers(2, 29))))
    whole = [command, stranger][int(rng.integers(2))]
    rubbish = rng.bytes(int(rng.integers(1, 40)))
    return [whole, whole, whole[int(rng.integers(len(whole))) :], rubbish, b"\0"][int(rng.integers(5))]


def sealed(body: bytes) -> bytes:
    return cobs.encode(body + crc16(body).to_bytes(2, "little")) + b"\0"


def command_of(text: str) -> Command | None:
    """What one answer to a receive request says."""
    words = text.split()
    if not words or words[0] == "corrupt":
        return None
    type_ = int(words[1], 16)
    name = NAMES[type_] if words[0] == "command" else f"0x{type_:02x}"
    return Command(name, int(words[2]), int(words[3]) / 1000 if name == "set_rate" else None)


def test_the_rate_that_fits_the_line(answer: Answer) -> None:
    bauds = [9600, 57600, 115200, 230400, 460800, 921600, 3_000_000, 12_000_000]
    expected = [str(baud * 95 * 1000 // (100 * 10 * LAYOUT.wire_bytes("scan"))) for baud in bauds]
    assert answer(f"rate {baud}" for baud in bauds) == expected


FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror"]


@pytest.mark.parametrize("fast_ppm", [-300.0, -20.0, 0.0, 20.0, 300.0])
def test_a_stamp_of_the_firmware_is_when_its_timer_fired(tmp_path: Path, fast_ppm: float) -> None:
    example, program = SOURCES / "example", tmp_path / "firmware"
    sources = [
        Path(__file__).with_name("port_of_the_host.c"),
        example / "firmware.c",
        SOURCES / "tactiled_board.c",
    ]
    flags = [*FLAGS, f"-DFAST_PPM={fast_ppm}", f"-I{example}"]
    subprocess.run(["cc", *flags, "-o", str(program), *map(str, sources)], check=True)
    sent = subprocess.run([program], capture_output=True, check=True, timeout=60).stdout
    scans = [item for item in Decoder(LAYOUT).feed(sent) if isinstance(item, Scan)]
    assert [scan.sequence for scan in scans] == list(range(201))
    period_us = 10_000 * (1 - fast_ppm * 1e-6)
    assert [scan.ticks for scan in scans] == pytest.approx([n * period_us for n in range(201)], abs=1000)


@pytest.mark.parametrize(("baud", "sample_us"), [(57_600, 80), (115_200, 300)])
def test_a_default_rate_that_the_board_cannot_keep_is_not_compiled(
    tmp_path: Path, baud: int, sample_us: int
) -> None:
    shutil.copytree(SOURCES, tmp_path / "c")
    for name, old, new in (("firmware.h", "BAUD 115200u", f"BAUD {baud}u"),
                           ("firmware.c", "SAMPLE_US 80u", f"SAMPLE_US {sample_us}u")):  # fmt: skip
        file = tmp_path / "c" / "example" / name
        file.write_text(file.read_text().replace(old, new))
    command = ["cc", *FLAGS, "-fsyntax-only", str(tmp_path / "c" / "example" / "firmware.c")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, "cannot keep DEFAULT_RATE_MILLIHERTZ" in done.stderr) == (1, True)


def test_a_program_in_cpp_finds_the_functions(tmp_path: Path) -> None:
    (tmp_path / "main.cpp").write_text(
        '#include "example/firmware.h"\nint main() { return tactiled_largest_rate_millihertz(BAUD) == 0; }\n'
    )
    library, program = tmp_path / "board.o", tmp_path / "main"
    subprocess.run(["cc", *FLAGS, "-c", str(SOURCES / "tactiled_board.c"), "-o", str(library)], check=True)
    command = [
        "c++",
        "-Wall",
        "-Werror",
        f"-I{SOURCES}",
        str(tmp_path / "main.cpp"),
        str(library),
        "-o",
        str(program),
    ]
    subprocess.run(command, check=True)
    subprocess.run([program], check=True)


def test_the_source_uses_nothing_that_means_eight_bits() -> None:
    forbidden = r"\b(u?int8_t|memcpy|memset|sizeof|unsigned char|malloc|union)\b"
    for name in ("tactiled_board.h", "tactiled_board.c", "example/firmware.h", "example/firmware.c"):
        code = re.sub(r"/\*.*?\*/", "", (SOURCES / name).read_text(), flags=re.DOTALL)
        assert re.findall(forbidden, code) == []
