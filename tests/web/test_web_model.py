"""What the page keeps of a board, judged in the page's own modules."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
from pages import robot
from playwright.sync_api import Page

from tactiled.web.feed import pack_frame

pytestmark = pytest.mark.system

MODEL = """async () => {
  const { BoardModel } = await import("/static/board.js");
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


@pytest.fixture
def opened(tmp_path: Path, page: Page) -> Iterator[Page]:
    """The page of a server whose daemon does not run."""
    with robot(tmp_path) as made:
        page.goto(made.serve())
        yield page


def model(page: Page, act: str) -> Any:
    """Run statements on a board that is touched, slips and is gripped at 10 s; return what they return."""
    return page.evaluate(MODEL.replace("ACT", act))


def test_a_restart_of_the_daemon_ends_what_its_last_run_said(opened: Page) -> None:
    assert model(opened, "return known()") == ["touch", "slip", "grip", "force", "texture"]
    assert model(opened, 'status(2, 20, "none"); return known()') == []
    assert model(opened, 'status(2, 20, "none"); return board.slips.map((slip) => slip.to)') == [10]
    assert model(opened, 'status(2, 20, "none"); return board.bands.at(-1).state') == "none"
    assert model(opened, 'status(1, 10.1, "holding"); return known().length') == 5


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
    board.take("geometry", {{ unit: "V", zero: [0], zero_first_s: 0, names: ["t0.a"], has_shear: false,
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
    assert bands == ["none", "holding", "none"]  # what holds in a gap is not known


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
