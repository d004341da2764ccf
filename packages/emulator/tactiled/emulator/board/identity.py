"""Parameters of the emulated board: identity, ADC, timing, crystal."""

from pydantic import Field

from tactiled.array import Array, load_array
from tactiled.emulator.scene.description import Scene
from tactiled.errors import ConfigError
from tactiled.resources import shipped_names
from tactiled.tomlfile import Params
from tactiled.wire.frames import Hello
from tactiled.wire.layout import Layout


class EmulatedBoardParams(Params):
    """Parameters of one board; its identity is ignored where the layout assumes a hello."""

    board_serial: str = Field(default="TS0001", min_length=1, max_length=16)
    firmware_version: str = Field(default="emu-1.0", max_length=12)
    array_id: str | None = Field(default=None, description="absent: the array of the scene")
    rate_hz: float = Field(default=100.0, gt=0, description="scan rate after power-up")
    adc_bits: int = Field(default=12, ge=1, le=16)
    adc_reference_v: float = Field(default=3.0, gt=0)
    channel_step_s: float = Field(
        default=200e-6, ge=0, description="multiplexer step: channel c is sampled c steps into the scan"
    )
    boot_count: int = Field(default=1, ge=0, description="boot count in the first hello")
    drift_ppm: float = Field(default=30.0, ge=-50_000, le=50_000, description="error of the board's crystal")
    # From the last bit of a ping to the tick in its answer, as the main loop comes round.
    answer_least_s: float = Field(default=1e-4, ge=0, le=1, description="shortest time to answer a ping")
    answer_most_s: float = Field(default=1e-3, ge=0, le=1, description="longest time to answer a ping")
    start_ticks: int = Field(default=0, ge=0, description="tick counter at the first power-up")
    start_sequence: int = Field(default=0, ge=0, description="sequence number of the first scan")


def emulated_array(scene: Scene, layout: Layout) -> Array:
    """Array of the scene or, where the scene names none, the one that the layout assumes.

    `ConfigError` where the frames of the layout are not those of that array.
    """
    assumed, fault = layout.file.assumed_hello, ""
    is_named = assumed is None or "array" in scene.model_fields_set
    name = scene.array if assumed is None or is_named else assumed.array_id
    if not is_named and name not in shipped_names("config/arrays"):
        fault = f"the layout {layout.name} assumes the array {name!r}: name its file with --array"
        raise ConfigError(f"scene {scene.name}", [fault])
    array = load_array(name)
    if assumed is not None and array.name != assumed.array_id:
        fault = (
            f"the array is {array.name!r}, but the layout {layout.name} assumes {assumed.array_id!r} "
            "(assumed_hello.array_id): give both the same name"
        )
    elif array.n_channels != layout.n_channels:
        fault = (
            f"array {array.name} has {array.n_channels} channels, "
            f"frames of {layout.name} carry {layout.n_channels}; change one of them"
        )
    if fault:
        raise ConfigError(f"scene {scene.name}", [fault])
    return array


def identity(params: EmulatedBoardParams, layout: Layout, array: Array) -> Hello:
    """Hello of the board, or the one that the layout assumes."""
    assumed = layout.file.assumed_hello
    if assumed is not None:
        typical_hz = None if "rate_hz" in params.model_fields_set else assumed.typical_rate_hz
        hello = layout.assumed_hello(typical_hz or params.rate_hz)
        assert hello is not None  # it has a rate
        return hello
    return Hello(
        board_serial=params.board_serial,
        array_id=params.array_id or array.name,
        rate_hz=params.rate_hz,
        adc_bits=params.adc_bits,
        adc_reference_v=params.adc_reference_v,
        channel_offset_s=tuple(params.channel_step_s * c for c in range(layout.n_channels)),
        protocol_version=layout.file.protocol_version,
        firmware_version=params.firmware_version,
        boot_count=params.boot_count,
    )
