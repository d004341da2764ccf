"""The native bench: ratios and aims of made latencies, and one short run whose times nobody checks."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cpp import need_native

from bench.hold.play import GraspResult
from bench.native import bench
from bench.native.grasps import grasps
from bench.report import aims_table


def test_the_client_is_judged_beside_zmq_recv() -> None:
    latency_us = {"client": np.full(100, 105.0), "bare": np.full(100, 100.0)}
    run = bench.NativeRun(latency_us, {"client": 70.0, "bare": 45.0})
    assert run.ratio(0.5) == pytest.approx(1.05)
    kept = GraspResult("none", dropped=False, over_least=1.5, slid_mm=0.0, reaction_s=np.nan)
    held = {"C++": [kept, replace(kept, dropped=True)], "Python": [kept, kept]}
    found = bench.NativeResults([run], bench.NativeCost(scan_us=7.0, allocations=6.0, of_msgpack=5.0), held)
    verdicts = [
        line.split("|")[3].split(":")[0].strip() for line in aims_table(bench.AIMS, {"m": found}).splitlines()
    ]
    assert verdicts[2:] == ["met", "met", "met", "MISSED", "MISSED", "MISSED"]


def test_both_programs_receive_scans(tmp_path: Path) -> None:
    need_native()
    receive = bench.compile_receiver(tmp_path)
    run = bench.run_once(tmp_path, receive, n_scans=150)
    for name in bench.PROGRAMS:
        assert run.latency_us[name].size > 0
        assert np.all(run.latency_us[name] > 0)
    cost = bench.measure_cost(tmp_path, receive)
    assert cost.allocations == cost.of_msgpack


def test_the_controller_of_cpp_holds_as_that_of_python(tmp_path: Path) -> None:
    need_native()
    of_cpp, of_python = grasps(bench.compile_controller(tmp_path), range(500, 502)).values()
    assert [(one.dropped, one.over_least, one.slid_mm) for one in of_cpp] == [
        (one.dropped, one.over_least, one.slid_mm) for one in of_python
    ]
    assert not any(one.dropped for one in of_cpp)
