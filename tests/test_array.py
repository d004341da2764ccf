"""Geometry: places, pairs and signs as array.py states them, and array files refused by the place."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info

from tactiled import resources, tomlfile
from tactiled.array import Array, ArrayFile, build, load_array, numerics_words
from tactiled.errors import ConfigError

SIDES = [
    {"name": "R1", "kind": "side", "azimuth_deg": 180.0},
    {"name": "R2", "kind": "side", "azimuth_deg": 270.0},
    {"name": "R3", "kind": "side", "azimuth_deg": 0.0},
    {"name": "R4", "kind": "side", "azimuth_deg": 90.0},
]


def array_of(**document: Any) -> Array:
    return build(tomlfile.parse({"name": "test", **document}, ArrayFile, "test.toml"))


@pytest.mark.parametrize("name", resources.shipped_names("config/arrays"))
def test_each_shipped_array_loads_under_its_own_name(name: str) -> None:
    array = load_array(name)
    assert array.name == name
    assert array.n_channels == len(array.channel_name) == len(set(array.channel_name))
    assert set(array.channel_taxel) == set(range(array.n_taxels))


def test_the_published_array_is_the_vernier_of_the_paper() -> None:
    array = load_array("wang2019-3x3")
    assert (array.n_taxels, array.n_channels) == (9, 36)
    assert array.channel_name[:5] == ("t0.R1", "t0.R2", "t0.R3", "t0.R4", "t1.R1")
    # taxel = 3 * row + column; the gaps are 3.5 mm, then 3.8 mm, both ways.
    for taxel in range(9):
        row, column = divmod(taxel, 3)
        assert (array.x_mm[taxel], array.y_mm[taxel]) == ([0.0, 3.5, 7.3][column], [0.0, 3.5, 7.3][row])
    assert array.columns() == [[0, 3, 6], [1, 4, 7], [2, 5, 8]]
    assert array.rows() == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    assert array.has_shear


def test_sliding_along_x_raises_r1_and_lowers_r3() -> None:
    """The pair signature of the paper: positive along x is R1 up, R3 down; along y, R2 up, R4 down."""
    weights = load_array("wang2019-3x3").shear_weights()
    assert weights.shape == (2, 9, 36)
    np.testing.assert_array_equal(weights[0, 4, 16:20], [1, 0, -1, 0])
    np.testing.assert_array_equal(weights[1, 4, 16:20], [0, 1, 0, -1])
    # No taxel listens to another's channels.
    assert np.count_nonzero(weights) == 9 * 4


@given(theta_deg=st.floats(-180, 180), strength=st.floats(0.01, 10))
def test_side_channels_give_back_the_direction(theta_deg: float, strength: float) -> None:
    """A side channel at phi answers motion along theta as -cos(theta - phi)."""
    array = array_of(grids=[{"x_mm": [0.0], "y_mm": [0.0]}], taxel_channels=SIDES)
    azimuth = np.deg2rad([180.0, 270.0, 0.0, 90.0])
    volts = -strength * np.cos(np.deg2rad(theta_deg) - azimuth)
    x, y = array.shear_weights()[:, 0] @ volts
    assert np.hypot(x, y) == pytest.approx(2 * strength)
    assert abs(np.angle(np.exp(1j * (np.arctan2(y, x) - np.deg2rad(theta_deg))))) < 1e-9


def test_shear_and_normal_channels_keep_their_axis_and_sign() -> None:
    array = array_of(
        taxels=[{"x_mm": 0.0, "y_mm": 0.0}, {"x_mm": 1.0, "y_mm": 0.0}],
        channels=[
            {"name": "z", "kind": "normal", "taxel": 1},
            {"name": "x", "kind": "shear_x", "taxel": 1, "sign": -1},
            {"name": "y", "kind": "shear_y", "taxel": 1},
            {"name": "z", "kind": "normal", "taxel": 0, "sign": -1},
        ],
    )
    np.testing.assert_array_equal(array.shear_weights()[0], [[0, 0, 0, 0], [0, -1, 0, 0]])
    np.testing.assert_array_equal(array.shear_weights()[1], [[0, 0, 0, 0], [0, 0, 1, 0]])
    np.testing.assert_array_equal(array.normal_weights(), [[0, 0, 0, -1], [1, 0, 0, 0]])
    assert array.channel_name == ("t1.z", "t1.x", "t1.y", "t0.z")


def test_pressure_of_side_channels_is_their_mean() -> None:
    """Motion alone, which raises one side as it lowers the other, is no pressure."""
    weights = load_array("wang2019-3x3").normal_weights()
    np.testing.assert_array_equal(weights.sum(axis=1), np.ones(9))
    np.testing.assert_array_equal(weights[2, 8:12], [0.25] * 4)


def test_an_array_without_shear_says_so() -> None:
    array = load_array("normal-3x3")
    assert not array.has_shear
    assert np.isnan(array.azimuth_deg).all()


def test_pads_are_not_mixed_into_one_line() -> None:
    pad = {"x_mm": [0.0, 1.0], "y_mm": [0.0, 1.0]}
    array = array_of(grids=[pad, pad], taxel_channels=[{"name": "z", "kind": "normal"}])
    assert list(array.pad) == [0] * 4 + [1] * 4
    assert array.columns() == [[0, 2], [1, 3], [4, 6], [5, 7]]
    assert array.rows() == [[0, 1], [2, 3], [4, 5], [6, 7]]


def test_a_taxel_alone_is_no_line() -> None:
    array = array_of(
        taxels=[{"x_mm": 0.0, "y_mm": 2.0}, {"x_mm": 0.0, "y_mm": 0.0}, {"x_mm": 5.0, "y_mm": 1.0}],
        taxel_channels=[{"name": "z", "kind": "normal"}],
    )
    assert array.columns() == [[1, 0]]  # in growing y, whatever the numbers
    assert array.rows() == []


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"grids": []}, "give either [[grids]] or [[taxels]]"),
        ({"taxels": [{"x_mm": 0.0, "y_mm": 0.0}]}, "give either [[grids]] or [[taxels]]"),
        ({"taxel_channels": []}, "give either [[taxel_channels]] or [[channels]]"),
        ({"grids": [{"x_mm": [0.0, 0.0], "y_mm": [0.0]}]}, "grids[0]: x_mm must grow from entry to entry"),
        ({"grids": [{"x_mm": [0.0], "y_mm": [1.0, 0.5]}]}, "grids[0]: y_mm must grow"),
        ({"grids": [{"x_mm": [], "y_mm": [0.0]}]}, "grids[0].x_mm: "),
        ({"grids": [{"x_mm": [float("nan")], "y_mm": [0.0]}]}, "grids[0].x_mm[0]: "),
        (
            {"grids": [{"x": [0.0], "y_mm": [0.0]}]},
            "grids[0].x: unknown key; units belong to the name here: use x_mm",
        ),
        (
            {"grids": [{"x_cm": [0.0], "y_mm": [0.0]}]},
            "grids[0].x_cm: unknown key; units belong to the name here",
        ),
        (
            {"taxel_channels": [{"name": "R1", "kind": "side"}]},
            "taxel_channels[0]: azimuth_deg belongs to kind",
        ),
        (
            {"taxel_channels": [{"name": "z", "kind": "normal", "azimuth_deg": 0.0}]},
            "taxel_channels[0]: azimuth_deg belongs to kind = 'side', and to no other kind",
        ),
        ({"taxel_channels": [{"name": "z", "kind": "force"}]}, "taxel_channels[0].kind: "),
        ({"taxel_channels": [{"name": "z", "kind": "normal", "sign": 2}]}, "taxel_channels[0].sign: "),
        (
            {"taxel_channels": [], "channels": [{"name": "z", "kind": "normal", "taxel": 4}]},
            "channels[0].taxel is 4, but there are 4 taxels",
        ),
        ({"unit": "count"}, "range is missing: with unit = 'count'"),
        ({"unit": "volts"}, "unit: "),
        ({"range": [5, 5]}, "range is [5, 5]; the second number must be larger"),
        ({"zero": "first 3"}, "zero is 'first 3'; give a number, a list, or 'first 0.3 s'"),
        ({"zero": "first 0 s"}, "zero is 'first 0 s'"),
        ({"zero": [1.0, 2.0]}, "zero has 2 numbers, but there are 4 channels"),
        ({"zero": 9.0}, "zero is 9, outside the range [-8, 8]"),
        (
            {"contact": {"above": 1.0, "below": 2.0, "loading_per_s": 1.0}},
            "contact: below is 2, which is more",
        ),
        ({"taxel_count": 4}, "give either [[grids]] or [[taxels]], or taxel_count"),
        ({"name": "x" * 25}, "name: "),
        ({"name": "a\x1b[31m"}, "name: "),
        ({"grids": [{"x_mm": [0.0, 1e308], "y_mm": [0.0]}]}, "grids[0].x_mm[1]: "),
        ({"grids": [{"x_mm": [float(k) for k in range(257)], "y_mm": [0.0]}]}, "grids[0].x_mm: "),
    ],
)
def test_a_broken_array_file_is_refused_by_its_place(change: dict[str, Any], fault: str) -> None:
    good = {
        "name": "test",
        "grids": [{"x_mm": [0.0, 1.0], "y_mm": [0.0, 1.0]}],
        "taxel_channels": [{"name": "z", "kind": "normal"}],
    }
    build(tomlfile.parse(good, ArrayFile, "test.toml"))
    with pytest.raises(ConfigError) as caught:
        tomlfile.parse(good | change, ArrayFile, "test.toml")
    assert any(line.startswith(fault) for line in caught.value.faults), caught.value.faults


def test_readings_are_in_range_between_its_ends() -> None:
    pad = {"x_mm": [0.0], "y_mm": [0.0]}
    channel = {"name": "z", "kind": "normal"}
    array = array_of(grids=[pad], taxel_channels=[channel], range=[-3.3, 3.3])
    assert (array.unit, array.low, array.high, array.full_scale) == ("V", -3.3, 3.3, 3.3)
    counts = array_of(grids=[pad], taxel_channels=[channel], unit="count", range=[0, 1023], zero=500)
    assert counts.full_scale == 1023
    assert counts.in_range(np.array([0.0, 1022.0, 1023.0, -1.0, np.nan])).tolist() == [True] * 2 + [False] * 3
    falling = array_of(
        grids=[pad], taxel_channels=[{**channel, "sign": -1}], unit="count", range=[0, 1023], zero=1023
    )
    assert falling.in_range(np.array([0.0, 1023.0, 1024.0, np.nan])).tolist() == [True] * 2 + [False] * 2
    field = array_of(grids=[pad], taxel_channels=[{**channel, "sign": -1}], unit="uT", range=[-5000, 5000])
    assert field.in_range(np.array([4999.0, 5000.0])).tolist() == [True, False]


@pytest.mark.parametrize("kind", ["axes", "sides"])
@pytest.mark.parametrize(("mirrored", "signs"), [("x", (-1, 1)), ("y", (1, -1))])
def test_a_mirrored_pad_reverses_the_shear_along_one_axis_of_its_own(
    kind: str, mirrored: str, signs: tuple[int, int]
) -> None:
    xyz = [{"name": name, "kind": name} for name in ("shear_x", "shear_y", "normal")]
    channels = xyz if kind == "axes" else SIDES
    plain, other = (
        array_of(grids=[{"x_mm": [0.0, 3.0], "y_mm": [0.0], "axes_deg": 90.0} | own], taxel_channels=channels)
        for own in ({}, {"mirrored": mirrored})
    )
    turned = signs[::-1]  # the pad's own x axis is y of the array
    expected = plain.shear_weights() * np.array(turned)[:, np.newaxis, np.newaxis]
    np.testing.assert_allclose(other.shear_weights(), expected, atol=1e-12)
    np.testing.assert_array_equal(other.normal_weights(), plain.normal_weights())


@pytest.mark.parametrize("axes_deg", [0.0, 90.0, 180.0, -90.0, 30.0])
def test_a_turned_pad_gives_the_direction_in_the_frame_of_the_array(axes_deg: float) -> None:
    kinds = ("shear_x", "shear_y", "normal")
    xyz = [{"name": kind, "kind": kind} for kind in kinds]
    array = array_of(grids=[{"x_mm": [0.0], "y_mm": [0.0], "axes_deg": axes_deg}], taxel_channels=xyz)
    resistors = array_of(grids=[{"x_mm": [0.0], "y_mm": [0.0], "axes_deg": axes_deg}], taxel_channels=SIDES)
    theta, turn = np.deg2rad(25.0), np.deg2rad(axes_deg)
    felt = np.array([np.cos(theta - turn), np.sin(theta - turn), 0.0])  # motion in the frame of the pad
    np.testing.assert_allclose(array.shear_weights()[:, 0] @ felt, [np.cos(theta), np.sin(theta)], atol=1e-12)
    sides = np.array([felt[0], felt[1], -felt[0], -felt[1]])  # R1 rises with motion along +x
    np.testing.assert_allclose(resistors.shear_weights()[:, 0] @ sides / 2, [np.cos(theta), np.sin(theta)])


def test_places_may_be_unknown() -> None:
    array = array_of(taxel_count=3, taxel_channels=[{"name": "z", "kind": "normal"}])
    assert (array.n_taxels, array.n_channels, array.has_places) == (3, 3, False)
    assert "at unknown places" in array.in_words()


def test_an_unknown_name_lists_the_shipped_arrays() -> None:
    with pytest.raises(
        ConfigError, match=r"no array named 'wang2018'; shipped: .*wang2019-3x3.*; or give a file"
    ):
        load_array("wang2018")


def test_an_array_is_loaded_from_a_path(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(resources.shipped("config", "arrays", "normal-4x4.toml").read_text())
    assert load_array(str(path)).n_taxels == 16
    with pytest.raises(ConfigError, match=r"lap\.toml: no such file; beside it there are: lab"):
        load_array(str(tmp_path / "lap.toml"))


def test_the_libraries_named_do_not_depend_on_the_addresses_they_were_loaded_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import scipy.linalg  # noqa: F401  # brings a BLAS of its own

    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    for listed in (threadpool_info(), threadpool_info()[::-1]):
        monkeypatch.setattr("tactiled.array.threadpool_info", lambda listed=listed: listed)
        assert f"{blas['version']} for" in numerics_words()
