"""The latency bench: messages are matched with the frames that they answer, and losses are counted."""

import json
from pathlib import Path

import numpy as np
import pytest

from bench.latency import bench
from tactiled.wire.codec import Encoder
from tactiled.wire.frames import Scan
from tactiled.wire.layout import load_layout

START_S = 1000.0


def test_each_program_is_judged_by_its_own_frames(tmp_path: Path) -> None:
    """The daemon answers 3 ms after its frame and misses one in ten, the reference 0.2 ms after its own."""
    encoder, rng = Encoder(load_layout("board-v1")), np.random.default_rng(0)
    spans = bench.spans_of_phases()
    relayed, heard, expected = [], [], dict.fromkeys(spans, 0)
    for number in range(round(max(end_s for _, end_s in spans.values()) * 100)):
        at_s = START_S + number / 100
        counts = rng.integers(0, 4096, 36) if number > 500 else np.zeros(36, dtype=np.int64)  # untouched
        scan = Scan(sequence=number, ticks=number * 10_000, flags=0, counts=counts)
        relayed.append([at_s, at_s + 0.005, encoder.encode(scan).hex()])
        heard.append([at_s + 0.0052, {"topic": "reference", "sequence": number}])
        if number % 10:
            volts = (scan.counts * 3.0 / 4096).tolist()
            heard.append([at_s + 0.003, {"topic": "scan", "index": number - 7, "volts": volts}])
        for phase, (begin_s, end_s) in spans.items():
            expected[phase] += begin_s <= at_s - START_S < end_s
    heard.append([START_S + 25.0, {"topic": "status", "loop_lag_s": 0.004, "fits_late": 2}])
    (tmp_path / "relayed").write_text("".join(json.dumps(row) + "\n" for row in relayed))
    (tmp_path / "heard").write_text("".join(json.dumps(row) + "\n" for row in heard))
    cpu = {"daemon": [(0.0, 0.0), (100.0, 20.0)], "reference": [(0.0, 0.0), (100.0, 1.0)]}
    run = bench.matched(tmp_path / "relayed", tmp_path / "heard", START_S, cpu)
    for phase in spans:
        daemon, reference = run.daemon[phase], run.reference[phase]
        assert daemon.quantile_ms(0.5) == pytest.approx(3.0, abs=1e-3)
        assert reference.quantile_ms(1.0) == pytest.approx(0.2, abs=1e-3)
        assert run.ratio(phase, 0.99) == pytest.approx(15.0, rel=1e-2)
        assert daemon.lost == pytest.approx(expected[phase] / 10, abs=len(spans))
        assert reference.lost == 0
        assert len(daemon.latency_s) + daemon.lost == expected[phase] > 50
        assert (daemon.cpu_part, reference.cpu_part) == pytest.approx((0.2, 0.01))
    assert run.fits_late == 2
    assert run.loop_lag_s["rest"] == 0.0
    assert max(run.loop_lag_s.values()) == 0.004
