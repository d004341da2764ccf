"""Recordings with known truth: noise, shear and contact that were put in come out again."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bench.slip.scenes import play, read_sd_v
from tactiled.array import Array, load_array
from tactiled.detect.signal.quantise import Quantiser
from tactiled.detect.slip.detector import SETTINGS
from tactiled.detect.slip.response import PRESSURE, ResponseModel, motion, responses
from tactiled.detect.suite import DetectParams
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.families import QUIET
from tactiled.emulator.simulate import Simulation
from tactiled.errors import ConfigError, DataError
from tactiled.events.types import ScanEvent
from tactiled.jobs import executor
from tactiled.pipeline import Pipeline
from tactiled.recording.contents import Header, Read, load_board
from tactiled.recording.writer import RecordingWriter
from tactiled.samples.block import Gap, regular_block
from tactiled.tune.files import read_recording
from tactiled.tune.hold import Collector, Recording, noise_sd_v, quiet_part
from tactiled.tune.onset import InjectedOnset, latencies, slide
from tactiled.tune.run import tune_files
from tactiled.tune.study import SHEARS, WEAK_SHEAR, Study, reports_by_probability, study
from tactiled.tune.words import as_toml, in_words
from tactiled.wire.layout import load_layout

ARRAY = load_array("wang2019-3x3")
RATE_HZ = 100.0
Floats = NDArray[np.float64]


def held(seconds: float, noise_v: float, seed: int = 0, array: Array = ARRAY) -> Floats:
    """Readings of a hold of 1.2 V, white noise on them."""
    rng = np.random.default_rng(seed)
    pressed = (array.normal_weights() != 0).any(axis=0) * 1.2
    return np.asarray(pressed + rng.normal(0, noise_v, (int(seconds * RATE_HZ), array.n_channels)))


def recording(volts: Floats, array: Array = ARRAY) -> Recording:
    return Recording("it", array, (regular_block(volts, RATE_HZ),))


def shaken(sizes: Floats, noise_v: float = 3e-4) -> Recording:
    """Shear that comes and goes within 0.4 s, of each of these sizes over pressure, 3 s apart."""
    volts = held(3.0 * len(sizes) + 2, noise_v, seed=1)
    share = np.zeros(len(volts))
    for k, size in enumerate(sizes):
        at = int((3 + 3 * k) * RATE_HZ)
        share[at : at + 40] = size * np.sin(np.pi * np.arange(40) / 40) ** 2
    return recording(slide(ARRAY, volts, share, 30.0))


def test_workers_give_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tactiled.tune.study.SHEARS", SHEARS[::6])
    monkeypatch.setattr("tactiled.tune.study.SETTINGS", {"fast": SETTINGS["fast"]})
    quiet, motion = recording(held(8, 3e-4)), shaken(np.array([0.3]))
    with executor(1) as workers:
        found = study(quiet, motion, 1.0, lambda _: None, workers)
    alone = quietly(quiet, motion)
    assert (found.settings, found.shear_alarms) == (alone.settings, alone.shear_alarms)


def quietly(quiet: Recording, motion: Recording) -> Study:
    return study(quiet, motion, 1.0, lambda _: None)


@pytest.mark.parametrize("noise_v", [3e-4, 3e-3])
def test_noise_of_each_channel_is_what_was_put_in(noise_v: float) -> None:
    volts = held(20, noise_v)
    volts[:, 7] += held(20, 5 * noise_v, seed=2)[:, 7] - 1.2
    volts += 0.01 * np.arange(len(volts))[:, np.newaxis] / RATE_HZ  # creep is no noise
    volts[500:520] += 0.3  # nor is a knock
    volts[:, 3] = np.nan
    sd_v = noise_sd_v(recording(volts))
    wanted = np.full(36, noise_v)
    wanted[7] *= np.sqrt(26)
    known = np.arange(36) != 3
    assert np.isnan(sd_v[3])
    assert sd_v[known] == pytest.approx(wanted[known], rel=0.1)


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from(["wang2019-3x3", "normal-4x4", "xyz-two-pads-4x4"]),
    st.floats(0.01, 0.6),
    st.floats(0, 360),
)
def test_a_detector_sees_the_shear_that_was_put_in(name: str, share: float, direction_deg: float) -> None:
    array = load_array(name)
    volts = held(0.02, 0.0, array=array)
    slid = slide(array, volts, np.full(len(volts), share), direction_deg)
    grid = Quantiser(array)
    weights = ResponseModel(array).weights(np.ones(array.n_taxels, dtype=np.bool_))
    seen = responses(weights, grid.round(slid))[0]
    x, y, turn = motion(seen) / seen[PRESSURE]
    along = np.deg2rad(direction_deg)
    rounding = array.n_channels * 2.0**-20  # weights are multiples of it: half a step each, up and below
    if array.has_shear:
        assert (x, y) == pytest.approx((share * np.cos(along), share * np.sin(along)), abs=rounding)
    else:
        assert x * np.cos(along) + y * np.sin(along) == pytest.approx(share, abs=rounding)
    assert turn == pytest.approx(0, abs=rounding)
    before = responses(weights, grid.round(volts))[0][PRESSURE]
    assert abs(seen[PRESSURE] - before) <= 1  # a step of the grid


def test_an_array_without_shear_is_refused() -> None:
    array = replace(load_array("normal-3x3"), x_mm=np.zeros(9), y_mm=np.zeros(9))
    with pytest.raises(ConfigError, match="cannot measure tangential load"):
        slide(array, held(0.1, 0.0, array=array), np.ones(10), 0.0)


@pytest.mark.parametrize("rise_s", [0.1, 1.0])
@pytest.mark.parametrize("name", ["balanced", "quiet"])
def test_in_a_still_hold_an_onset_is_detected_once_its_shear_has_grown(name: str, rise_s: float) -> None:
    """Mindlin's curve reaches `least_shear` at a known time; the detector tells within three scans of it.

    No sooner but for 5 %, and 10 % near the curve's end: it sees a straight ramp where the curve is bent.
    """
    params = SETTINGS[name]
    found = latencies(recording(held(10, 1e-4)), params, InjectedOnset(WEAK_SHEAR, rise_s))
    there_s = rise_s * (1 - (1 - params.shear / WEAK_SHEAR) ** (2 / 3))
    assert len(found) == 20
    assert min(found) >= (0.95 if params.shear < WEAK_SHEAR / 2 else 0.9) * there_s
    assert max(found) <= 1.1 * there_s + 0.03


def test_an_onset_below_the_required_shear_is_never_detected() -> None:
    found = latencies(recording(held(10, 1e-4)), SETTINGS["quiet"], InjectedOnset(0.15, 0.1))
    assert found == [np.inf] * 20


@pytest.mark.parametrize("name", SETTINGS)
def test_slip_is_detected_on_a_swaying_hand(name: str) -> None:
    time_s = np.arange(30 * int(RATE_HZ)) / RATE_HZ
    sway = 0.083 * np.sin(2 * np.pi * 0.7 * time_s) * (time_s > 5)
    swaying = recording(slide(ARRAY, held(30.0, 1e-3, seed=3), sway, 40.0))
    found = latencies(swaying, SETTINGS[name], InjectedOnset(WEAK_SHEAR, 0.1))
    assert len(found) >= 15  # others fall into a swing that has been reported already
    assert max(found) < 0.6


def test_the_proposal_ignores_shakes_and_detects_slips() -> None:
    """The fast setting reports shakes of 0.03 to 0.12; the proposal does not, and detects slip in time."""
    sizes = np.linspace(0.03, 0.12, 6)
    found = quietly(recording(held(6, 3e-4)), shaken(sizes))
    assert found.settings["fast"].motion.count >= len(sizes)
    assert found.proposed.motion.count == 0
    assert not found.out_of_reach
    assert found.silent_shear is not None
    assert max(sizes) <= found.proposed.params.shear < WEAK_SHEAR
    assert found.proposed.params.shear >= found.silent_shear
    assert list(found.shear_alarms) == sorted(found.shear_alarms, reverse=True)
    for latency in found.proposed.latency.values():
        assert latency.missed == 0
        assert latency.low_s <= latency.median_s <= latency.high_s
    words = in_words(found)
    assert "extrapolated from" in words
    assert "rule of three" in words
    assert "does not prove 1 per hour; 3 h" in words


def test_shakes_as_strong_as_slip_are_out_of_reach() -> None:
    found = quietly(recording(held(6, 3e-4)), shaken(np.linspace(0.3, 0.9, 4)))
    assert found.out_of_reach
    assert found.proposed.params.shear < WEAK_SHEAR
    assert "out of reach" in in_words(found)


@pytest.fixture(scope="module")
def still() -> Study:
    alone = recording(held(6, 3e-4))
    return quietly(alone, alone)


def test_a_still_motion_proposes_the_fastest_setting_with_its_bound(still: Study) -> None:
    assert still.shear_tail is None
    assert still.proposed.params.shear == SHEARS[0]
    assert "nothing can be extrapolated" in in_words(still)


def test_the_contact_model_reports_the_shakes_that_its_probability_asks_for() -> None:
    found = reports_by_probability(shaken(np.array([0.05, 0.3, 0.6])))
    assert found["grip-fast"].count > 0
    assert found["grip-quiet"].count <= found["grip-fast"].count
    assert reports_by_probability(recording(held(10.0, 3e-4)))["grip-fast"].count == 0


def test_alarms_in_the_quiet_hold_are_reported() -> None:
    found = quietly(shaken(np.full(5, 0.1)), recording(held(6, 3e-4)))
    assert found.restless
    assert "the hold was not quiet" in in_words(found)
    assert found.proposed.params.false_alarms_per_hour == 1.0
    assert found.settings["fast"].quiet.count > 0
    assert found.proposed.quiet.count == 0


def test_the_proposed_toml_is_a_valid_configuration(still: Study) -> None:
    slip = DetectParams.model_validate(tomllib.loads(as_toml(still))["detect"]).slip
    assert slip.shear == still.proposed.params.shear
    assert slip.false_alarms_per_hour == still.proposed.params.false_alarms_per_hour


@pytest.mark.parametrize(
    ("volts", "says"),
    [
        (held(6, 3e-4) - 1.2, "no contact in 6.0 s .*: grip an object"),
        (held(2, 3e-4), "1.0 s of unbroken contact in 2.0 s, at least 4 s are needed"),
    ],
)
def test_too_little_contact_names_what_to_do(volts: Floats, says: str) -> None:
    with pytest.raises(DataError, match=f"it: {says}"):
        quietly(recording(volts), recording(held(6, 3e-4)))
    if "no contact" in says:
        with pytest.raises(DataError, match=f"it: {says}"):
            quietly(recording(held(6, 3e-4)), recording(volts))


def test_the_press_is_no_part_of_the_hold() -> None:
    volts = np.concatenate([held(2, 3e-4) - 1.2, held(8, 3e-4), held(2, 3e-4) - 1.2])
    stuck = volts.copy()
    stuck[:, 17] = 2.9  # one side alone is no contact
    for seen in (volts, stuck):
        (block,) = quiet_part(recording(seen)).blocks
        assert (block.index[0], block.index[-1]) == (300, 999)


def test_lost_scans_of_the_hold_are_reported() -> None:
    whole, torn = regular_block(held(12, 3e-4), RATE_HZ), Gap(7, "missing", 507)
    late = replace(whole[507:], late=np.arange(693) < 3)
    found = quietly(Recording("it", ARRAY, (whole[:500], torn, late)), recording(held(6, 3e-4)))
    assert found.hold_s == pytest.approx(5.93)  # the longer part, without the second after its touch
    assert "quiet hold: 5.9 s of contact in 11.9 s (it); 7 scans lost, 3 late" in in_words(found)


def test_lost_and_late_scans_are_counted() -> None:
    scans = Collector(ARRAY)
    for k in (*range(10), *range(13, 20), *range(3)):
        volts, valid = tuple(k + c / 36 for c in range(36)), tuple(c != k for c in range(36))
        scans.add(
            ScanEvent(
                time_s=k / 100, index=k, volts=volts, valid=valid, time_sd_s=1e-4, age_s=0.0, late=k in (5, 6)
            )
        )
    found = scans.recording("it", RATE_HZ, (0.0,) * 36)
    block = found.blocks[1]
    assert (block.time_s[2], block.time_sd_s[2], block.index[2]) == (0.15, 1e-4, 15)
    assert block.volts[2].tolist() == [15 + c / 36 for c in range(36)]
    assert np.flatnonzero(~block.valid[2]).tolist() == [15]
    assert [(g.n_missing, g.cause) for g in found.items if isinstance(g, Gap)] == [
        (3, "missing"), (0, "restart"),
    ]  # fmt: skip
    assert (found.lost, found.late) == (3, 2)
    assert found.seconds == pytest.approx(0.2)


def test_a_recording_of_ours_gives_the_scans_that_were_live(tmp_path: Path) -> None:
    live = Pipeline(load_layout("board-v1"), ARRAY)
    scans: list[ScanEvent] = []
    with RecordingWriter(tmp_path / "demo.mcap", Header(load_board("board-v1", ARRAY.name))) as writer:
        for now_s, data in Simulation(load_scene("flat-simulation"), live.layout, duration_s=1.0):
            writer.read(Read(now_s, 1.7e9, data))
            scans += [out for out in live.receive_data(data, now_s) if isinstance(out, ScanEvent)]
    (block,) = read_recording(tmp_path / "demo.mcap").blocks
    assert block.volts.tolist() == [list(scan.volts) for scan in scans]
    assert block.time_s.tolist() == [scan.time_s for scan in scans]
    assert live.hello is not None
    assert block.channel_offset_s.tolist() == list(live.hello.channel_offset_s)


def first_seconds(seed: int) -> Scene:
    """`persistent-contact` without its two minutes of creep."""
    document = QUIET["persistent-contact"](seed).model_dump()
    document["phases"][-1]["duration_s"] = 5.0
    return Scene.model_validate(document)


def test_emulated_scenes_from_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A contact that nothing disturbs, then an arm that starts and stops; nothing slips in either."""
    noise_v = 1e-3
    scenes = {"persistent-contact": first_seconds, "arm-acceleration": QUIET["arm-acceleration"]}
    for name, family in scenes.items():
        block = play(name, family, 2).read(noise_v, 0)
        np.savez(tmp_path / f"{name}.npz", time_s=block.time_s, volts=block.volts)
    tune_files(tmp_path / "persistent-contact.npz", tmp_path / "arm-acceleration.npz", None, 1.0)
    out, err = capsys.readouterr()
    found = json.loads(out)
    sd_v = np.array(list(found["noise_sd_v"].values()))
    assert sd_v == pytest.approx(np.full(36, read_sd_v(noise_v)), rel=0.1)
    settings_found = found["settings"]
    assert settings_found["fast"]["alarms_quiet"]["count"] == 0
    assert settings_found["fast"]["alarms_motion"]["count"] > 0
    assert settings_found["proposed"]["alarms_motion"]["count"] == 0
    assert found["proposed"]["proven_per_hour"]["high"] == pytest.approx(
        3 * 3600 / found["motion"]["contact_s"], rel=0.002
    )
    medians = [
        [latency["median_s"] for latency in settings_found[name]["latency"]]
        for name in ("fast", "balanced", "quiet")
    ]
    assert all(a < b < c for a, b, c in zip(*medians, strict=True))
    assert "[detect.slip]" in err
