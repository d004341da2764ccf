"""One attack: what is tried, what should be seen, and the function that does it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Outcome:
    """Outcome of an attack.

    Attributes
    ----------
    seen : str
        What was seen, in words and figures.
    held : bool
        The program behaved as expected.
    """

    seen: str
    held: bool


@dataclass(frozen=True)
class Attack:
    """One attack on the program.

    Attributes
    ----------
    name : str
        Border that is attacked and with what, for the first column of the table.
    tried : str
        What is done, with its size.
    expected : str
        What should be seen.
    run : callable
        Takes an empty folder and the scale: 1.0 for the full attack, less for the short form.
    short : float, optional
        Scale of the short form that the test suite runs within ten seconds; no short form if None.
    """

    name: str
    tried: str
    expected: str
    run: Callable[[Path, float], Outcome]
    short: float | None = 1.0
