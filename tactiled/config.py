"""``tactiled.toml``: the parameters of all packages in one schema; no package imports this module."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field

from tactiled import resources, tomlfile
from tactiled.array import Array, ArrayFile, build
from tactiled.daemon.board.terms import SessionParams
from tactiled.daemon.operations.exporter import MetricsParams
from tactiled.daemon.serial.port import PortParams
from tactiled.daemon.service import ServiceParams
from tactiled.daemon.zmq.publisher import PublishParams
from tactiled.detect.suite import DetectParams
from tactiled.detect.worker import Worker
from tactiled.errors import ConfigError
from tactiled.force.calibration import CalibrationFile, has_nominal, load_calibration
from tactiled.pipeline import Pipeline, PipelineParams
from tactiled.recording.contents import Header, load_board
from tactiled.recording.rotation import RecordParams
from tactiled.samples.assembler import SampleParams
from tactiled.tomlfile import Params
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


class Config(Params):
    """Schema of ``tactiled.toml``; its tables are explained in ``config/tactiled.toml``."""

    port: PortParams
    board: BoardFiles = BoardFiles()
    session: SessionParams = SessionParams()
    samples: SampleParams = SampleParams()
    detect: DetectParams = DetectParams()
    publish: PublishParams = PublishParams()
    record: RecordParams = RecordParams()
    metrics: MetricsParams = MetricsParams()

    @property
    def service(self) -> ServiceParams:
        """Parameters of the service."""
        return ServiceParams(port=self.port, session=self.session, publish=self.publish, metrics=self.metrics)

    @property
    def pipeline(self) -> PipelineParams:
        """Parameters of the pipeline."""
        return PipelineParams(samples=self.samples, detect=self.detect, baud=self.port.baud)


@dataclass(frozen=True)
class Setup:
    """Checked configuration with the layout, array and calibration that it names."""

    config: Config
    layout: Layout
    array: Array
    calibration: CalibrationFile | None = None

    @property
    def pipeline(self) -> PipelineParams:
        """Parameters of the pipeline, with the calibration."""
        return self.config.pipeline.model_copy(
            update={"force": self.config.board.calibration != NO_FORCE, "calibration": self.calibration}
        )

    def make_pipeline(self, worker: Worker | None = None) -> Pipeline:
        """Make a pipeline with this configuration; `worker` takes long computations."""
        return Pipeline(self.layout, self.array, self.pipeline, worker=worker)

    def recording_header(self) -> Header:
        """Header of recordings made with this configuration."""
        board = self.config.board
        canonical = json.dumps(self.config.model_dump(mode="json"), sort_keys=True)
        return Header(
            source=load_board(board.protocol, board.array),
            pipeline=self.pipeline,
            config_sha256=hashlib.sha256(canonical.encode()).hexdigest(),
        )


def load_config(path: Path, port_url: str | None = None) -> Setup:
    """Load a configuration with its layout and array; report the faults of all files at once.

    Parameters
    ----------
    path : Path
    port_url : str, optional
        Overrides ``port.url``.

    Raises
    ------
    ConfigError
    """
    document = tomlfile.read(path)
    if isinstance(board := document.get("board"), dict):
        # A file that the configuration names lies beside it, wherever the daemon is started.
        files = {key: _beside(path, board[key]) for key in FILES if key in board and board[key] != NO_FORCE}
        document = {**document, "board": {**board, **files}}
    if port_url is not None:
        document = {**document, "port": {**document.get("port", {}), "url": port_url}}
    return _set_up(tomlfile.parse(document, Config, str(path)), str(path))


def _beside(path: Path, name_or_path: object) -> object:
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
    layout_file: LayoutFile | None = None
    array_file: ArrayFile | None = None
    try:
        layout_file = tomlfile.load(resources.find(config.board.protocol, "protocols"), LayoutFile)
    except ConfigError as error:
        faults += [f"board.protocol: {error.source}: {fault}" for fault in error.faults]
    try:
        array_file = tomlfile.load(resources.find(config.board.array, "config/arrays"), ArrayFile)
    except ConfigError as error:
        faults += [f"board.array: {error.source}: {fault}" for fault in error.faults]
    if layout_file is None or array_file is None:
        raise ConfigError(source, faults)
    array = build(array_file)
    calibration = _calibration(config.board, array, source)
    if array.n_channels != layout_file.channels:
        fault = (
            f"board.array: {array.name} has {array.n_taxels} taxels and {array.n_channels} channels, "
            f"but a scan of {layout_file.name} has {layout_file.channels}"
        )
        raise ConfigError(source, [fault])
    return Setup(config, compile_layout(layout_file), array, calibration)


def _calibration(board: BoardFiles, array: Array, source: str) -> CalibrationFile | None:
    """Load the force calibration that is named, or the nominal one of the array."""
    name = board.calibration
    if name == NO_FORCE or (name is None and not has_nominal(array.name)):
        return None
    try:
        calibration = load_calibration(name or array.name)
        calibration.check_array(array)
    except ConfigError as error:
        faults = [f"board.calibration: {error.source}: {fault}" for fault in error.faults]
        raise ConfigError(source, faults) from None
    return calibration
