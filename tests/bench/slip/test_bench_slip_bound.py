"""Detectors of the comparison: the plain transform, threshold rules, oracle, line faults."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from bench.slip.detectors import Tuning, compared_detectors, sweep
from bench.slip.faults import FAULTS
from bench.slip.noise import NoiseTail, fit_tail, maxima, oracle_tail, rule_maxima, rule_tails
from bench.slip.oracle import Oracle
from bench.slip.quiet import run_detector
from bench.slip.rules import (
    COHERENT,
    LEVELS,
    RULES,
    coefficient_sd_v,
    coherent_rule,
    traces,
    window_coefficients,
    window_rule,
)
from bench.slip.scenes import NOISES_V, Announcement, PlayedScene, at_speed, block_of, play
from bench.slip.slips import read_slips
from tactiled.array import load_array
from tactiled.detect.base import Detector
from tactiled.detect.signal.wavelet import BankParams, SwtBank
from tactiled.emulator.scene.families import QUIET
from tactiled.emulator.scene.physical import ContactStepper
from tactiled.errors import ContractError
from tactiled.events.types import Event, SlipEvent
from tactiled.samples.block import Gap, ScanBlock

WANG = load_array("wang2019-3x3")
WIDE = NoiseTail(5.0, 0.5, 1.0)  # any tail: thresholds near 3.2 at one an hour


@pytest.fixture(scope="module")
def slide() -> PlayedScene:
    return play("1 mm/s", at_speed(1.0), 1)


def test_instants_of_a_slip_are_in_order(slide: PlayedScene) -> None:
    slip = slide.slip
    assert slip is not None
    assert slide.press_end_s < slip.shear_s < slip.incipient_s < slip.gross_s < slip.end_s
    still = slide.volts[int(slip.shear_s * 100) - 20 : int(slip.shear_s * 100) - 1]
    assert np.ptp(still, axis=0).max() < 1e-3  # nothing moves before the shear but creep


def test_a_scene_is_played_from_its_start_once(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[ContactStepper] = []
    reset = ContactStepper.reset

    def counted(source: ContactStepper) -> None:
        begun.append(source)
        reset(source)

    monkeypatch.setattr(ContactStepper, "reset", counted)
    held = play("inclined-load", QUIET["inclined-load"], 1)
    assert held.duration_s > 4.0  # longer than a contact model keeps
    assert len(begun) <= 2  # where it is made


@pytest.mark.parametrize("level", [1, 3, 5])
def test_the_bank_is_the_plain_transform_of_the_window(level: int, slide: PlayedScene) -> None:
    block = slide.read(1e-3, draw=1)
    bank = SwtBank(WANG, BankParams(levels=(level,))).process(block).volts[:, 0]
    for n in (300, 480, 500, 700):
        np.testing.assert_allclose(
            bank[n], window_coefficients(block.volts[n - 255 : n + 1], level), atol=2e-6
        )


def test_window_rule_reports_the_first_crossing_of_its_threshold(slide: PlayedScene) -> None:
    block = slide.read(0.3e-3, draw=1)
    events = window_rule(WANG, 2, 3e-3).process(block)
    chunked = window_rule(WANG, 2, 3e-3)
    assert [e for n in range(len(block)) for e in chunked.process(block[n : n + 1])] == events
    first = next(e for e in events if isinstance(e, SlipEvent) and e.detected_s > 4)
    trace = traces(WANG, block, 0.3e-3)["any channel", 2] * coefficient_sd_v(2, 0.3e-3)
    assert trace[round(first.detected_s * 100)] >= 3e-3
    assert trace[400 : round(first.detected_s * 100)].max() < 3e-3


def test_rules_have_unit_noise() -> None:
    hold = block_of(
        np.rint(1600 + 2.0 * np.random.default_rng(1).standard_normal((20000, 36))).astype(np.int64)
    )
    found = traces(WANG, hold, 2.0 * 3.0 / 4096)
    for level in LEVELS:
        # A Rayleigh variable of unit scale: mean of squares 2.
        assert np.mean(found["whole array", level][400:] ** 2) == pytest.approx(2.0, rel=0.15)
    assert all((found["opposed channel", n] <= found["any channel", n]).all() for n in LEVELS)
    assert {rule for rule, _ in found} == {*RULES, COHERENT[0]}


def test_coherent_levels_are_matched_to_a_kink_in_any_direction() -> None:
    weights = WANG.shear_weights().sum(axis=1)
    # A load that grows evenly from scan 400 on, along 30 degrees: what the rule is built for.
    way = np.cos(np.deg2rad(30)) * weights[0] + np.sin(np.deg2rad(30)) * weights[1]
    ramp = np.maximum(np.arange(600.0) - 400, 0)[:, np.newaxis] * way / np.linalg.norm(way) * 1e-3
    block = replace_volts(block_of(np.full((600, 36), 1600)), 1.2 + ramp)
    trace = traces(WANG, block, 1e-3)[COHERENT]
    assert trace[300:401].max() < 1e-6
    assert trace[402] < trace[406] < trace[412] < trace[425]  # evidence grows with what has been seen
    # Of unit noise, however the levels overlap: a mean square of 2 an age, and the largest of 18 is above.
    noise = np.random.default_rng(4).standard_normal((30_000, 36))
    quiet = traces(WANG, replace_volts(block_of(np.full((30_000, 36), 1600)), 1.2 + 1e-3 * noise), 1e-3)
    assert 1.5 < np.median(quiet[COHERENT][400:]) < 3.0
    threshold = 5.5
    events = coherent_rule(WANG, 1e-3, threshold).process(block)
    (onset,) = [e for e in events if isinstance(e, SlipEvent)][:1]
    assert onset.detected_s * 100 == pytest.approx(int(np.argmax(trace >= threshold)))
    assert onset.direction_deg % 180 == pytest.approx(30.0, abs=0.5)


def replace_volts(block: ScanBlock, volts: NDArray[np.float64]) -> ScanBlock:
    """Block with other volts, not rounded by an ADC."""
    return replace(block, volts=volts)


def test_fit_recovers_the_tail_of_known_maxima() -> None:
    rng = np.random.default_rng(3)
    drawn = np.sqrt(2 * rng.exponential(size=400_000))  # P(> z) = exp(-z^2 / 2)
    tail = fit_tail(drawn, hours=10.0)
    true = np.sqrt(2 * np.log(400_000 / 10.0 / 20.0))  # at 20 an hour
    assert tail.threshold(20.0) == pytest.approx(true, rel=0.01)
    assert tail.per_hour(np.array(tail.threshold(7.0))) == pytest.approx(7.0)


def test_the_oracle_has_its_rate_and_is_never_later_than_a_rule(slide: PlayedScene) -> None:
    oracle = Oracle(slide)
    tail = oracle_tail([oracle], hours=0.3, seed=1)
    noise = np.random.default_rng(9).standard_normal((180_000, oracle.n_combinations))
    alarms = (maxima(oracle.noise_trace(noise)) > tail.threshold(100.0)).sum()  # in half an hour: 50
    assert 25 < alarms < 85
    tails = rule_tails([rule_maxima(0, seed=1)])
    for case in read_slips(Tuning(tails, dict.fromkeys(NOISES_V, 2)), tail, (), "1 mm/s", 1):
        rules = np.array([case.rule_s[key] for key in tails])
        assert (np.nan_to_num(rules, nan=np.inf) >= case.oracle_s - 0.02).all()


def test_the_oracle_refuses_a_scene_without_slip(slide: PlayedScene) -> None:
    still = PlayedScene("still", 1, slide.volts, 1.0, None, (), (), np.zeros(len(slide.volts)))
    with pytest.raises(ContractError, match="none"):
        Oracle(still)


@pytest.mark.parametrize("name", sorted(FAULTS))
def test_faults_leave_consecutive_blocks(name: str, slide: PlayedScene) -> None:
    stream = FAULTS[name](slide.counts(1e-3, 1), np.random.default_rng(5))
    assert [n for n, item in enumerate(stream) if isinstance(item, Gap)] == list(range(1, len(stream), 2))
    ends = [item for item in stream if isinstance(item, ScanBlock)]
    for before, gap, after in zip(stream[::2], stream[1::2], stream[2::2], strict=False):
        assert isinstance(before, ScanBlock)
        assert isinstance(gap, Gap)
        assert isinstance(after, ScanBlock)
        assert gap.index == after.index[0] == before.index[-1] + 1 + (gap.n_missing or 50)
    assert sum(len(block) for block in ends) <= len(slide.volts)


class _EveryHundredth:
    """Detector that reports an incipient slip at every hundredth scan."""

    def process(self, item: ScanBlock | Gap) -> list[Event]:
        if isinstance(item, Gap):
            return []
        return [_slip(float(t)) for t, n in zip(item.time_s, item.index, strict=True) if n % 100 == 0]

    def reset(self) -> None: ...


def _slip(time_s: float) -> SlipEvent:
    return SlipEvent(
        time_s=time_s,
        state="onset",
        kind="incipient",
        onset_s=time_s,
        onset_sd_s=0.01,
        direction_deg=0.0,
        direction_sd_deg=1.0,
        confidence=1.0,
        taxels=(0,),
        detector="every-hundredth",
        statistic=1.0,
        threshold=1.0,
        valid=True,
        detected_s=time_s,
    )


def test_events_in_an_announced_motion_are_not_valid(slide: PlayedScene) -> None:
    said = (Announcement("inhibit", 2.0, 0.5), Announcement("load-change", 0.0, 1.0))
    unannounced, announced = run_detector(_EveryHundredth(), [slide.read(1e-3, 1)], said)
    assert [e.time_s for e in announced] == [e.time_s for e in unannounced] == list(range(len(unannounced)))
    assert all(e.valid for e in unannounced if isinstance(e, SlipEvent))
    assert [e.time_s for e in announced if isinstance(e, SlipEvent) and not e.valid] == [0, 1, 2]


def test_every_compared_detector_runs_and_has_a_rate() -> None:
    tails = {(rule, level): WIDE for rule in RULES for level in LEVELS} | {COHERENT: WIDE}
    for compared in (compared_detectors(Tuning(tails, dict.fromkeys(NOISES_V, 2))) | sweep()).values():
        detector: Detector = compared.build(WANG, 1e-3)
        detector.process(block_of(np.full((50, 36), 1600)))
        assert compared.per_hour(1e-3) > 0
