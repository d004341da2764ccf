"""Commands of the controller in a few grasps, which tell whether a figure is older than the code."""

from bench.hold.play import play
from tactiled.client import GripController
from tactiled.emulator.scene.families.holding import hold

_SEEDS = range(500, 503)  # choice: on other seeds than any result


def answers() -> dict[str, list[float]]:
    """Return the mean and the last command of each grasp (N)."""
    episodes = play([hold(seed) for seed in _SEEDS], [GripController() for _ in _SEEDS])
    mean, last = episodes.command_n.mean(axis=0), episodes.command_n[-1]
    return {f"hold-{seed}": [round(mean[k], 9), round(last[k], 9)] for k, seed in enumerate(_SEEDS)}
