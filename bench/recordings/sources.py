"""Readers of the sources of the catalogue: a checkout of each to logs, in the order of `catalogue.toml`."""

import csv
import re
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path

import numpy as np

from bench.recordings.log import Log, numbered, pressure_profile, rows, tensor


def fabric_slide(folder: Path) -> Iterator[Log]:
    """Slides over two printed boards, whose ridges and gaps are each as wide as the name says."""
    for path in numbered(folder / "data/board", "*.csv"):
        width_mm, speed_mm_s = map(int, re.findall(r"(\d+)mm", path.name))
        table = rows(path, header=True)
        yield Log(
            path.stem,
            f"{width_mm} mm",
            table[:, 0] / 1000.0,
            table[:, 3:19],
            period_mm=2.0 * width_mm,
            speed_mm_s=float(speed_mm_s),
        )


_BIOTAC_SLIDE_MM_S = 20.0
_BIOTAC_FIRST_ELECTRODE = 26


def biotac_materials(folder: Path) -> Iterator[Log]:
    """Slides over 20 materials, two of the fifty of each; but for two woven ones none has a period."""
    for material in range(1, 21):
        for sample in (1, 2):
            path = folder / f"raw_data/mat{material}/mat{material}_{sample}_bio.csv"
            table = rows(path, header=True)
            yield Log(
                path.stem.removesuffix("_bio"),
                f"material {material}",
                table[:, 0],
                table[:, _BIOTAC_FIRST_ELECTRODE : _BIOTAC_FIRST_ELECTRODE + 19],
                speed_mm_s=_BIOTAC_SLIDE_MM_S,
            )


def biotac_sp(folder: Path) -> Iterator[Log]:
    """Six directions of slip and touches of eleven objects; no stamps, published at 100 Hz."""
    for kind in ("n", "e", "s", "w", "cw", "aw", "t"):
        for path in numbered(folder / "csvs" / kind, "*.csv"):
            readings = rows(path, header=True)
            time_s = np.arange(len(readings)) / 100.0
            group = path.stem.rstrip("0123456789").replace("strippes", "striped")  # one log is misspelt
            yield Log(f"{kind}/{path.stem}", group, time_s, readings, label=kind != "t")


_TUG_CHANNELS = 30


def eflesh_tugs(folder: Path) -> Iterator[Log]:
    """Objects between two fingers, which a person tugs or does not; 3 s at 100 Hz without stamps."""
    data = folder / "slip_detection/data"
    labels = [line.strip() == "1" for line in (data / "labels").read_text().split()]
    for at, slips in enumerate(labels):
        readings = tensor(data / f"seq_{at}.pt", _TUG_CHANNELS)
        # No object is named: neighbours in time are of the same one.
        yield Log(f"seq_{at}", f"block {at // 10}", np.arange(len(readings)) / 100.0, readings, label=slips)


_N_PER_G = 9.80665e-3


def _eflesh_probe(folder: Path, kind: str, axis: int) -> Iterator[Log]:
    """Runs of a probe with its force, in grams; sensor and force have stamps of the host."""
    for run in sorted((folder / "characterization/datasets" / kind).iterdir()):
        sensor, states = rows(run / "sensor.csv", header=False), rows(run / "states.csv", header=False)
        known = states[states[:, 4] != -1]
        forces = np.full((len(sensor), 3), np.nan)
        forces[:, axis] = _N_PER_G * np.interp(sensor[:, 0], known[:, 0], known[:, 4])
        yield Log(run.name, run.name, sensor[:, 0], sensor[:, 1:], forces=forces)


def eflesh_presses(folder: Path) -> Iterator[Log]:
    """A probe that presses on five magnetometers."""
    return _eflesh_probe(folder, "normal_force", 2)


def eflesh_shears(folder: Path) -> Iterator[Log]:
    """A probe that shears two fingers of five magnetometers each."""
    return _eflesh_probe(folder, "shear_force", 0)


def tactaxis(folder: Path) -> Iterator[Log]:
    """Poses of a press on one magnetic chip, each with the force of a reference; no times."""
    table = rows(folder / "UNIGE/Data/Calib.csv", header=True)
    poses = np.arange(len(table), dtype=np.float64)
    # Forces are those on the sensor; ours are of the object on the skin, which presses with fz > 0.
    yield Log("Calib", "poses", poses, table[:, 8:16], forces=table[:, 18:21] * [1.0, 1.0, -1.0])


_GRASPS_EACH = 2
_SDH2_PADS = ((14, 6, 0), (13, 6, 84), (14, 6, 162), (13, 6, 246), (14, 6, 324), (13, 6, 408))


def sdh2(folder: Path) -> Iterator[Log]:
    """Files whose name says that an object slips, and grasps that hold, two of each of 36 objects, more."""
    profiles = folder / "pressure_profiles"
    slips = sorted(path for path in profiles.rglob("*slip*.dsa"))
    objects = folder / "python/classification/training_grasp_profiles_thesis"
    holds = sorted((profiles / "grasps").glob("*.dsa"))
    for one in sorted(path for path in objects.iterdir() if path.is_dir()):
        holds += list(numbered(one, "*.dsa"))[:_GRASPS_EACH]
    for path in [*slips, *holds]:
        time_s, readings = pressure_profile(path)
        group = path.stem if path in slips else path.parent.name
        name = f"{path.parent.name}/{path.stem}"
        yield Log(name, group, time_s, readings, label=path in slips, pads=_SDH2_PADS)


_PROBES_N = (5, 10, 20, 30, 40)


def velostat(folder: Path) -> Iterator[Log]:
    """Two probes that press on conductive foil, the first run of each force; stamps of one host."""
    data = folder / "src/experimental_data"
    for probe in ("pike1", "pike5"):
        for force_n in _PROBES_N:
            name = f"{probe}_force_{force_n}"
            run = f"{name}/exp_{name}_sensor1_exp1.txt"
            readings, cell = np.loadtxt(data / "velostat_data" / run), np.loadtxt(data / "futek_data" / run)
            forces = np.full((len(readings), 3), np.nan)
            forces[:, 2] = np.interp(readings[:, 1], cell[:, 1], cell[:, 0])
            yield Log(name, name, readings[:, 1], readings[:, :1], forces=forces)


def optical_finger(folder: Path) -> Iterator[Log]:
    """A soft finger that is pressed on a force sensor, filtered by its maker; columns fz, s0 to s3, time."""
    for path in numbered(folder / "skin/datasets/squishy-skin/raw-data/simplified", "*.csv"):
        table = rows(path, header=True)
        forces = np.full((len(table), 3), np.nan)
        forces[:, 2] = table[:, 0]
        yield Log(path.stem, path.stem, table[:, 5], table[:, 1:5], forces=forces)


def uskin(folder: Path) -> Iterator[Log]:
    """Boxes that two fingers hold and a robot moves, until some are dropped; rows spread over the run."""
    for path in sorted(folder.glob("t*/data_sample_*/meta_data.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            about = next(csv.DictReader(file))
        fingers = [rows(path.with_name(f"xela_sensor{finger}.csv"), header=True) for finger in (1, 2)]
        n = min(map(len, fingers))
        begin, end = (datetime.fromisoformat(about[key]) for key in ("start_time", "stop_time"))
        yield Log(
            path.parent.name,
            about["object_name"],
            np.linspace(0.0, (end - begin).total_seconds(), n),
            np.hstack([finger[:n] for finger in fingers]),
            label=about["dropped"] == "1",
        )


# Names of files, the strain gauge without a weight, and its change by a newton.
_TAMS_GAUGES = (
    ("[nt]*.txt", 8322237, (8341540 - 8322237) / (0.05 * 9.80665)),
    ("10k-*.txt", 1660130, (1667333 - 1660130) / (0.16 * 9.80665)),
)


def tams(folder: Path) -> Iterator[Log]:
    """Presses on a conductive polymer under no, thin and thick silicone, and their force; no times."""
    for names, free, per_n in _TAMS_GAUGES:
        for path in sorted((folder / "calibration").glob(names)):
            strain, reading = np.loadtxt(path).T
            forces = np.full((len(strain), 3), np.nan)
            forces[:, 2] = (strain - free) / per_n
            yield Log(
                path.stem, path.stem, np.arange(len(strain), dtype=float), reading[:, None], forces=forces
            )


_ICUB_LINES = 7  # of a scan: joints, largest readings, five fingers
_ICUB_HZ = 10.0  # not stated


def icub(folder: Path) -> Iterator[Log]:
    """Hands that close on an object or on nothing; one object is left out, as its authors advise."""
    for path in numbered(folder / "iCubGraspDataset", "*.txt"):
        thing, trial = path.stem.rsplit("_", 1)
        if thing == "full_coke":
            continue
        lines = path.read_text().splitlines()[1:]
        scans = [lines[at + 2 : at + _ICUB_LINES] for at in range(0, len(lines), _ICUB_LINES)]
        readings = np.array([" ".join(scan).split() for scan in scans], dtype=np.float64)
        time_s = np.arange(len(readings)) / _ICUB_HZ
        yield Log(path.stem, f"trial {trial}", time_s, readings, label=thing != "none")


READERS: dict[str, Callable[[Path], Iterator[Log]]] = {
    "FabricSlide": fabric_slide,
    "BioTac_slide_20_50": biotac_materials,
    "BioTacSP-DoS": biotac_sp,
    "eFlesh tugs": eflesh_tugs,
    "eFlesh presses": eflesh_presses,
    "eFlesh shears": eflesh_shears,
    "Tactaxis": tactaxis,
    "SDH-2": sdh2,
    "velostat": velostat,
    "tactileforce": optical_finger,
    "uSkin": uskin,
    "TAMS array": tams,
    "iCub": icub,
}
