"""Stores of recordings: copies that are damaged, names that lead elsewhere."""

import os
from pathlib import Path

from bench.hostile.attack import Attack, Outcome
from bench.hostile.process import tactiled

_FULL_BYTES = 20_000_000
_NAME = "a.mcap"


def _pushed(folder: Path, scale: float) -> tuple[Path, Path]:
    """Push one recording of random bytes to a store in a folder; return both files."""
    here, store = folder / "runs" / _NAME, folder / "store" / _NAME
    here.parent.mkdir()
    here.write_bytes(os.urandom(int(_FULL_BYTES * scale)))
    tactiled("archive", "push", str(here.parent), "--to", f"file://{store.parent}")
    return here, store


def _flip_a_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def _push_remove(folder: Path, scale: float) -> Outcome:
    here, store = _pushed(folder, scale)
    good = here.read_bytes()
    _flip_a_bit(store)
    done = tactiled("archive", "push", str(here.parent), "--to", f"file://{store.parent}", "--remove")
    is_kept = here.exists()
    is_whole = store.read_bytes() == good
    seen = f"exit code {done.code}, copy {'made anew' if is_whole else 'damaged'}, recording "
    return Outcome(seen + ("kept" if is_kept else "removed"), held=is_whole or is_kept)


def _verify(folder: Path, scale: float) -> Outcome:
    here, store = _pushed(folder, scale)
    _flip_a_bit(store)
    done = tactiled("archive", "verify", f"file://{store.parent}")
    pulled = tactiled("archive", "pull", f"file://{store.parent}", "--to", str(folder / "back"))
    fetched = list((folder / "back").rglob("*.mcap"))
    return Outcome(
        f"verify: exit code {done.code}; pull: exit code {pulled.code}, {len(fetched)} files",
        held=done.code == pulled.code == 1 and not fetched and here.exists(),
    )


def _another_recording(folder: Path, scale: float) -> Outcome:
    here, store = _pushed(folder, scale)
    before = store.read_bytes()
    here.write_bytes(b"of another board")
    done = tactiled("archive", "push", str(here.parent), "--to", f"file://{store.parent}", "--remove")
    is_held = done.code == 1 and here.exists() and store.read_bytes() == before
    return Outcome(f"exit code {done.code}, both kept: {is_held}", held=is_held)


ATTACKS: tuple[Attack, ...] = (
    Attack(
        "store, flipped bit",
        "one bit of a confirmed copy of 20 MB is flipped; archive push --remove",
        "no recording is removed whose copy is damaged",
        _push_remove,
        0.05,
    ),
    Attack(
        "store, flipped bit, read",
        "the same copy; archive verify, archive pull",
        "both exit with 1, nothing is fetched",
        _verify,
        0.05,
    ),
    Attack(
        "store, other recording",
        "another recording under a confirmed name; archive push --remove",
        "exit code 1, both recordings are kept",
        _another_recording,
        0.05,
    ),
)
