"""Readers of the sources of the catalogue: a checkout of each to logs, in the order of `catalogue.toml`."""

import csv
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
from scipy.signal import medfilt

from bench.recordings.log import Log, numbered, pressure_profile, rows, tensor
from tactiled.array import FloatArray


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


_HAND_COLUMNS = slice(15, 18)  # of robot_state.csv: place of the hand
# Of marker.csv: place and quaternion, from a camera that the hand holds.
_MARKERS = slice(0, 7), slice(7, 14)
_MOVES_M, _SEEN_M = 0.01, 1.0  # the hand has left the table; a marker is nearer than that
_HELD = 0.3  # of the largest load
_RESTS_DEG, _SLIPS_DEG = 5.0, 10.0  # largest turn of a box that is held, and least of one that slips


def uskin(folder: Path) -> Iterator[Log]:
    """Boxes that two fingers hold and a robot moves, and that turn in the hand or do not.

    The turn is that of a marker on the box. Left out are runs in which none is seen, and turns of 5 to 10
    degrees.
    """
    for path, log in _uskin_runs(folder):
        load = (log.readings[:, 2::3] - log.readings[0, 2::3]).sum(axis=1)
        ends_s = log.time_s[np.flatnonzero(load > _HELD * load.max())[-1]]
        hand = rows(path.with_name("robot_state.csv"), header=True)[:, _HAND_COLUMNS]
        markers = rows(path.with_name("marker.csv"), header=True)
        time_s = np.linspace(0.0, log.time_s[-1], len(hand))
        starts_s = time_s[np.argmax(np.linalg.norm(hand - hand[0], axis=1) > _MOVES_M)]
        _, turn_deg = max(_turn_deg(markers[:, one], time_s, starts_s, ends_s) for one in _MARKERS)
        if turn_deg < _RESTS_DEG or turn_deg >= _SLIPS_DEG:
            yield replace(log, label=turn_deg >= _SLIPS_DEG)


def _turn_deg(poses: FloatArray, time_s: FloatArray, starts_s: float, ends_s: float) -> tuple[int, float]:
    """Return in how many frames a hold shows a marker, and its largest turn (median of 7) since the lift."""
    is_new = np.append(True, (np.diff(poses, axis=0) != 0).any(axis=1))  # a marker that is not seen stays
    seen = is_new & (np.abs(poses[:, :3]).max(axis=1) < _SEEN_M) & poses[:, 3:].any(axis=1)
    time_s, turns = time_s[seen], poses[seen, 3:]
    before = turns[(time_s > starts_s - 1.0) & (time_s < starts_s)]
    held = turns[(time_s > starts_s) & (time_s < ends_s)]
    if len(before) < 3 or len(held) < 8:
        return 0, float("nan")
    rest = (before * np.sign(before @ before[0])[:, np.newaxis]).sum(axis=0)  # q and -q are one turn
    cosine = np.abs(held @ rest) / (np.linalg.norm(held, axis=1) * np.linalg.norm(rest))
    return len(held), float(medfilt(np.degrees(2.0 * np.arccos(np.minimum(cosine, 1.0))), 7).max())


def uskin_drops(folder: Path) -> Iterator[Log]:
    """Boxes that two fingers hold and a robot moves, until some are dropped."""
    return (log for _, log in _uskin_runs(folder))


def _uskin_runs(folder: Path) -> Iterator[tuple[Path, Log]]:
    """Yield each run with the path of its table; rows are spread over the run."""
    for path in sorted(folder.glob("t*/data_sample_*/meta_data.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            about = next(csv.DictReader(file))
        fingers = [rows(path.with_name(f"xela_sensor{finger}.csv"), header=True) for finger in (1, 2)]
        n = min(map(len, fingers))
        begin, end = (datetime.fromisoformat(about[key]) for key in ("start_time", "stop_time"))
        yield (
            path,
            Log(
                path.parent.name,
                about["object_name"],
                np.linspace(0.0, (end - begin).total_seconds(), n),
                np.hstack([finger[:n] for finger in fingers]),
                label=about["dropped"] == "1",
            ),
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
    "uSkin drops": uskin_drops,
    "TAMS array": tams,
    "iCub": icub,
}
