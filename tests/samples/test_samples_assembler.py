"""Scan frames to blocks: every scan accounted for, wraps unseen, gaps told with count and cause."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tactiled.samples.assembler import Assembler, SampleParams
from tactiled.samples.block import Conversion, Gap, ScanBlock, ScanRun, TimedScan
from tactiled.wire.frames import Acknowledge, Hello, Scan
from tactiled.wire.layout import load_layout

LAYOUT = load_layout("board-v1")
LEGACY = load_layout("legacy-9")
LATENCY_S = 35 * 2e-4 + 10 * 85 / 115200  # the last channel's sampling offset, and 85 bytes on the line


def hello(**changes: object) -> Hello:
    fields: dict[str, object] = {
        "board_serial": "TS0001",
        "array_id": "wang2019-3x3",
        "rate_hz": 100.0,
        "adc_bits": 12,
        "adc_reference_v": 3.0,
        "channel_offset_s": tuple(k * 2e-4 for k in range(36)),
        **changes,
    }
    return Hello(**fields)  # type: ignore[arg-type]


def scan(number: int, *, tick0: int = 0, sequence0: int = 0, flags: int = 0, level: int = 1000) -> Scan:
    """Scan `number` of a board that started at the given counters."""
    return Scan(
        sequence=(sequence0 + number) % 2**16,
        ticks=(tick0 + number * 10_000) % 2**32,
        flags=flags,
        counts=np.full(36, level, dtype=np.int64),
    )


def assembler() -> Assembler:
    new = Assembler(LAYOUT)
    new.board(hello(), 50.0)
    return new


def flush(target: Assembler) -> list[ScanBlock | Gap]:
    """What the assembler has completed, with runs as blocks."""
    return [item if isinstance(item, Gap) else item.block() for item in target.take()]


def feed(target: Assembler, numbers: list[int], **start: int) -> list[ScanBlock | Gap]:
    out: list[ScanBlock | Gap] = []
    for number in numbers:
        target.scan(scan(number, **start), 50.0 + number * 0.01 + LATENCY_S)
        out += flush(target)
    return out


@given(
    kept=st.lists(st.booleans(), min_size=2, max_size=300),
    tick0=st.integers(0, 2**32 - 1),
    sequence0=st.integers(0, 2**16 - 1),
)
@example(kept=[True] * 40, tick0=2**32 - 200_000, sequence0=2**16 - 20)  # both wrap
def test_every_scan_is_delivered_or_missing(kept: list[bool], tick0: int, sequence0: int) -> None:
    numbers = [n for n, keep in enumerate(kept) if keep] or [0, 1]
    target = assembler()
    items = feed(target, numbers, tick0=tick0, sequence0=sequence0)
    blocks = [item for item in items if isinstance(item, ScanBlock)]
    gaps = [item for item in items if isinstance(item, Gap)]
    assert sum(len(block) for block in blocks) == len(numbers) == target.counts.scans
    missing = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert sum(gap.n_missing for gap in gaps) == missing == target.counts.missing
    index = np.concatenate([block.index for block in blocks])
    assert index.tolist() == [n - numbers[0] for n in numbers]
    times = np.concatenate([block.time_s for block in blocks])
    assert np.diff(times) == pytest.approx(0.01 * np.diff(index), abs=2e-3)
    assert target.counts.restarts == 0


@pytest.mark.parametrize("away_s", [1.0, 700.0, 2000.0, 5000.0])
def test_a_long_silence_is_counted_over_any_number_of_wraps(away_s: float) -> None:
    """16-bit sequences wrap in 11 minutes, 32-bit microseconds in 71: the host's clock tells how often."""
    target = assembler()
    feed(target, list(range(50)))
    target.interrupt("disconnect")
    back = 50 + int(away_s * 100)
    gaps = [item for item in feed(target, [back, back + 1]) if isinstance(item, Gap)]
    assert gaps == [Gap(back - 50, "disconnect", back)]


def test_a_reboot_of_a_board_that_counts_no_boots_is_found_by_its_ticks() -> None:
    """Off for ten seconds, then on again with the same hello: its ticks are young."""
    target = assembler()
    feed(target, list(range(500)))
    target.interrupt("disconnect")
    target.board(hello(ticks=100_000), 65.0)
    target.scan(Scan(0, np.zeros(36, dtype=np.int64), ticks=200_000), 65.1 + LATENCY_S)
    items = flush(target)
    assert items[0] == Gap(0, "restart", 500)
    assert isinstance(items[1], ScanBlock)
    assert items[1].time_s[0] == pytest.approx(65.1, abs=2e-3)
    assert not items[1].late[0]


@pytest.mark.parametrize("is_unplugged", [True, False])
def test_a_board_whose_counters_fit_after_a_power_cycle_is_late_until_a_ping_is_answered(
    is_unplugged: bool,
) -> None:
    """It ran for 2 s, was off for 3.6 s, and has run for 2 s again when the first scan arrives."""
    target = assembler()
    feed(target, list(range(200)))
    if is_unplugged:
        target.interrupt("disconnect")
        target.board(hello(ticks=2_000_000), 57.6)
    again_s = 50.0 + 2.0 + 3.6
    target.scan(scan(200), again_s + 2.0 + LATENCY_S)
    (*_, block) = flush(target)
    assert isinstance(block, ScanBlock)
    assert block.late[0]
    target.pinged(1, again_s + 2.001)
    target.answered(Acknowledge(1, "ping", "ok", ticks=2_003_000), again_s + 2.006)
    target.scan(scan(201), again_s + 2.01 + LATENCY_S)
    gap, block = flush(target)
    assert gap == Gap(0, "restart", 201)
    assert isinstance(block, ScanBlock)
    assert block.time_s[0] == pytest.approx(again_s + 2.01, abs=2e-3)
    assert not block.late[0]
    assert target.counts.restarts == 1


def test_a_ping_that_is_answered_behind_a_backlog_is_no_restart() -> None:
    target = assembler()
    feed(target, list(range(500)))
    for number in range(500, 800):  # 3 s of the line arrive at once
        target.scan(scan(number), 58.0 + LATENCY_S)
    target.pinged(1, 58.001)
    target.answered(Acknowledge(1, "ping", "ok", ticks=8_003_000), 58.006)
    target.scan(scan(801), 58.01 + LATENCY_S)
    items = flush(target)
    assert target.counts.restarts == 0
    assert isinstance(items[-1], ScanBlock)
    assert not items[-1].late[-1]


def test_a_started_board_whose_ticks_are_young_is_another_run() -> None:
    target = assembler()
    feed(target, list(range(500)))
    flags = LAYOUT.flag("first_after_start")
    target.scan(Scan(0, np.zeros(36, dtype=np.int64), ticks=100_000, flags=flags), 75.0 + LATENCY_S)
    items = flush(target)
    assert items[0] == Gap(0, "restart", 500)
    assert isinstance(items[1], ScanBlock)
    assert items[1].time_s[0] == pytest.approx(75.0, abs=2e-3)


def test_each_board_is_scaled_by_its_own_reference() -> None:
    target = assembler()
    feed(target, list(range(100)))
    target.board(hello(board_serial="TS0002", adc_reference_v=1.5), 51.5)
    target.scan(scan(100, level=2048), 52.0)
    items = flush(target)
    assert isinstance(items[-1], ScanBlock)
    assert items[-1].volts[0, 0] == 0.75


def test_scans_with_future_times_are_late() -> None:
    """A clock that runs ahead (ticks jumped, sequence did not say so) marks what it stamps."""
    target = assembler()
    feed(target, list(range(300)))
    target.scan(Scan(300, np.zeros(36, dtype=np.int64), ticks=3_000_000 + 49_000), 53.0 + LATENCY_S - 0.06)
    (block,) = flush(target)
    assert isinstance(block, ScanBlock)
    assert block.late[0]


@pytest.mark.parametrize("asleep_s", [0.3, 10.0, 700.0, 3600.0, 9000.0])
def test_scans_are_fresh_soon_after_a_suspend_of_the_host(asleep_s: float) -> None:
    """The board goes on while the host's monotonic clock stands still; what it sent meanwhile is lost."""
    target = assembler()
    feed(target, list(range(300)))
    first = 300 + round(100 * asleep_s)
    stamps: list[tuple[float, bool]] = []
    for number in range(first, first + 200):
        target.scan(scan(number), 50.0 + 0.01 * number - asleep_s + LATENCY_S)
        stamps += [
            stamp
            for item in flush(target)
            if isinstance(item, ScanBlock)
            for stamp in zip(item.time_s.tolist(), item.late.tolist(), strict=True)
        ]
    times_s = np.array([time_s for time_s, _ in stamps])
    assert np.all(np.diff(times_s) > 0)
    assert times_s[0] > 52.99
    assert not any(is_late for _, is_late in stamps[10:])
    assert times_s[10:] == pytest.approx(53.0 + 0.01 * np.arange(10, 200), abs=2e-3)


@pytest.mark.parametrize("asleep_s", [5.0, 20.0, 700.0])
@pytest.mark.parametrize("reboots", [False, True])
def test_an_adapter_that_was_away_while_the_host_slept(asleep_s: float, reboots: bool) -> None:
    """The boot count says that the board went on; where it stays at one number, the sequence number does."""
    target = Assembler(LAYOUT)
    target.board(hello(boot_count=7, ticks=0), 50.0)
    feed(target, list(range(300)))
    target.interrupt("disconnect")
    woken_s = 54.0
    first = 0 if reboots else round(100 * (woken_s - 50.0 + asleep_s))
    target.board(hello(boot_count=7, ticks=scan(first).ticks), woken_s)
    out: list[ScanBlock | Gap] = []
    for number in range(first, first + 200):
        target.scan(scan(number), woken_s + 0.01 * (number - first) + LATENCY_S)
        out += flush(target)
    counts = target.counts
    if reboots:
        assert counts.restarts == 1
        assert counts.missing == 0
    else:
        assert counts.restarts == 0
        assert counts.missing == first - 300
        assert out[0] == Gap(first - 300, "disconnect", first)
    late = [late for item in out if isinstance(item, ScanBlock) for late in item.late.tolist()]
    assert not any(late[10:])


def test_stop_and_start_is_a_gap_whatever_the_sequence_does() -> None:
    target = assembler()
    feed(target, list(range(100)))
    target.scan(
        Scan(0, np.zeros(36, dtype=np.int64), ticks=30_000_000, flags=LAYOUT.flag("first_after_start")), 80.02
    )
    block = flush(target)
    assert block[0] == Gap(0, "start", 100)
    assert isinstance(block[1], ScanBlock)
    assert block[1].time_s[0] == pytest.approx(80.0, abs=0.02)


def test_cause_of_a_gap_is_corruption_when_bytes_arrived_damaged() -> None:
    target = assembler()
    feed(target, [0, 1])
    target.corrupt()
    assert [i for i in feed(target, [3]) if isinstance(i, Gap)] == [Gap(1, "corrupt", 3)]
    assert [i for i in feed(target, [5]) if isinstance(i, Gap)] == [Gap(1, "missing", 5)]


def test_full_scale_and_reference_faults_are_invalid_and_zero_is_not() -> None:
    target = assembler()
    target.scan(scan(0, level=4095), 50.0)
    target.scan(scan(1, level=0), 50.01)
    target.scan(scan(2, flags=LAYOUT.flag("reference_fault")), 50.02)
    block = flush(target)[0]
    assert isinstance(block, ScanBlock)
    assert block.valid.all(axis=1).tolist() == [False, True, False]
    assert block.volts[0, 0] == 4095 * 3.0 / 4096


def test_backlog_is_marked_late_and_never_moves_time() -> None:
    target = assembler()
    feed(target, list(range(300)))
    for number in range(300, 350):  # half a second of scans in one read
        target.scan(scan(number), 53.5 + LATENCY_S)
    (block,) = flush(target)
    assert isinstance(block, ScanBlock)
    assert block.late[0]
    assert not block.late[-1]
    assert block.time_s == pytest.approx(53.0 + 0.01 * np.arange(50), abs=2e-3)


def test_time_grows_whatever_arrives() -> None:
    rng = np.random.default_rng(3)
    target = assembler()
    times: list[float] = []
    arrival_s = 50.0
    for number in range(2000):
        arrival_s = max(arrival_s, 50 + number * 0.01 + rng.exponential(0.02))
        target.scan(scan(number), arrival_s)
        for item in flush(target):
            assert isinstance(item, ScanBlock)
            times += item.time_s.tolist()
    assert np.all(np.diff(times) > 0)


@pytest.mark.parametrize("transfer", ["line", "none"])
def test_a_frame_that_came_in_two_reads_was_not_complete_before_its_last_byte(transfer: str) -> None:
    """Every seventh frame; a byte of the line takes its time, and a frame by USB none."""
    params = {"transfer": transfer, "clock": {"handover_s": 0}}
    target = Assembler(LAYOUT, SampleParams.model_validate(params))
    target.board(hello(channel_offset_s=()), 50.0)
    frame_s = LATENCY_S - 35 * 2e-4 if transfer == "line" else 0.0
    errors_s: list[float] = []
    for number in range(1000):
        instant_s = 50.0 + 0.01 * number
        if number % 7 == 3:
            target.read(instant_s + frame_s - 1e-3, 0)
            target.read(instant_s + frame_s, 40)
        else:
            target.read(instant_s + frame_s, 0)
        target.scan(scan(number), instant_s + frame_s)
        errors_s.append(target.newest[0] - instant_s)
    assert np.abs(errors_s[300:]).max() < 2e-4


def test_a_board_without_ticks_is_timed_by_its_sample_count() -> None:
    target = Assembler(LEGACY)
    target.board(hello(rate_hz=50.0, channel_offset_s=(), adc_bits=10, adc_reference_v=5.0), 9.0)
    for number in range(600):
        target.scan(
            Scan(number % 256, np.zeros(9, dtype=np.int64), ticks=None),
            10 + number * 0.02 + 0.0001 * (number % 7),
        )
    (block,) = flush(target)
    assert isinstance(block, ScanBlock)
    latency_s = 10 * LEGACY.wire_bytes("scan") / 57600
    assert block.time_s[-1] == pytest.approx(10 + 599 * 0.02 - latency_s, abs=1e-3)


@pytest.mark.parametrize("stall_s", [0.3, 1.5, 4.0])
def test_the_backlog_of_a_board_without_ticks_is_as_old_as_it_is(stall_s: float) -> None:
    target = Assembler(LEGACY)
    target.board(hello(rate_hz=50.0, channel_offset_s=(), adc_bits=10, adc_reference_v=5.0), 9.0)
    n_stalled = round(stall_s * 50)
    for number in range(300 + n_stalled):
        instant_s = 10 + number * 0.02
        target.scan(
            Scan(number % 256, np.zeros(9, dtype=np.int64)), instant_s if number < 300 else 16 + stall_s
        )
    (block,) = flush(target)
    assert isinstance(block, ScanBlock)
    assert block.time_s[300:] == pytest.approx(16 + 0.02 * np.arange(n_stalled), abs=0.02)
    assert block.late[300 : 300 + n_stalled - 10].all()
    assert target.counts.restarts == target.counts.missing == 0


OVERRUN = LAYOUT.flag("overrun")


def test_scans_missed_by_the_board_are_counted_apart_from_lost_scans() -> None:
    target = assembler()
    feed(target, [0, 1])
    feed(target, [5], flags=OVERRUN)  # 2, 3, 4: the board says that it missed them
    feed(target, [8])  # 6, 7: nobody says why
    target.corrupt()
    feed(target, [12], flags=OVERRUN)  # of 9, 10, 11 one came damaged
    target.corrupt()
    feed(target, [14])
    target.interrupt("disconnect")
    feed(target, [20], flags=OVERRUN)  # of 15 to 19 one at least was missed, the rest was unplugged
    counts = target.counts
    assert (counts.missing, counts.overrun, counts.dropped) == (3 + 2 + 3 + 1 + 5, 3 + 2 + 1, 2)


def test_a_damaged_frame_without_a_missing_scan_is_no_gap_where_scans_are_counted() -> None:
    target = assembler()
    feed(target, [0, 1])
    target.corrupt()
    assert not [item for item in feed(target, [2, 3]) if isinstance(item, Gap)]


def test_the_latency_timer_counts_whether_the_adapter_or_the_board_is_known_first() -> None:
    sds_s = []
    for order in ("adapter first", "board first", "no adapter"):
        target = Assembler(LAYOUT)
        if order == "adapter first":
            target.adapter(0.016)
        target.board(hello(), 50.0)
        if order == "board first":
            target.adapter(0.016)
        blocks: list[ScanBlock | Gap] = []
        for number in range(400):
            arrival_s = 50.0 + number * 0.01 + LATENCY_S
            target.scan(scan(number), 0.016 * np.ceil(arrival_s / 0.016))
            blocks += flush(target)
        sds_s.append([float(block.time_sd_s[-1]) for block in blocks if isinstance(block, ScanBlock)][-1])
    assert sds_s[0] == sds_s[1]
    assert sds_s[2] != sds_s[0]


def test_a_reading_that_is_no_number_is_none_to_detectors_and_0_in_messages() -> None:
    """As in a log: a channel without a reading must not look like one that nothing presses."""
    conversion = Conversion(hello(), 1.0, None, np.zeros(3), 0, np.isfinite)
    frame = Scan(sequence=0, ticks=None, flags=0, counts=np.array([np.nan, -np.inf, 2.0]))
    run = ScanRun([TimedScan(frame, 0, 50.0, 1e-3, late=False)], conversion)
    assert np.array_equal(run.block().volts, [[np.nan, np.nan, 2.0]], equal_nan=True)
    assert run.rows() == [((0.0, 0.0, 2.0), (False, False, True))]
    assert run.block().valid.tolist() == [[False, False, True]]
