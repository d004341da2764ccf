"""Choice of the cheapest contact model whose measured errors meet every need of a scene.

Needs are names (`description.Need`). ``PROVIDES`` of a contact model has its error for each need, measured
against finite elements (`tests/emulator/mechanics/test_mechanics_errors.py` compares). A need that is absent
there is not modelled.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from tactiled.errors import ConfigError

NOT_MODELLED: Mapping[str, str] = {
    "signal": "mechanics of any kind: the forces are prescribed curves",
    "lumped": "the place of slip within the contact area, grooves, a peak of static friction in slides that "
    "begin faster than stribeck_mm_s",
    "periodic": "grooves during the onset of slip, ripple that lags behind a change of load or direction, "
    "the skin's nonlinearity beyond first order",
    "compliance": "the skin's nonlinearity beyond first order, static friction above sliding, "
    "neighbouring bumps",
}


@dataclass(frozen=True)
class ModelOption:
    """A contact model that can be chosen."""

    name: str
    provides: Mapping[str, float]  # need to measured relative error
    refusal: str = ""  # reason why it cannot play the scene; empty where it can


@dataclass(frozen=True)
class ModelChoice:
    """Contact model for a scene, with the reasons."""

    name: str
    needs: tuple[str, ...]
    tolerance: float
    errors: Mapping[str, float]  # of the chosen model, by need
    rejected: Mapping[str, str]  # cheaper model to the reason against it

    def explain(self) -> str:
        """Explain in words which model was chosen, why, and what it does not model."""
        lines = [f"contact: {self.name}"]
        if self.needs:
            met = ", ".join(f"{need} {100 * self.errors[need]:.2g} %" for need in self.needs)
            lines.append(f"  needs within {100 * self.tolerance:g} %; measured error: {met}")
        else:
            lines.append("  the scene states no needs: the cheapest that can play it")
        lines += [f"  not {name}: {why}" for name, why in self.rejected.items()]
        lines.append(f"  not modelled: {NOT_MODELLED.get(self.name, 'not stated')}")
        return "\n".join(lines)


def choose(
    source: str, needs: Iterable[str], tolerance: float, candidates: Sequence[ModelOption]
) -> ModelChoice:
    """Choose the first of the candidates, cheapest first, that plays the scene and meets its needs.

    Parameters
    ----------
    source : str
        Name of the scene, for the error message.
    tolerance : float
        Largest relative error of each.
    candidates : sequence of ModelOption
        In growing cost.

    Raises
    ------
    ConfigError
        There is none; a line for each contact model says what it lacks.
    """
    wanted = tuple(dict.fromkeys(needs))
    rejected: dict[str, str] = {}
    for candidate in candidates:
        why = candidate.refusal or _shortfall(wanted, tolerance, candidate.provides)
        if not why:
            errors = {need: candidate.provides[need] for need in wanted}
            return ModelChoice(candidate.name, wanted, tolerance, errors, rejected)
        rejected[candidate.name] = why
    faults = [f"needs: {name} does not serve: {why}" for name, why in rejected.items()]
    raise ConfigError(
        source, [*faults, "needs: no contact model delivers this; drop a need or widen tolerance"]
    )


def _shortfall(needs: Sequence[str], tolerance: float, provides: Mapping[str, float]) -> str:
    """Needs that a contact model does not meet, in words; empty where it meets all."""
    missing = [need for need in needs if need not in provides]
    wide = [need for need in needs if need in provides and provides[need] > tolerance]
    parts = [f"does not model {', '.join(missing)}"] if missing else []
    parts += [f"{need} is {100 * provides[need]:.2g} % off" for need in wide]
    return "; ".join(parts)
