"""Recordings with known truth: shear and contact that were put in come out again."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from random_scenes import arm_acceleration
from scipy.stats import poisson

from bench.worlds.emulated import play
from tactiled.array import Array, load_array
from tactiled.detect.contact.friction import FRICTION_LOG_SD
from tactiled.detect.contact.hysteresis import SETTINGS
from tactiled.detect.suite import DetectParams
from tactiled.emulator.scene.description import Scene, load_scene
from tactiled.emulator.scene.families.parts import begin, hold_phase
from tactiled.emulator.simulate import Simulation
from tactiled.errors import DataError
from tactiled.events.types import ScanEvent
from tactiled.pipeline import Pipeline
from tactiled.recording.contents import Header, Input, Read, load_board
from tactiled.recording.writer import RecordingWriter
from tactiled.samples.block import ScanBlock, regular_block
from tactiled.scan_log import read_log
from tactiled.tune.recordings import read_pair
from tactiled.tune.run import as_toml, in_words, judge
from tactiled.tune.study import Friction, Recording, ReportCount, Study, rate_interval, study
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
    along = (
        np.cos(np.radians(30.0)) * ARRAY.shear_weights()[0]
        + np.sin(np.radians(30.0)) * ARRAY.shear_weights()[1]
    )
    return recording(volts + 1.2 * share[:, np.newaxis] * np.sign(along.sum(axis=0)))


def quietly(quiet: Recording, motion: Recording, accepted_per_hour: float = 60.0) -> Study:
    return study(quiet, motion, accepted_per_hour, lambda _: None)


@pytest.fixture(scope="module")
def shakes() -> Study:
    return quietly(recording(held(6, 3e-4)), shaken(np.array([0.05, 0.1, 0.2, 0.3])))


def test_stricter_settings_report_fewer_shakes(shakes: Study) -> None:
    totals = [found.motion.total for found in shakes.settings.values()]
    assert list(shakes.settings) == list(SETTINGS)
    assert totals == sorted(totals, reverse=True)
    assert totals[0] > 0
    assert all(found.quiet == ReportCount(0, 0) for found in shakes.settings.values())


def test_the_proposal_is_the_earliest_setting_that_reports_no_more_than_accepted() -> None:
    quiet, motion = recording(held(6, 3e-4)), shaken(np.array([0.05, 0.1, 0.2, 0.3]))
    for accepted in (1.0, 3600.0):
        found = quietly(quiet, motion, accepted)
        most = accepted * found.motion_s / 3600
        names = [name for name, some in found.settings.items() if some.motion.total <= most]
        assert found.proposed == (names or ["quiet"])[0]
        assert found.is_accepted == bool(names)
        assert f"proposed for {accepted:g} reports per hour: {found.proposed}" in in_words(found)


@pytest.fixture(scope="module")
def still() -> Study:
    alone = recording(held(6, 3e-4))
    return quietly(alone, alone, 1.0)


def test_a_still_motion_proposes_the_earliest_setting_with_its_bound(still: Study) -> None:
    assert still.proposed == "fast"
    assert still.friction is None
    words = in_words(still)
    assert "rule of three" in words
    assert "does not prove 1 per hour; 3 h" in words
    assert "no more about it than the prior" in words


def test_a_motion_that_is_reported_at_every_setting_is_said() -> None:
    found = quietly(recording(held(6, 3e-4)), shaken(np.linspace(0.6, 1.2, 4)), 1.0)
    assert not found.is_accepted
    assert found.proposed == "quiet"
    assert "announce such motion" in in_words(found)


def test_slips_in_the_quiet_hold_are_reported() -> None:
    found = quietly(shaken(np.full(5, 1.5)), recording(held(6, 3e-4)))
    assert "the hold was not quiet" in in_words(found)


def test_shear_that_is_borne_narrows_friction_and_the_proposal_is_a_valid_configuration() -> None:
    """A ratio of shear over load that was borne refutes all friction below it."""
    found = quietly(recording(held(6, 3e-4)), shaken(np.full(4, 0.9)))
    assert found.friction is not None
    assert found.friction.log_sd < FRICTION_LOG_SD
    params = DetectParams.model_validate(tomllib.loads(as_toml(found))["detect"])
    assert params.setting == found.proposed
    assert params.grip.friction == pytest.approx(found.friction.median, rel=0.01)
    assert params.grip.friction_log_sd == pytest.approx(found.friction.log_sd, rel=0.05)


def test_without_friction_the_proposal_is_a_setting_alone(still: Study) -> None:
    assert as_toml(still) == '[detect]\nsetting = "fast"\n'
    known = replace(still, friction=Friction(0.71234, 0.2345))
    assert tomllib.loads(as_toml(known))["detect"]["grip"] == {"friction": 0.712, "friction_log_sd": 0.23}


def test_on_an_array_without_shear_every_setting_has_the_same_reports() -> None:
    array = load_array("normal-4x4")
    found = quietly(
        recording(held(6, 3e-4, array=array), array), recording(held(6, 3e-4, array=array), array)
    )
    assert len({(some.quiet, some.motion) for some in found.settings.values()}) == 1
    assert found.friction is None
    assert "the setting does not matter" in in_words(found)
    assert "does not matter" not in in_words(quietly(recording(held(6, 3e-4)), recording(held(6, 3e-4))))


@pytest.mark.parametrize("zero_first_s", [0.0, 0.3])
def test_readings_are_relative_to_the_zero_of_the_array(zero_first_s: float) -> None:
    """The daemon subtracts it, too: an empty hand is no contact, whatever the sensor reads at rest."""
    rest = np.linspace(0.5, 1.0, ARRAY.n_channels)
    offset = replace(ARRAY, zero=(zero_first_s == 0.0) * rest, zero_first_s=zero_first_s)
    (block,) = shaken(np.array([0.05, 0.3, 0.6])).items
    assert isinstance(block, ScanBlock)
    quiet, motion = held(6, 3e-4), block.volts.copy()
    quiet[:40] -= 1.2
    motion[:40] -= 1.2
    plain = quietly(recording(quiet), recording(motion))
    found = quietly(recording(quiet + rest, offset), recording(motion + rest, offset))
    assert found.hold_s == pytest.approx(plain.hold_s, abs=0.05)
    assert found.settings == plain.settings
    with pytest.raises(DataError, match="no contact"):
        recording(held(6, 3e-4) - 1.2 + rest, offset).contact_s()


def test_a_hold_in_newtons_has_a_level_of_its_own() -> None:
    """0.5 V are no newtons: 0.4 N on each taxel of a fine array is a firm hold."""
    array = load_array("pillars-3x3")
    held_n = np.zeros((600, array.n_channels)) + 0.4 * (array.normal_weights() != 0).any(axis=0)
    held_n[:100] = 0.0
    held_n += np.random.default_rng(0).normal(0, 1e-3, held_n.shape)
    assert recording(held_n, array).contact_s() == pytest.approx(5.0, abs=0.1)
    with pytest.raises(DataError, match="no taxel above the contact level of the array, which is in N"):
        recording(held_n[:100], array).contact_s()


@pytest.mark.parametrize(
    ("volts", "says"),
    [
        (held(6, 3e-4) - 1.2, "no contact .* in 6.0 s, at least 4 s are needed: grip an object"),
        (held(2, 3e-4), "2.0 s of contact in 2.0 s, at least 4 s are needed"),
    ],
)
def test_too_little_contact_names_what_to_do(volts: Floats, says: str) -> None:
    with pytest.raises(DataError, match=f"it: {says}"):
        quietly(recording(volts), recording(held(6, 3e-4)))
    if "no contact" in says:
        with pytest.raises(DataError, match=f"it: {says}"):
            quietly(recording(held(6, 3e-4)), recording(volts))


def test_a_recording_that_was_ended_regularly_gives_the_scans_that_were_live(tmp_path: Path) -> None:
    live = Pipeline(load_layout("board-v1"), ARRAY)
    scans: list[ScanEvent] = []
    with RecordingWriter(tmp_path / "demo.mcap", Header(load_board("board-v1", ARRAY.name))) as writer:
        for now_s, data in Simulation(load_scene("flat-simulation"), live.layout, duration_s=1.0):
            writer.read(Read(now_s, 1.7e9, data))
            scans += [out for out in live.receive_data(data, now_s) if isinstance(out, ScanEvent)]
        hello = live.hello
        writer.input(Input(now_s, 1.7e9, "disconnected"))
    (block,) = read_log(tmp_path / "demo.mcap").blocks()
    assert isinstance(block, ScanBlock)
    assert block.volts.tolist() == [list(scan.volts) for scan in scans]
    assert block.time_s.tolist() == [scan.time_s for scan in scans]
    assert hello is not None
    assert block.rate_hz == pytest.approx(hello.rate_hz, rel=1e-4)  # by the times: a crystal is not exact
    assert block.channel_offset_s.tolist() == list(hello.channel_offset_s)


def undisturbed(seed: int) -> Scene:
    """A press and a hold."""
    _, scene = begin("persistent-contact", seed)
    scene["phases"] += [hold_phase(5.0)]
    return Scene.model_validate(scene)


def with_noise(scene: Scene, noise_v: float) -> Scene:
    """Set the noise, and lengthen the first hold by 3 s, in which nothing happens."""
    document = scene.model_dump() | {"electronics": {"noise_v": noise_v}}
    document["phases"][1]["duration_s"] += 3.0
    for disturbance in document["disturbances"]:
        disturbance["start_s"] += 3.0
    return Scene.model_validate(document)


def test_emulated_scenes_from_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A contact that nothing disturbs, then an arm that starts and stops; nothing slips in either."""
    noise_v = 1e-3
    scenes = {"persistent-contact": undisturbed, "arm-acceleration": arm_acceleration}
    for name, family in scenes.items():
        volts = play(with_noise(family(2), noise_v)).volts
        np.savez(tmp_path / f"{name}.npz", time_s=np.arange(len(volts)) / 100.0, volts=volts)
    judge(*read_pair(tmp_path / "persistent-contact.npz", tmp_path / "arm-acceleration.npz"), 60.0)
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert {found[name]["name"] for name in ("quiet", "motion")} == {f"{name}.npz" for name in scenes}
    for name, at in SETTINGS.items():
        some = found["settings"][name]
        assert (some["incipient_p"], some["gross_p"]) == (at.incipient, at.gross)
        assert some["quiet"] == {"incipient": 0, "gross": 0}
        assert some["motion"]["gross"] == 0
        assert some["per_hour"]["low"] <= some["per_hour"]["value"] <= some["per_hour"]["high"]
    assert found["proposed"]["setting"] in SETTINGS
    assert f'setting = "{found["proposed"]["setting"]}"' in err


@given(st.floats(1e-3, 1e3))
def test_no_report_proves_three_over_the_time(hours: float) -> None:
    low, high = rate_interval(0, hours)
    assert low == 0
    assert high == pytest.approx(3 / hours, rel=0.002)


@given(st.integers(1, 500), st.floats(1e-3, 1e3))
def test_limits_of_a_rate_are_those_at_which_the_count_is_a_rare_one(count: int, hours: float) -> None:
    low, high = rate_interval(count, hours)
    assert poisson.sf(count - 1, low * hours) == pytest.approx(0.025)
    assert poisson.cdf(count, high * hours) == pytest.approx(0.025)
