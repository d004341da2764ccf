"""Parts of random scenes."""

from typing import Any

import numpy as np

from tactiled.emulator.scene.description import Scene

Document = dict[str, Any]


def begin(name: str, seed: int) -> tuple[np.random.Generator, Document]:
    """Begin a scene with a press of 6 to 20 N on a plate of friction 0.3 to 0.9, and a hold."""
    # The name is in the seed, so that families draw different numbers.
    rng = np.random.default_rng([seed, *name.encode()])
    scene: Document = {
        "name": f"{name}-{seed}",
        "contact": "mechanics",
        "seed": seed,
        "surface": {"kind": "flat", "friction": rng.uniform(0.3, 0.9)},
        "phases": [
            {"kind": "press", "duration_s": rng.uniform(0.2, 1.5), "force_n": rng.uniform(6.0, 20.0)},
            hold_phase(rng.uniform(0.5, 1.5)),
        ],
        "disturbances": [],
    }
    return rng, scene


def made(scene: Document) -> Scene:
    """Check a document and make the scene of it."""
    return Scene.model_validate(scene)


def friction_n(scene: Document) -> float:
    """Friction limit at the load of the first phase, in newtons."""
    return float(scene["surface"]["friction"] * scene["phases"][0]["force_n"])


def any_direction_deg(rng: np.random.Generator) -> float:
    """Draw a direction uniformly from [-180, 180)."""
    return float(rng.uniform(-180.0, 180.0))


def turned(direction_deg: float, by_deg: float) -> float:
    """Add an angle to a direction and wrap the sum to [-180, 180)."""
    return (direction_deg + by_deg + 180.0) % 360.0 - 180.0


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform between those of `low` and `high`."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def hold_phase(duration_s: float) -> Document:
    """Phase in which nothing changes."""
    return {"kind": "hold", "duration_s": duration_s}


def slide_phase(rng: np.random.Generator, **rest: Any) -> Document:
    """Slide in a random direction."""
    return {"kind": "slide", "direction_deg": any_direction_deg(rng), **rest}


def load_phase(rng: np.random.Generator, scene: Document, duration_s: float, of_friction: float) -> Document:
    """Phase in which the load changes to a part of the friction limit."""
    return {
        "kind": "load",
        "duration_s": duration_s,
        "tangential_n": of_friction * friction_n(scene),
        "direction_deg": any_direction_deg(rng),
    }


def disturb(
    scene: Document, on: str, shape: str, amplitude: float, start_s: float, duration_s: float, **rest: float
) -> None:
    """Add a disturbance to a document."""
    extra = {"on": on, "shape": shape, "amplitude": amplitude, "duration_s": duration_s, **rest}
    scene["disturbances"] += [extra | {"start_s": float(start_s)}]
