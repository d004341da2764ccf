"""Board, line and faults together in simulated time, read by the codec."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactiled import resources
from tactiled.array import load_array
from tactiled.emulator.board.identity import EmulatedBoardParams, emulated_array
from tactiled.emulator.line.cable import Arrival
from tactiled.emulator.line.faults import FaultParams
from tactiled.emulator.port import EmulatedPort
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.simulate import Simulation
from tactiled.errors import ConfigError, ContractError
from tactiled.wire.codec import Decoder, Encoder
from tactiled.wire.frames import Acknowledge, Command, Corrupt, Frame, Hello, Scan
from tactiled.wire.layout import compile_layout, load_layout

V1 = load_layout("board-v1")
DEMO = load_scene("prescribed")
ALL_FAULTS = FaultParams(
    flip_per_byte=2e-4,
    drop_per_byte=2e-4,
    cut_per_frame=0.02,
    duplicate_per_frame=0.02,
    burst_per_s=0.2,
    stall_per_s=0.2,
    overrun_per_s=0.3,
    reboot_per_s=0.05,
    unplug_per_s=0.05,
)


def decode(simulation: Simulation) -> list[Frame | Corrupt]:
    decoder = Decoder(V1)
    return [item for _, data in simulation for item in decoder.feed(data)]


def scans_of(items: list[Frame | Corrupt]) -> list[Scan]:
    return [item for item in items if isinstance(item, Scan)]


def run(
    faults: dict[str, Any], duration_s: float = 8.0, **rest: Any
) -> tuple[Simulation, list[Frame | Corrupt]]:
    params = FaultParams.model_validate(faults)
    simulation = Simulation(DEMO, V1, faults=params, duration_s=duration_s, **rest)
    return simulation, decode(simulation)


@pytest.mark.parametrize("name", ["normal-4x4", "wang2019-3x3"])
def test_a_layout_that_carries_volts_carries_those_of_the_converter(name: str) -> None:
    scene = load_scene("rest").with_changes(array=name)
    array, lines = load_array(name), load_layout("pillars-3x3").file
    hello = lines.assumed_hello
    assert hello is not None
    changes = {"channels": array.n_channels, "assumed_hello": hello.model_copy(update={"array_id": name})}
    layout = compile_layout(lines.model_copy(update=changes))
    decoder = Decoder(layout)
    simulation = Simulation(scene, layout, duration_s=2.0)
    scans = scans_of([item for _, data in simulation for item in decoder.feed(data)])
    volts = np.array([scan.counts for scan in scans])
    assert len(volts) > 50
    assert np.abs(volts).max() < 0.05  # nothing touches the array


def test_a_clean_run_delivers_every_scan_in_order() -> None:
    simulation, items = run(
        {}, board=EmulatedBoardParams(start_ticks=2**32 - 4_000_000, start_sequence=65000)
    )
    assert [type(i) for i in items[:2]] == [Hello, Acknowledge]
    scans = scans_of(items)
    assert len(scans) + 3 == len(items)  # hello and the answers to start and stop
    assert [s.sequence for s in scans] == [s.sequence for s in simulation.scans]
    assert len(scans) == 800
    assert simulation.counts.frames_in == len(items)
    assert simulation.counts.frames_damaged == 0
    assert simulation.truth.slips[0].onset_s == simulation.scans[0].began_s + 6.0


def test_arrivals_are_in_order_and_after_the_scan() -> None:
    simulation = Simulation(DEMO, V1, duration_s=3.0, faults=FaultParams(bunch_s=0.016))
    arrivals = list(simulation)
    assert all(a <= b for (a, _), (b, _) in itertools.pairwise(arrivals))
    decoder = Decoder(V1)
    delay = [
        arrival_s - simulation.scans[scan.sequence].began_s
        for arrival_s, data in arrivals
        for scan in scans_of(decoder.feed(data))
    ]
    # 7 ms of sampling, 85 bytes, and up to a tick of the adapter.
    assert min(delay) > 0.0069 + 0.00737
    assert max(delay) < 0.0071 + 0.00739 + 0.016


def test_every_scan_is_delivered_or_accounted_for() -> None:
    simulation, items = run({"cut_per_frame": 0.05, "overrun_per_s": 1.0, "duplicate_per_frame": 0.05}, 20.0)
    counts = simulation.counts
    good = [i for i in items if not isinstance(i, Corrupt)]
    assert counts.frames_cut > 50
    assert len(good) == counts.frames_in - counts.frames_cut
    unsent = sum(not s.sent for s in simulation.scans)
    assert unsent == counts.overruns
    sent = {s.sequence for s in simulation.scans if s.sent}
    delivered = {s.sequence for s in scans_of(items)}
    assert delivered <= sent
    assert len(sent - delivered) <= counts.frames_cut
    flagged = {s.sequence for s in scans_of(items) if s.flags & 2}
    after_gap = {s.sequence + 1 for s in simulation.scans if not s.sent}
    assert flagged <= after_gap
    assert flagged


def test_undamaged_frames_are_those_of_a_run_without_faults() -> None:
    clean, clean_items = run({}, 10.0)
    noisy, noisy_items = run(
        {"flip_per_byte": 1e-3, "drop_per_byte": 5e-4, "burst_per_s": 0.5, "stall_per_s": 0.3}, 10.0
    )
    assert clean.scans == noisy.scans
    said = {s.sequence: s for s in scans_of(clean_items)}
    got = scans_of(noisy_items)
    assert all(said[s.sequence] == s for s in got)
    intact = noisy.counts.frames_in - noisy.counts.frames_damaged
    # A frame whose end alone was hurt may be salvaged: delivered, though damaged.
    assert intact <= len([i for i in noisy_items if not isinstance(i, Corrupt)]) < noisy.counts.frames_in
    assert noisy.counts.stalls > 0
    assert noisy.counts.bursts > 0


def test_reboots_and_unplugging_at_stated_instants() -> None:
    at = [{"kind": "reboot", "at_s": 2.0}, {"kind": "unplug", "at_s": 4.0}]
    simulation, items = run({"at": at, "unplug_s": 1.5})
    boots = [(s.boot, s.sequence) for s in simulation.scans]
    assert boots.index((2, 0)) > 150
    assert {b for b, _ in boots} == {1, 2}
    hellos = [i for i in items if isinstance(i, Hello)]
    assert [h.boot_count for h in hellos] == [1, 2]
    counts = simulation.counts
    assert (counts.reboots, counts.unplugs) == (1, 1)
    assert counts.frames_unplugged == pytest.approx(150, abs=1)
    lost = len(simulation.scans) - len(scans_of(items))
    assert 0 <= lost - counts.frames_unplugged <= 2  # and at most what was on the line
    assert simulation.counts.bytes_pulled_out <= 2 * 85


def test_commands_while_unplugged_are_ignored() -> None:
    faults = FaultParams.model_validate({"at": [{"kind": "unplug", "at_s": 1.0}], "unplug_s": 1.0})
    port = EmulatedPort(DEMO, V1, power_up_s=0.0, faults=faults)
    start = Encoder(V1).encode(Command("start", 1))
    assert len(port.advance(0.9)) == 1
    port.advance(1.5)
    assert not port.plugged
    port.receive(start, 1.5)
    assert not port.board.running
    assert port.advance(1.99) == []
    port.advance(2.0)
    assert port.plugged
    port.receive(start, 2.1)
    assert port.board.running


@given(st.lists(st.floats(0.0003, 0.7), min_size=1, max_size=40), st.integers(0, 1000), st.booleans())
@settings(max_examples=25, deadline=None)
def test_any_steps_of_time_give_the_same_arrivals(steps: list[float], seed: int, bunched: bool) -> None:
    faults = ALL_FAULTS.model_copy(update={"bunch_s": 0.016 * bunched})
    start = Encoder(V1).encode(Command("start", 1))

    def arrivals(polls: list[float]) -> list[Arrival]:
        port = EmulatedPort(DEMO, V1, power_up_s=0.0, faults=faults, seed=seed)
        port.receive(start, 0.2)
        return [a for now_s in polls for a in port.advance(now_s)]

    polls = (0.2 + np.cumsum(steps)).tolist()
    assert arrivals(polls) == arrivals([polls[-1]])


def test_runs_of_one_seed_are_equal_and_of_two_differ() -> None:
    def run_once(seed: int, scene_seed: int = 1) -> list[tuple[float, bytes]]:
        scene = DEMO.with_changes(seed=scene_seed)
        return list(Simulation(scene, V1, faults=ALL_FAULTS, seed=seed, duration_s=4.0))

    assert run_once(1) == run_once(1)
    assert run_once(1) != run_once(2)
    assert run_once(1) != run_once(1, scene_seed=2)


def test_array_of_the_scene_must_be_that_of_the_layout(tmp_path: Path) -> None:
    legacy = load_layout("legacy-9")
    assumed = legacy.file.assumed_hello
    assert assumed is not None
    shipped = resources.shipped("config", "arrays", f"{assumed.array_id}.toml").read_text()
    own = tmp_path / "own.toml"
    own.write_text(shipped)
    assert emulated_array(DEMO, legacy).name == assumed.array_id
    named = DEMO.model_copy(update={"array": str(own)})
    assert emulated_array(named, legacy).name == assumed.array_id
    own.write_text(shipped.replace(f'"{assumed.array_id}"', '"other"'))
    with pytest.raises(ConfigError, match="give both the same name"):
        emulated_array(named, legacy)
    with pytest.raises(ConfigError, match="normal-4x4 has 16 channels, frames of tactiled-board carry 36"):
        Simulation(DEMO.with_changes(array="normal-4x4"), V1)


def test_the_legacy_layout_is_emulated() -> None:
    legacy = load_layout("legacy-9")
    simulation = Simulation(DEMO, legacy, duration_s=5.0)
    decoder = Decoder(legacy)
    scans = [item for _, data in simulation for item in decoder.feed(data)]
    assert all(isinstance(scan, Scan) for scan in scans)
    assert len(simulation.scans) - len(scans) in (0, 1)
    assert decoder.framer.bytes_discarded == 0
    held = scans_of(scans)[240]  # scene time 4.8 s: 20 N on nine normal taxels
    assert len(held.counts) == 9
    assert 300 < held.counts.mean() < 1023


def test_truth_before_the_scene_has_begun_is_refused() -> None:
    with pytest.raises(ContractError, match="not begun"):
        _ = Simulation(DEMO, V1).truth
