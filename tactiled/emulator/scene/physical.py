"""A scene on a physical rung, at any instant: what its channels feel, and the truth about the contact."""

from dataclasses import dataclass

import numpy as np

from tactiled.array import Array, FloatArray
from tactiled.emulator.mechanics.stepper import GridInterpolator
from tactiled.emulator.scene.imposed import Build, TaxelDrive
from tactiled.emulator.scene.motion import SceneMotion
from tactiled.emulator.scene.slip_instants import SlipEpisodeTracker
from tactiled.errors import ConfigError

_REACTS_S = 0.01
_BLOCK_S = 0.16  # played at once: some scans, and no long pause of a real-time loop on a slow rung


@dataclass(frozen=True, eq=False)
class ContactState:
    """Truth of n instants, for t taxels.

    Attributes
    ----------
    normal_n : (n, t)
    tangential_n : (n, t, 2)
        Friction on the skin, against its motion.
    slipping : (n, t)
        Share of each taxel's contact that slips.
    slipping_share : (n,)
        The same for the whole contact, taxels weighted by their contact area.
    load_n : (n,)
    travel_mm, velocity_mm_s : (n, 2)
        Of the middle of the array over the surface.
    """

    normal_n: FloatArray
    tangential_n: FloatArray
    slipping: FloatArray
    slipping_share: FloatArray
    load_n: FloatArray
    travel_mm: FloatArray
    velocity_mm_s: FloatArray


class PhysicalContact:
    """A `ContactModel` on a rung.

    Parameters
    ----------
    motion : SceneMotion
    array : Array
    build : callable
        The rung's factory.
    step_s : float
        Of its time grid.
    name : str
        Of the rung, for refusals.

    Raises
    ------
    ConfigError
        The rung cannot play the scene.
    """

    def __init__(self, motion: SceneMotion, array: Array, build: Build, step_s: float, name: str) -> None:
        self._source = TaxelDrive(motion, array, build, step_s, name)
        # A held object reacts to a controller: no more is played than a scan.
        block = max(1, round((_REACTS_S if self._source.held else _BLOCK_S) / self._source.step_s))
        self._stepper = GridInterpolator(self._source, step_s=self._source.step_s, block=block)
        self._channels = np.arange(array.n_channels)
        self._n_channels, self._n_taxels = array.n_channels, array.n_taxels

    @property
    def reacts(self) -> bool:
        """Whether a controller can change what comes."""
        return self._source.held is not None

    @property
    def has_fallen(self) -> bool:
        """Whether a held object has slipped out."""
        return self._source.held is not None and self._source.held.has_fallen

    @property
    def watch(self) -> SlipEpisodeTracker:
        """Slip up to `played_s`."""
        return self._source.watch

    @property
    def warnings(self) -> dict[int, float]:
        """Warning bits of the rung with the first instant of each, up to `played_s`."""
        return self._source.warnings

    @property
    def played_s(self) -> float:
        return self._stepper.made_s

    def grip(self, force_n: float) -> None:
        """A controller's grip from the first instant that is not yet played; see `HeldMotion.grip`."""
        if self._source.held is None:
            raise ConfigError("grip", ["this scene has no held object; a controller can move nothing in it"])
        self._source.held.grip(force_n)

    def play_until(self, end_s: float) -> None:
        """Play on to an instant of scene time, unless it has been played."""
        while self.played_s < end_s:
            self._stepper.at(np.array([self.played_s + _BLOCK_S]), slice(0, 1))

    def forces(self, time_s: FloatArray) -> FloatArray:
        return self._stepper.at(time_s, self._channels)

    def relaxed_load_n(self, time_s: FloatArray) -> FloatArray:
        return self._column(6, time_s)

    def load_and_peak_n(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._column(1, time_s), self._column(7, time_s)

    def _column(self, number: int, time_s: FloatArray) -> FloatArray:
        """One of the columns after those of the taxels."""
        place = self._n_channels + 4 * self._n_taxels + number
        return self._stepper.at(time_s, np.full(time_s.shape[1], place))

    def state(self, time_s: FloatArray) -> ContactState:
        """Truth at instants (n,)."""
        rows = self._stepper.at(time_s, slice(self._n_channels, None))
        normal, tx, ty, slipping, rest = np.split(rows, np.arange(1, 5) * self._n_taxels, axis=1)
        return ContactState(
            normal_n=normal,
            tangential_n=np.stack([tx, ty], axis=-1),
            slipping=slipping,
            slipping_share=rest[:, 0],
            load_n=rest[:, 1],
            travel_mm=rest[:, 2:4],
            velocity_mm_s=rest[:, 4:6],
        )
