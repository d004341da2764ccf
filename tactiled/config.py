"""``tactiled.toml``: the parameters of all packages in one schema; no package imports this module."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from operator import attrgetter
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from tactiled import resources, tomlfile
from tactiled.array import Array, ArrayFile, build, numerics_words
from tactiled.daemon.runner import ServiceParams
from tactiled.daemon.zmq.params import PublishParams
from tactiled.detect.suite import DetectParams
from tactiled.detect.worker import Worker
from tactiled.errors import ConfigError
from tactiled.force.calibration import CalibrationFile, has_nominal, load_calibration
from tactiled.force.model import build_model
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.recording.contents import Header, load_board
from tactiled.recording.session import RecordParams
from tactiled.samples.assembler import SampleParams
from tactiled.tomlfile import P, Params
from tactiled.wire.layout import Layout, compile_layout
from tactiled.wire.schema import LayoutFile

NO_FORCE = "off"
"""Value of `board.calibration` without force messages."""
FILES = ("protocol", "array", "calibration")


class BoardFiles(Params):
    """Frame layout, array and force calibration of the board."""

    protocol: str = Field(default="board-v1", description="frame layout: a shipped name or a TOML file")
    array: str = Field(default="wang2019-3x3", description="array: a shipped name or a TOML file")
    calibration: str | None = Field(
        default=None,
        description="force calibration: a shipped name or a TOML file; left out: the nominal one of the "
        "array, if there is one; off: no force messages",
    )


class Config(ServiceParams):
    """Schema of ``tactiled.toml``; its tables are explained in ``config/tactiled.toml``."""

    board: BoardFiles = BoardFiles()
    samples: SampleParams = SampleParams()
    detect: DetectParams = DetectParams()
    record: RecordParams = RecordParams()


@dataclass(frozen=True)
class Setup:
    """Checked configuration with the layout, array and calibration that it names, and its file."""

    config: Config
    layout: Layout
    array: Array
    source: str
    calibration: CalibrationFile | None = None

    @property
    def pipeline(self) -> PipelineParams:
        """Parameters of the pipeline."""
        return PipelineParams(
            samples=self.config.samples,
            detect=self.config.detect,
            force=self.config.board.calibration != NO_FORCE,
            calibration=self.calibration,
            baud=self.config.port.baud,
        )

    def make_pipeline(self, worker: Worker | None = None) -> Pipeline:
        """Make a pipeline with this configuration; `worker` takes long computations."""
        return Pipeline(self.layout, self.array, self.pipeline, worker=worker)

    def recording_header(self) -> Header:
        """Header of recordings made with this configuration."""
        board = self.config.board
        source = load_board(board.protocol, board.array)
        return Header(source=source, pipeline=self.pipeline, computed_with=numerics_words())


def load_config(path: Path, port_url: str | None = None) -> Setup:
    """Load a configuration with its layout and array; report the faults of all files at once.

    Parameters
    ----------
    port_url : str, optional
        Overrides ``port.url``.
    """
    document = tomlfile.read(path)
    if isinstance(board := document.get("board"), dict):
        # A file that the configuration names lies beside it, wherever the daemon is started.
        files = {key: beside(path, board[key]) for key in FILES if key in board and board[key] != NO_FORCE}
        document = {**document, "board": {**board, **files}}
    if port_url is not None and isinstance(port := document.get("port", {}), dict):
        document = {**document, "port": {**port, "url": port_url}}
    return _set_up(tomlfile.parse(document, Config, str(path)), str(path))


def config_files(paths: Sequence[Path]) -> list[Path]:
    """Return the configurations that files and directories name.

    A directory stands for each ``*.toml`` in it. Hidden files of a directory are left out, and so are arrays,
    layouts and calibrations, which may lie beside the configurations that name them. `ConfigError` if a
    directory has no configuration, or a file is no TOML or is named twice.
    """
    found: list[Path] = []
    for path in paths:
        if not path.is_dir():
            found.append(path)
            continue
        files = sorted(file for file in path.glob("*.toml") if not file.name.startswith("."))
        configs = [file for file in files if kind_of(tomlfile.read(file)) == "configuration"]
        if not configs:
            raise ConfigError(str(path), ["no configuration (*.toml) in this directory"])
        found += configs
    for path in found:
        if [other.absolute() for other in found].count(path.absolute()) > 1:
            raise ConfigError(str(path), ["is named twice"])
    return found


def kind_of(document: Mapping[str, Any]) -> Literal["configuration", "array", "layout", "calibration"]:
    """Return what a TOML file describes, by its keys."""
    if "framing" in document or "messages" in document:
        return "layout"
    of_arrays = {"grids", "taxels", "taxel_channels", "taxel_count"}
    # In a layout file, `channels` is a number.
    if of_arrays & document.keys() or isinstance(document.get("channels"), list):
        return "array"
    return "calibration" if "largest_reading" in document else "configuration"


def load_configs(files: Sequence[Path], port_url: str | None = None) -> list[Setup]:
    """Load the configurations of all boards of one process; report the faults of all files at once.

    `port_url` is for a single board (see `load_config`). `ConfigError` if a file has faults, or if the files
    do not fit together.
    """
    setups: list[Setup] = []
    wrong: list[ConfigError] = []
    for file in files:
        try:
            setups.append(load_config(file, port_url))
        except ConfigError as error:
            wrong.append(error)
    if len(wrong) == 1:
        raise wrong[0]
    if wrong:
        faults = [f"{error.source}: {fault}" for error in wrong for fault in error.faults]
        raise ConfigError(f"{len(wrong)} of {len(files)} configurations", faults)
    check_together(setups)
    return setups


def check_together(setups: Sequence[Setup]) -> None:
    """Check that one process can serve these boards.

    A `ConfigError` names files and keys where two boards have the same serial number, port or directory of
    recordings, one has no serial number, or a setting of the whole process differs.
    """
    if len(setups) == 1:
        return
    faults = [
        f"{setup.source}: session.board_serial: missing; of several boards each needs its own, so that "
        "no data can be taken for those of another"
        for setup in setups
        if setup.config.session.board_serial is None
    ]
    for key in _OWN:
        faults += [
            f"{key}: {_shown(value)} in both {one.source} and {other.source}"
            for one, other in combinations(setups, 2)
            if (value := attrgetter(key)(one.config)) is not None and value == attrgetter(key)(other.config)
        ]
    first = setups[0]
    for setup, key in product(setups[1:], _COMMON):
        value, other_value = attrgetter(key)(first.config), attrgetter(key)(setup.config)
        if value != other_value:
            faults.append(
                f"{key}: {_shown(value)} in {first.source}, but {_shown(other_value)} in {setup.source}; it "
                "holds for the whole process"
            )
    if faults:
        raise ConfigError("several boards in one process", list(dict.fromkeys(faults)))


_OWN = ("session.board_serial", "port.url", "record.directory")
"""Options that each board has for itself."""
_COMMON = ("metrics.port", *(f"publish.{key}" for key in PublishParams.model_fields))
"""Options that hold for the whole process: one metrics page, one set of endpoints."""


def _shown(value: object) -> str:
    """Return a value as TOML has it, or nearly so."""
    return "left out" if value is None else json.dumps(value)


def beside(path: Path, name_or_path: object) -> object:
    """Return a relative path of a configuration as a path that holds in any working directory."""
    if not isinstance(name_or_path, str) or resources.is_name(name_or_path):
        return name_or_path  # a shipped name; what is no text is refused by the schema
    return str(path.absolute().parent / name_or_path)


def default_config(port_url: str, **tables: Params) -> Setup:
    """Make a default configuration for a port."""
    config = tomlfile.parse({"port": {"url": port_url}, **tables}, Config, "command line")
    return _set_up(config, "command line")


def _set_up(config: Config, source: str) -> Setup:
    faults: list[str] = []
    layout_file = _load("protocol", resources.find(config.board.protocol, "protocols"), LayoutFile, faults)
    array_file = _load("array", resources.find(config.board.array, "config/arrays"), ArrayFile, faults)
    if layout_file is None or array_file is None:
        raise ConfigError(source, faults)
    array = build(array_file)
    config.detect.check_array(array, source)
    calibration = _calibration(config.board, array, source)
    if array.n_channels != layout_file.channels:
        fault = (
            f"board.array: {array.name} has {array.n_taxels} taxels and {array.n_channels} channels, "
            f"but a scan of {layout_file.name} has {layout_file.channels}"
        )
        raise ConfigError(source, [fault])
    return Setup(config, compile_layout(layout_file), array, source, calibration)


def _load(key: str, path: Path, schema: type[P], faults: list[str]) -> P | None:
    """Load a file of the table `board`; add what is wrong with it to `faults`."""
    try:
        return tomlfile.load(path, schema)
    except ConfigError as error:
        faults += [f"board.{key}: {error.source}: {fault}" for fault in error.faults]
        return None


def _calibration(board: BoardFiles, array: Array, source: str) -> CalibrationFile | None:
    """Load the force calibration that is named, or the nominal one of the array."""
    name = board.calibration
    if name == NO_FORCE or (name is None and not has_nominal(array.name)):
        return None
    try:
        calibration = load_calibration(name or array.name)
        build_model(array, calibration)
    except ConfigError as error:
        faults = [f"board.calibration: {error.source}: {fault}" for fault in error.faults]
        raise ConfigError(source, faults) from None
    return calibration
