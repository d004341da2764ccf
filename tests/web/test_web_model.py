"""What the page keeps of a board, judged in the page's own modules."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import msgpack
import numpy as np
import pytest
from messages import CONTACT, SLIP
from pages import robot
from playwright.sync_api import Page
from verdicts import AT_S, CASES, Case

from tactiled.events.codec import to_map
from tactiled.events.types import CommandEvent, Event, TextureEvent, TextureStatus
from tactiled.events.words import event_words
from tactiled.web.feed import pack_frame

pytestmark = pytest.mark.system

MODEL = """async () => {
  const { BoardModel } = await import("/static/board.js");
  const { verdict } = await import("/static/verdict.js");
  const { SteadyLamp } = await import("/static/freshness.js");
  const { channelCurve, valueAt } = await import("/static/curves.js");
  const board = new BoardModel(0, "TS1");
  const common = (run, at) => ({ v: 1, board: "TS1", run, timestamp: at });
  const status = (run, at, contact) => board.take("status", { ...common(run, at), contact, rate_hz: 100 });
  const scan = (run, at) => board.take("scan", { ...common(run, at), index: at, volts: [], valid: [] });
  const touch = (run, at) => {
    board.take("contact", { ...common(run, at), seq: 0, state: "holding", taxels: [0] });
    const slip = { ...common(run, at), seq: 0, state: "onset", kind: "gross", valid: true };
    board.take("slip", { ...slip, onset: at, detected: at });
    board.take("grip", { ...common(run, at), seq: 0, state: "sticking" });
    board.take("force", { ...common(run, at), seq: 0 });
    board.take("texture", { ...common(run, at), seq: 0, status: "ok" });
  };
  const known = () => ["touch", "slip", "grip", "force", "texture"].filter((name) => board[name] !== null);
  status(1, 10, "none"); scan(1, 10); touch(1, 10);
  ACT
}"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of the page of a server whose daemon does not run."""
    with robot(tmp_path_factory.mktemp("robot")) as made:
        yield made.serve()


@pytest.fixture
def opened(address: str, page: Page) -> Page:
    page.goto(address)
    return page


def model(page: Page, act: str) -> Any:
    """Run statements on a board that is touched, slips and is gripped at 10 s; return what they return."""
    return page.evaluate(MODEL.replace("ACT", act))


def test_a_restart_of_the_daemon_ends_what_its_last_run_said(opened: Page) -> None:
    assert model(opened, "return known()") == ["touch", "slip", "grip", "force", "texture"]
    assert model(opened, 'status(2, 20, "none"); return known()') == []
    assert model(opened, 'status(2, 20, "none"); return board.slips.map((slip) => slip.to)') == [10]
    assert model(opened, 'status(2, 20, "none"); return board.bands.at(-1).state') == "none"
    assert model(opened, 'status(1, 10.1, "holding"); return known().length') == 5


def test_a_slip_and_a_contact_whose_ends_were_lost_end_with_the_next_status(opened: Page) -> None:
    act = """
      const say = (at, contact, slipping) => {
        board.take("status", { ...common(1, at), contact, slipping, rate_hz: 100 });
        const said = verdict(board, at).sentence;
        return [board.slip !== null, board.touch?.state ?? null, board.slips[0].to, said];
      };
      board.texture = { timestamp: 10.2, status: "low-snr" };
      const said = [say(10.05, "none", false), say(11.5, "holding", true), say(11.6, "none", false)];
      return [...said, board.texture];"""
    early, going, ended, texture = model(opened, act)
    assert texture is None
    assert early[:3] == [True, "holding", None]  # a status that was made before the slip
    assert going[:3] == [True, "holding", None]
    assert ended == [False, None, 11.6, "Nothing touches the skin"]


def test_a_clock_that_is_set_back_does_not_freeze_the_page(opened: Page) -> None:
    """What the page had kept lies in the future then, and its newest scan would be fresh for ever."""
    act = """
      const at = (seq, s) => board.take("scan", { ...common(1, s), seq, index: seq, volts: [], valid: [] });
      at(1, 20); at(2, 20.01); at(3, 20); at(4, 20.005);  // corrected by some milliseconds
      const corrected = board.newestScan.timestamp;
      at(2, 5); const sentAgain = board.newestScan.timestamp; // by a server to which the page connects anew
      at(5, 5); at(6, 5.01);
      return [corrected, sentAgain, board.newestScan.timestamp];"""
    assert model(opened, act) == [20.01, 20.01, 5.01]


def test_forces_and_margins_that_come_no_more_are_not_shown(opened: Page) -> None:
    now = "return [board.grip, board.force].map((message) => board.current(message) !== null)"
    assert model(opened, f"scan(1, 10.2); {now}") == [True, True]
    assert model(opened, f"scan(1, 10.5); {now}") == [False, False]


@pytest.mark.parametrize(
    ("run", "index", "words"),
    [
        (1, 40, "no scans for 3.0 s"),
        (1, 0, "the board started anew, no scans for 3.0 s"),
        (2, 0, "new run of the daemon, no scans for 3.0 s"),
    ],
)
def test_nothing_is_drawn_over_a_time_without_scans(opened: Page, run: int, index: int, words: str) -> None:
    act = f"""
    board.take("info", {{ zero: [0] }});
    board.take("geometry", {{ unit: "V", names: ["t0.a"], has_shear: false,
      pressure: [[[0, 1]]], shear_x: [[]], shear_y: [[]] }});
    const held = {{ volts: [1], valid: [true] }};
    const reading = (run, index, at) => board.take("scan", {{ ...common(run, at), index, ...held }});
    for (let n = 1; n < 20; n += 1) reading(1, 10 + n, 10 + 0.1 * n);  // thinned, as in the history
    for (let n = 0; n < 20; n += 1) reading({run}, {index} + n, 14.9 + 0.1 * n);
    const p = board.points, broken = p.t.filter((_, i) => p.load[i] === null && p.shear[i] === null);
    return [broken, board.gaps.map((gap) => gap.words), board.bands.map((band) => band.state)];"""
    broken, gaps, bands = model(opened, act)
    assert [11.9 < at < 14.9 for at in broken] == [True]
    assert gaps == [words]
    # What holds in a gap is not known. After it, the contact goes on where only scans are missing.
    assert bands == ["none", "holding", "none", "holding"][: 4 if words.startswith("no scans") else 3]


def test_a_contact_that_a_gap_ended_is_not_drawn_behind_it(opened: Page) -> None:
    """The daemon publishes the first scan behind a gap before the message that the contact has ended."""
    act = """
    scan(1, 10.2); scan(1, 15);
    board.take("contact", { ...common(1, 10.2), seq: 9, state: "none", taxels: [] });
    return board.bands.map((band) => band.state);"""
    assert model(opened, act) == ["none", "holding", "none"]


def test_the_page_unpacks_what_the_server_packs(opened: Page) -> None:
    whole = [0, 127, 128, 255, 256, 65_535, 65_536, 2**32, -1, -32, -33, -200, -40_000, -(2**40)]
    texts = ["", "grün", "x" * 40, "x" * 300, "x" * 70_000]
    values = [*whole, *texts, 0.1, True, False, [], [[1]] * 20, {}, {"k": {str(n): n for n in range(20)}}]
    volts = msgpack.ExtType(1, np.arange(36, dtype="<f4").tobytes())
    frame = pack_frame(1e9, 2.5, [msgpack.packb([values, volts])])
    unpacked = opened.evaluate(
        """async (octets) => {
          const { unpack } = await import("/static/unpack.js");
          const { now, mono, m: [[values, volts]] } = unpack(new Uint8Array(octets).buffer);
          return [now, mono, values, Array.from(volts)];
        }""",
        list(frame),
    )
    assert unpacked == [1e9, 2.5, values, list(range(36))]


@pytest.mark.parametrize("case", CASES)
def test_one_sentence_says_what_the_contact_does(opened: Page, case: Case) -> None:
    act = f"""
      board.take("slip", {{ ...common(1, 11), seq: 5, state: "end", kind: "gross", valid: true }});
      scan(1, {AT_S});
      for (const [topic, data] of Object.entries({json.dumps(case.messages())}))
        board.take(topic, {{ ...common(1, {AT_S}), seq: 1, ...data }});
      return verdict(board, {AT_S});"""
    found = model(opened, act)
    plain = found["sentence"].replace("−", "-").replace("\u00a0", " ")  # the page has signs of its own
    assert (found["level"], plain, found["sure"]) == (case.level, case.sentence, case.sure)


def test_forces_and_readings_point_the_same_way(opened: Page) -> None:
    act = """
      board.take("info", { zero: [0, 0] });
      board.take("geometry", { unit: "V", names: ["a", "b"], has_shear: true,
        pressure: [[[0, 1]]], shear_x: [[[1, 1]]], shear_y: [[]] });
      const at = (index, calibration) => {
        const force = { fx_n: -3, fy_n: 0, fz_n: 10, fx_sd_n: 1, fy_sd_n: 1, fz_sd_n: 1, calibration };
        board.take("force", { ...common(1, 20), seq: index, ...force });
        board.take("scan", { ...common(1, 20 + 0.01 * index), index, volts: [2, 0.5], valid: [true, true] });
        const { unit, load, shear, deg } = board.loads();
        return [unit, load, shear, deg];
      };
      return ["none", "nominal", "finger-7"].map((calibration, index) => at(index, calibration));"""
    # The object pushes the skin to -x where the skin goes to +x.
    assert model(opened, act) == [["V", 2, 0.5, 0], ["V", 2, 0.5, 0], ["N", 10, 3, 0]]


def test_a_load_that_is_not_known_is_not_drawn(opened: Page) -> None:
    """A calibration of shear alone says so by its standard deviation."""
    act = """
      board.take("info", { zero: [0] });
      board.take("geometry", { unit: "V", names: ["a"], has_shear: false,
        pressure: [[[0, 1]]], shear_x: [[]], shear_y: [[]] });
      const force = { fx_n: 3, fy_n: 4, fz_n: 0, fx_sd_n: 1, fy_sd_n: 1, fz_sd_n: 1e9, calibration: "mine" };
      board.take("force", { ...common(1, 20), seq: 0, ...force });
      board.take("scan", { ...common(1, 20), index: 20, volts: [2], valid: [true] });
      const { unit, load, shear } = board.loads();
      return [unit, load, shear, board.points.load.at(-1)];"""
    assert model(opened, act) == ["N", None, 5, None]


@pytest.mark.parametrize("noise_lsb", [0.08, 0.15, 0.3, 3.0])
@pytest.mark.parametrize("presses", [False, True])
def test_only_channels_with_faults_are_called_so(opened: Page, noise_lsb: float, presses: bool) -> None:
    """Noise below one count moves few readings of a scan; a press bends those of the taxels under it."""
    rng = np.random.default_rng(0)
    readings = 100.0 + rng.uniform(size=36) + noise_lsb * rng.normal(size=(100, 36))
    readings[:, 5] += 200.0 * noise_lsb * rng.normal(size=100) + 20.0 * rng.normal(size=100)
    if presses:
        readings[30:32, 7] += 1000.0
        readings[60:, 7] += 500.0
    readings = np.round(readings)
    readings[:, 3], readings[-1, 9] = 100.0, 0.0
    act = f"""
      board.health = Array(36).fill("");
      const valid = Array.from({{ length: 36 }}, (_, k) => k !== 9);
      board.scans = {json.dumps(readings.tolist())}.map((volts) => ({{ volts, valid }}));
      board.judgeChannels();
      return Object.fromEntries(board.health.map((fault, k) => [k, fault]).filter(([, fault]) => fault));"""
    found = model(opened, act)
    assert set(found.items()) <= {("3", "stuck"), ("5", "noisy"), ("9", "dead")}
    if noise_lsb >= 1.0:
        assert len(found) == 3


def test_the_clock_of_the_server_follows_its_sleep_its_steps_and_delays(opened: Page) -> None:
    """Its monotonic clock stands still while the host sleeps; a frame may be late after that."""
    act = """
      const { ServerClock } = await import("/static/stream.js");
      const after = (browser, mono, wall, late = 0) => {
        const clock = new ServerClock();
        const at = { perf: 100, mono: 1000, now: 1.7e9 };
        const frame = (dPerf, dMono, dWall, delay) => {
          at.perf += dPerf; at.mono += dMono; at.now += dWall;
          clock.observe(at.now, at.mono, at.perf + delay);
        };
        for (let k = 0; k < 50; k += 1) frame(0.1, 0.1, 0.1, 0);
        frame(browser, mono, wall, late);
        const wrong = [clock.at(at.perf + late) - at.now - late];
        for (let k = 0; k < 50; k += 1) frame(0.1, 0.1, 0.1, 0);
        return [...wrong, clock.at(at.perf) - at.now];
      };
      return [
        after(30, 0.1, 30), after(30, 0.1, 30, 2), after(0.1, 0.1, 3600), after(0.1, 0.1, -3600),
        after(0.1, 0.1, 0.1, 5),
      ];"""
    for wrong in model(opened, act):
        assert wrong == pytest.approx([0.0, 0.0], abs=1e-3)


def test_a_list_of_recordings_that_is_refused_says_why(opened: Page) -> None:
    act = """
      await (await import("/static/recordings.js")).listRecordings();
      return document.querySelector("#recordings p").textContent;"""
    assert "start tactiled web with --recordings" in model(opened, act)


def test_a_token_of_any_characters_leaves_the_page_as_it_is(opened: Page) -> None:
    act = """
      const { takeToken } = await import("/static/commands.js");
      return ["abcd+efgh/ijkl==mnop", "S3cr3t-100%-Sure-Tok"].map((token) => {
        location.hash = `#token=${token}`;
        return [takeToken(), location.hash];
      });"""
    assert model(opened, act) == [["abcd+efgh/ijkl==mnop", ""], ["S3cr3t-100%-Sure-Tok", ""]]


def test_the_curves_of_forces_outlast_a_time_without_scans(opened: Page) -> None:
    """The first scan after it comes before its force; a calibration that is gone begins new curves."""
    act = """
      board.take("info", { zero: [0] });
      board.take("geometry", { unit: "V", names: ["a"], has_shear: false,
        pressure: [[[0, 1]]], shear_x: [[]], shear_y: [[]] });
      let seq = 0;
      const alone = (run, s) =>
        board.take("scan", { ...common(run, s), index: seq, volts: [2], valid: [true] });
      const at = (run, s, calibration) => {
        const force = { fx_n: 0, fy_n: 0, fz_n: 10, fx_sd_n: 1, fy_sd_n: 1, fz_sd_n: 1, calibration };
        alone(run, s);
        board.take("force", { ...common(run, s), seq: seq++, ...force });
      };
      const shown = [];
      const play = (run, from, calibration) => {
        status(run, from, "none");
        for (let s = from; s < from + 3; s += 0.1) at(run, s, calibration);
        shown.push([board.unit, board.points.load.filter((load) => load !== null).length]);
      };
      play(1, 20, "finger-7");
      for (let s = 23.1; s < 24.5; s += 0.1) alone(1, s); // a server that was held up
      play(1, 30, "finger-7"); play(2, 40, "finger-7"); play(2, 43, "none");
      return shown;"""
    found = model(opened, act)
    assert [unit for unit, _ in found] == ["N", "N", "N", "V"]
    counts = [count for _, count in found]
    assert 25 <= counts[0] < counts[1] - 20 < counts[2] - 40
    assert counts[3] <= 31


def test_curves_keep_the_zero_of_their_time_and_newtons_need_none(opened: Page) -> None:
    act = """
      board.take("geometry", { unit: "V", names: ["a"], has_shear: false,
        pressure: [[[0, 1]]], shear_x: [[]], shear_y: [[]] });
      const volts = new Float32Array([3]);
      const at = (s) => board.take("scan", { ...common(1, s), index: s, volts, valid: [true] });
      const info = (zero) => board.take("info", { zero });
      info([]); at(20); info([1]); at(21); info([3]); at(22); // first scans are not in, are in, after a tare
      const { t, load } = board.points, curve = channelCurve(0, "a", 0);
      const rows = t.map((s, i) => [s, load[i], valueAt(curve, board, i)]);
      const newtons = { fx_n: 0, fy_n: 0, fz_n: 10, fx_sd_n: 1, fy_sd_n: 1, fz_sd_n: 1 };
      info([]);
      board.take("force", { ...common(1, 22), seq: 0, calibration: "finger-7", ...newtons });
      return [rows.filter((row) => Number.isInteger(row[0])), board.loads().load];"""
    assert model(opened, act) == [[[20, None, None], [21, 2, 2], [22, 0, 0]], 10]


@pytest.mark.parametrize(("run", "sent", "unit"), [(1, 0, "N"), (2, 0, "V"), (2, 1, "N")])
def test_a_daemon_that_states_no_force_is_not_waited_for(
    opened: Page, run: int, sent: int, unit: str
) -> None:
    act = f"""
      board.take("info", {{ zero: [0] }});
      board.take("geometry", {{ unit: "V", names: ["a"], has_shear: false,
        pressure: [[[0, 1]]], shear_x: [[]], shear_y: [[]] }});
      const at = (run, s) =>
        board.take("scan", {{ ...common(run, s), index: Math.round(10 * s), volts: [2], valid: [true] }});
      const newtons = {{ fx_n: 0, fy_n: 0, fz_n: 10, fx_sd_n: 1, fy_sd_n: 1, fz_sd_n: 1 }};
      board.take("force", {{ ...common(1, 20), seq: 0, calibration: "finger-7", ...newtons }});
      at(1, 20);
      const sent = {{ scan: 102, force: {sent} }};
      board.take("status", {{ ...common({run}, 21), contact: "none", rate_hz: 100, sent }});
      at({run}, 21);
      return board.unit;"""
    assert model(opened, act) == unit


def test_no_number_has_the_sign_of_zero_or_is_none(opened: Page) -> None:
    found = opened.evaluate("""async () => {
      const { fixed, pm, sig } = await import("/static/words.js");
      const near = [-0.0004, -0, 0, 1e-9, -1e-9, NaN, Infinity];
      return [near.map((v) => fixed(v, 2)), near.map((v) => sig(v)), near.map((v) => pm(v, 0.3, "N")),
        near.map((v) => pm(v, 0, "V"))];
    }""")
    zero, none = "0.00", "–"
    assert found[0] == [zero, zero, zero, zero, zero, none, none]
    assert found[1] == ["-0.000400", "0", "0", "0.000000", "0.000000", none, none]
    assert found[2] == ["0.0 ± 0.3 N"] * 5 + [f"{none} ± 0.3 N"] * 2
    assert found[3] == [f"{words} V" for words in found[1]]


def test_a_lamp_gets_worse_at_once_and_better_when_that_lasts(opened: Page) -> None:
    act = """
      const lamp = new SteadyLamp();
      const at = [0, 0.1, 0.9, 1, 1.9, 2, 2.9, 3.1, 3.2, 4.2];
      const states = ["fresh", "late", "fresh", "stale", "fresh", "none", "late", "late", "fresh", "fresh"];
      return states.map((state, i) => lamp.follow({ state }, at[i]).state);"""
    expected = ["fresh", "late", "late", "stale", "stale", "none", "none", "late", "late", "fresh"]
    assert model(opened, act) == expected


STATUSES: tuple[TextureStatus, ...] = ("ok", "period-only", "low-snr")
EVENTS: list[Event] = [
    *(replace(SLIP, direction_deg=angle, onset_s=-0.04) for angle in (12.0, -135.0, 179.6)),
    replace(SLIP, kind="incipient", direction_sd_deg=180.0),
    replace(SLIP, direction_sd_deg=0.2, valid=False),
    replace(SLIP, valid=False, suppressed="load-change"),
    replace(SLIP, state="end", onset_s=-1.5),
    CONTACT,
    *(
        TextureEvent(time_s=0.0, answered_s=0.0, status=status, period_mm=1.2001, period_sd_mm=sd,
                     angle_deg=-30.03, angle_sd_deg=40 * sd)
        for status in STATUSES for sd in (0.0041, 0.00013, 0.3)
    ),
    CommandEvent(time_s=0.0, request_id="1", command="tare", arguments="{}", who="", key="", uid=0, ok=True,
                 reason="", scan_index=0),
]  # fmt: skip


def test_events_have_the_words_of_a_terminal(opened: Page) -> None:
    """The page adds the standard deviation of a latency, and has its own minus and arrow."""
    sent = [(e.topic, to_map(e, seq=0, board="TS1", unix_offset_s=0.0)) for e in EVENTS]
    words = """async (sent) => {
      const { eventWords } = await import("/static/words.js");
      return sent.map(([topic, data]) => eventWords(topic, data).text);
    }"""
    said = [text.split(" (± ")[0].replace("−", "-") for text in opened.evaluate(words, sent)]
    assert said == [event_words(topic, data).replace("->", "→") for topic, data in sent]
