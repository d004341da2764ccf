"""Screen of one board as lines of text with colours; 80x24 is enough. No I/O."""

import math
from collections.abc import Sequence
from itertools import zip_longest
from textwrap import wrap
from typing import Any

import numpy as np
from rich.text import Text

from tactiled.client.listen import clock_words
from tactiled.events.words import force_words, lost_words, printable, texture_words
from tactiled.top.boards import BoardView
from tactiled.top.verdict import verdict

_ARROWS = "→↗↑↖←↙↓↘"
_LATE, _OLD = "bold black on rgb(240,171,0)", "bold white on rgb(90,100,110)"
_LAMPS = {"FRESH": "●", "LATE": "▲", "STALE": "■", "NO BOARD": "○"}
_LEVELS = {"near": _LATE, "partial": _LATE, "gross": "bold white on rgb(168,67,0)"}
_CALM = "bold white on rgb(0,116,90)"
_SLIP = "rgb(213,94,0)"  # vermilion and blue of Okabe and Ito: told apart by every kind of colour vision
_PART = 4  # of the range of the array, that the fullest colour stands for
_SENTENCE_LINES = 4
_OTHERS = 3  # boards: as many lines as leave the array in sight of 24
_LEAST = 0.03  # of full colour: a shear below has no direction, as on the page
_CELL = (9, 2)  # columns and lines of a taxel where there is room
_ARRAY_LINES = 10
_FACTS = 36  # columns that the facts need beside the array; where there are fewer, they stand below it


def draw(
    board: BoardView,
    now_unix_s: float,
    width: int,
    height: int,
    footer: str,
    notice: str = "",
    others: Sequence[BoardView] = (),
) -> list[Text]:
    """Return the lines of the screen, `height` of them, each at most `width` wide.

    `notice`, unless it is empty, takes the place of the last event, above the footer. Of `others`, boards
    too, the sentence is shown.
    """
    live = board.lamp(now_unix_s).state in ("FRESH", "LATE")
    full = 1.0 if board.geometry is None else (board.geometry["high"] - board.geometry["low"]) / 2 / _PART
    left = _array(board, live, max(20, width // 2 - 4), full)
    right = _facts(board, live, full)
    beside = max(24, *(line.cell_len for line in left)) + 1
    if beside + _FACTS > width:
        left, right = [*left, *right], []
    lines = [*_sentence(board, now_unix_s, width), _name(board, full)]
    for other in others[:_OTHERS]:
        lines.append(Text(f" {other.name:10.10} ", "dim") + _sentence(other, now_unix_s, width)[0])
    for n in range(max(len(left), len(right))):
        line = Text(" ") + (left[n] if n < len(left) else Text())
        line.pad_right(max(0, beside - line.cell_len))
        lines.append(line + (right[n] if n < len(right) else Text()))
    lines.append(Text("─" * width, "dim"))
    room = max(0, height - len(lines) - 1)
    lines += [_event_line(event.at_s, event.topic, event.words) for event in list(board.events)[:room]]
    lines = lines[: height - 1]
    lines += [Text() for _ in range(height - 1 - len(lines))]
    if notice and lines:
        lines[-1] = Text(f" {notice}", "bold")
    lines.append(Text(footer, "reverse"))
    for line in lines:
        line.plain = printable(line.plain)
        line.truncate(width)
    return lines


def age_in_words(age_s: float | None) -> str:
    """Return an age in ms, s, min or h."""
    if age_s is None:
        return "-"
    if age_s < 1.0:
        return f"{1000 * max(0.0, age_s):.0f} ms"
    if age_s < 100.0:
        return f"{age_s:.1f} s"
    return f"{age_s / 60:.0f} min" if age_s < 6000.0 else f"{age_s / 3600:.1f} h"


def _sentence(board: BoardView, now_unix_s: float, width: int) -> list[Text]:
    """Return what the contact does and how sure that is, beside the lamp and the age of the newest scan."""
    lamp = board.lamp(now_unix_s)
    if lamp.state in ("FRESH", "LATE"):
        said = verdict(board, now_unix_s)
        is_calm = said.level in ("free", "good")  # else a warning on the host can wait
        second = lamp.words if is_calm and lamp.words else said.sure
        paragraphs = [said.sentence, second]
        style = _LEVELS.get(said.level, _CALM if lamp.state == "FRESH" else _LATE)
    else:
        paragraphs, style = [lamp.words], _OLD
    words = [line for each in paragraphs for line in wrap(each, max(20, width - 14))][:_SENTENCE_LINES]
    beside = [f" {_LAMPS[lamp.state]} {lamp.state:8}  ", f" {age_in_words(lamp.age_s):>10}  "]
    rows = zip_longest(beside, words, fillvalue="")
    return [Text(f"{left:13}{right}".ljust(width), style) for left, right in rows]


def _name(board: BoardView, full: float) -> Text:
    array = board.newest.get("info", {}).get("array_id", "")
    scale = "" if board.geometry is None else f"full colour {full:.3g} {board.geometry['unit']}"
    return Text(f" {board.name or 'no board yet'}  {array}  {scale}", "dim")


def _event_line(at_s: float, topic: str, words: str) -> Text:
    style = _SLIP if topic == "slip" and "suppressed" not in words and "ended" not in words else ""
    return Text(f" {clock_words(at_s)}  ", "dim").append(words, style)


def _facts(board: BoardView, live: bool, full: float) -> list[Text]:
    """Return lines of a name and a value."""
    status, felt, geometry = board.newest.get("status", {}), board.felt(), board.geometry
    unit = "" if geometry is None else geometry["unit"]
    rows: dict[str, str] = {}
    if status.get("contact") == "none" and live and (below := status["hidden_below"]):
        rows["contact"] = f"none, told from {below:.3g} {unit}"
    if felt is not None and geometry is not None:
        shear_x, shear_y = float(felt.shear_x.sum()), float(felt.shear_y.sum())
        rows["load"] = f"{felt.load.sum():z.2f} {unit}" if live else "-"
        if geometry["has_shear"]:
            arrow = _arrow(shear_x, shear_y, _LEAST * full * len(felt.load))
            rows["shear"] = f"{math.hypot(shear_x, shear_y):.2f} {unit} {arrow}" if live else "-"
    force, grip, texture = board.current("force"), board.current("grip"), board.newest.get("texture")
    if force is not None and live:
        rows["force"] = force_words(force)
    if grip is not None and grip["state"] != "none" and live:
        used, low, high = (100 * grip[f"utilisation{end}"] for end in ("", "_low", "_high"))
        rows["friction used"] = f"{used:.0f} % ({low:.0f} to {high:.0f})"
    if texture is not None and live:
        rows["grooves"] = texture_words(texture).removeprefix("grooves ").removeprefix("no groove estimate: ")
    if status:
        rows["rate"] = f"{status['rate_hz']:.1f} Hz, {lost_words(status)}"
        sd_ms = 1000 * status["clock_sd_s"]
        known = f"± {sd_ms:.2f} ms, {status['clock_rate_ppm']:z.0f} ppm"
        rows["clock"] = known if sd_ms < 1e6 else "not known"
        rows["loop lag"] = f"{1000 * status['loop_lag_s']:.1f} ms, {status.get('path', 'unknown')} path"
    if (recording := board.newest.get("recording")) is not None:
        rows["recording"] = f"{recording['state']} {recording['bytes_written'] / 1e6:.1f} MB"
    return [Text(f"{name:>13}  ", "dim").append(words) for name, words in rows.items()]


def _array(board: BoardView, live: bool, width: int, full: float) -> list[Text]:
    """Return the array as cells: the colour is load, fullest at `full`, the arrow shear; y points up."""
    geometry, felt = board.geometry, board.felt()
    if geometry is None:
        return [Text("no array yet", "dim")]
    grid = _grid(geometry)
    columns = max(len(row) for row in grid)
    wide = columns * _CELL[0] <= width and len(grid) * (_CELL[1] + 1) <= _ARRAY_LINES + 1
    cell = _CELL[0] - 1 if wide else max(2, min(4, width // columns - 1))
    load = np.zeros(len(geometry["pressure"])) if felt is None else np.abs(felt.load)
    touched = board.newest.get("contact", {}).get("taxels", ())
    slipping = set(board.slip["taxels"]) if board.slip is not None and live else set()
    lines: list[Text] = []
    for row in grid[:_ARRAY_LINES]:
        first, second = Text(), Text()
        for taxel in row[:width]:  # of three letters each at least: more have no room on the screen
            if taxel is None:
                first, second = (line.append(" " * (cell + 1)) for line in (first, second))
                continue
            style = _style(load[taxel] / full, live, taxel in slipping)
            mark = "!" if taxel in slipping else "·" if taxel in touched else " "
            number, arrow = "-", " "
            if felt is not None and live:
                number = f"{load[taxel]:.2f}"
                arrow = _arrow(felt.shear_x[taxel], felt.shear_y[taxel], _LEAST * full)
            if wide:
                first.append(f"{number:^{cell}}", style).append(" ")
                second.append(f"{mark + ' ' + arrow:^{cell}}", style).append(" ")
            else:
                marks = arrow + mark if cell < 4 else f" {arrow}{mark}"
                first.append(f"{marks:^{cell}}", style).append(" ")
        lines += [first, second, Text()] if wide else [first]
    return lines


def _grid(geometry: dict[str, Any]) -> list[list[int | None]]:
    """Taxels by row from the largest y on, as many rows as are drawn; a square where places are unknown."""
    n_taxels = len(geometry["pressure"])
    if not geometry["has_places"]:
        side = math.ceil(math.sqrt(n_taxels))
        taxels: list[int | None] = [*range(n_taxels), *[None] * (side * side - n_taxels)]
        return [taxels[start : start + side] for start in range(0, side * side, side)]
    columns, rows = _steps(geometry["x_mm"]), _steps(geometry["y_mm"])
    top, width = max(rows), max(columns) + 1
    grid: list[list[int | None]] = [[None] * width for _ in range(min(top + 1, _ARRAY_LINES))]
    for taxel, (column, row) in enumerate(zip(columns, rows, strict=True)):
        if top - row < len(grid):
            grid[top - row][column] = taxel
    return grid


def _steps(places_mm: Sequence[float]) -> list[int]:
    """Index of each place among the different places."""
    rounded = [round(place, 3) for place in places_mm]
    index = {place: number for number, place in enumerate(sorted({*rounded}))}
    return [index[place] for place in rounded]


def _style(share: float, live: bool, slips: bool) -> str:
    share = min(1.0, max(0.0, share))
    if not live:
        grey = round(60 + 60 * share)
        return f"rgb(200,200,200) on rgb({grey},{grey},{grey})"
    if slips:
        return f"bold white on {_SLIP}"
    low, high = np.array([22.0, 40.0, 56.0]), np.array([86.0, 180.0, 233.0])
    red, green, blue = (round(float(part)) for part in low + (high - low) * share)
    return f"{'black' if share > 0.6 else 'white'} on rgb({red},{green},{blue})"


def _arrow(x: float, y: float, least: float) -> str:
    """Arrow of a shear; a space where it is not larger than `least`."""
    return _ARROWS[round(math.degrees(math.atan2(y, x)) / 45) % 8] if math.hypot(x, y) > least else " "
