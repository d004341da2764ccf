"""Only what a scene requires: the cheapest rung whose measured error meets every need of the scene.

Needs are names (`scene.Need`); a rung's `PROVIDES` says how wrong it is about each, measured against finite
elements by ``./run bench contact``. What a rung does not name it does not model, whatever the tolerance.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from tactiled.errors import ConfigError

NOT_MODELLED: Mapping[str, str] = {
    "signal": "mechanics of any kind: the forces are prescribed curves",
    "lumped": "where on the patch it slips, grooves, a peak of static friction in slides that begin faster "
    "than stribeck_mm_s",
    "periodic": "grooves during the onset of slip, ripple that lags behind a change of load or direction, "
    "the skin's nonlinearity beyond first order",
    "compliance": "the skin's nonlinearity beyond first order, static friction above sliding, "
    "neighbouring bumps",
}


@dataclass(frozen=True)
class RungOption:
    """A rung as a choice.

    Attributes
    ----------
    name : str
    provides : Mapping
        Need to measured relative error.
    refusal : str
        Why it cannot play the scene at all; empty: it can.
    """

    name: str
    provides: Mapping[str, float]
    refusal: str = ""


@dataclass(frozen=True)
class RungChoice:
    """The rung for a scene, and how it came to be."""

    rung: str
    needs: tuple[str, ...]
    tolerance: float
    errors: Mapping[str, float]  # of the chosen rung, for each need
    rejected: Mapping[str, str]  # cheaper rung to why not

    def explain(self) -> str:
        """What people read: which, why, and what was not modelled."""
        lines = [f"contact: {self.rung}"]
        if self.needs:
            met = ", ".join(f"{need} {100 * self.errors[need]:.2g} %" for need in self.needs)
            lines.append(f"  needs within {100 * self.tolerance:g} %; measured error: {met}")
        else:
            lines.append("  the scene states no needs: the cheapest that can play it")
        lines += [f"  not {name}: {why}" for name, why in self.rejected.items()]
        lines.append(f"  not modelled: {NOT_MODELLED.get(self.rung, 'not stated by this rung')}")
        return "\n".join(lines)


def choose(
    source: str, needs: Iterable[str], tolerance: float, candidates: Sequence[RungOption]
) -> RungChoice:
    """First of the candidates, cheapest first, that plays the scene and meets its needs.

    Parameters
    ----------
    source : str
        Name of the scene, for the refusal.
    needs : iterable of str
    tolerance : float
        Largest relative error of each.
    candidates : sequence of RungOption
        In growing cost.

    Raises
    ------
    ConfigError
        None does; one line a rung says what it lacks.
    """
    wanted = tuple(dict.fromkeys(needs))
    rejected: dict[str, str] = {}
    for candidate in candidates:
        why = candidate.refusal or _shortfall(wanted, tolerance, candidate.provides)
        if not why:
            errors = {need: candidate.provides[need] for need in wanted}
            return RungChoice(candidate.name, wanted, tolerance, errors, rejected)
        rejected[candidate.name] = why
    faults = [f"needs: {name} does not serve: {why}" for name, why in rejected.items()]
    raise ConfigError(source, [*faults, "needs: no rung delivers this; drop a need or widen tolerance"])


def _shortfall(needs: Sequence[str], tolerance: float, provides: Mapping[str, float]) -> str:
    """What a rung lacks, in words; empty where it serves."""
    missing = [need for need in needs if need not in provides]
    wide = [need for need in needs if need in provides and provides[need] > tolerance]
    parts = [f"does not model {', '.join(missing)}"] if missing else []
    parts += [f"{need} is {100 * provides[need]:.2g} % off" for need in wide]
    return "; ".join(parts)
