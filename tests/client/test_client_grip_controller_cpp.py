"""The controller of C++ commands the same forces as that of Python, message by message."""

import math
import os
import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactiled.client import GripController, grip_controller

ROOT = Path(__file__).resolve().parents[2]
SOURCE = """
#include <iomanip>
#include <iostream>
#include <string>
#include "tactiled_grip_controller.hpp"

static double number() {
    std::string word;  // streams read no "nan"
    std::cin >> word;
    return std::stod(word);
}

int main() {
    const double target = number(), start_n = number(), least_n = number(), most_n = number();
    tactiled::GripController controller(target, start_n, least_n, most_n);
    std::cout << std::setprecision(17) << controller.command_n() << "\\n";
    tactiled::Grip grip;
    double present_n = 0;
    while (std::cin >> grip.state) {
        if (grip.state == "blind") {
            std::cout << controller.blind() << "\\n";
            continue;
        }
        std::cin >> grip.board;
        for (double *each : {&grip.timestamp, &grip.load, &grip.shear_x, &grip.shear_y, &grip.friction_low,
                             &grip.friction})
            *each = number();
        std::cin >> grip.valid >> grip.late;
        present_n = number();
        std::cout << controller.take(grip, present_n) << "\\n";
    }
}
"""
NUMBERS = "timestamp", "load", "shear_x", "shear_y", "friction_low", "friction", "valid", "late"


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("c++") is None and "TACTILED_CI" not in os.environ:
        pytest.skip("needs c++")
    folder = tmp_path_factory.mktemp("cpp")
    (folder / "main.cpp").write_text(SOURCE)
    include = ROOT / "protocols" / "cpp"
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{include}"]
    subprocess.run(["c++", *flags, "main.cpp", "-o", "controller"], cwd=folder, check=True)
    return folder / "controller"


def messages(seed: int) -> Iterator[dict[str, Any]]:
    """Draw a grasp: shear that grows, falls and drops, slips, gaps, other objects, bad numbers, clock steps.

    It is lifted at one of several rates. The load is over the force that the gripper exerts.
    """
    rng = np.random.default_rng(seed)
    steps = rng.choice([0.0, 0.01, -0.01, 0.1, -0.08], 800, p=[0.5, 0.27, 0.19, 0.02, 0.02])
    shear = np.exp(np.cumsum(steps).clip(-3.0, 0.7)) * (np.arange(800) > 70)
    friction = np.exp(rng.normal(-0.3, 0.2) + np.cumsum(rng.normal(0.0, 0.002, 800)))
    angle, at_s = float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0, 1e9))
    state, readings = "sticking", 0.7
    lifted_s = 1 / (20, 50, 100, 500, 1000)[seed % 5]
    for k in range(800):
        readings = float(rng.choice([0.7, 1.6])) if rng.random() < 0.02 else readings
        if state != "unknown" or rng.random() < 0.02:
            states = ["sticking", "partial", "gross", "none", "unknown"]
            state = str(rng.choice(states, p=[0.984, 0.01, 0.004, 0.001, 0.001]))
        period_s = lifted_s if k > 70 else 0.01
        at_s += float(rng.choice([period_s, 0.08, 0.5, -30.0], p=[0.988, 0.008, 0.002, 0.002]))
        message = {
            "timestamp": at_s,
            "load": float(rng.normal(readings, 0.002)) if rng.random() > 0.005 else 0.0,
            "shear_x": float(shear[k]) * math.cos(angle),
            "shear_y": float(shear[k]) * math.sin(angle),
            "friction_low": float(rng.uniform(0.6, 0.9)) * float(friction[k]),
            "friction": float(friction[k]),
            "state": state,
            "board": "left" if rng.random() > 0.01 else "right",
            "valid": bool(rng.random() > 0.01),
            "late": bool(rng.random() < 0.01),
        }
        if rng.random() < 0.01:
            message[str(rng.choice(NUMBERS[:-2]))] = float(rng.choice([math.nan, math.inf]))
        yield message


def test_both_have_the_same_numbers() -> None:
    header = (ROOT / "protocols" / "cpp" / "tactiled_grip_controller.hpp").read_text()
    found = re.findall(r"\b([A-Z][A-Z_]*) = ([0-9.]+(?:e[0-9]+)?)", header)
    of_header = {name: float(value) for name, value in found}
    of_module = {
        name.removeprefix("_"): value
        for name, value in vars(grip_controller).items()
        if isinstance(value, float)
    }
    assert of_header == of_module


def assert_same_forces(program: Path, drawn: Iterable[dict[str, Any]], seed: int) -> None:
    """Play messages to both; their load is over the force that the gripper exerts. Some readings are lost."""
    rng = np.random.default_rng([seed, 1])
    limits = 0.5 + 0.4 * float(rng.random()), 6.0, 1.0, 40.0
    controller = GripController(*limits)
    lines, expected, present_n = [" ".join(map(repr, limits))], [controller.command_n], 6.0
    for message in drawn:
        message["load"] *= present_n
        if rng.random() < 0.005:
            lines.append("blind")
            expected.append(controller.blind())
        numbers = [repr(float(message[name])) for name in NUMBERS[:-2]]
        flags = [str(int(message[name])) for name in NUMBERS[-2:]]
        read_n = float(rng.choice([0.0, -1.0, math.nan])) if rng.random() < 0.02 else present_n
        lines.append(" ".join([message["state"], message["board"], *numbers, *flags, repr(read_n)]))
        expected.append(controller.take(message, read_n))
        present_n += 0.5 * (controller.command_n - present_n)
    done = subprocess.run(
        [program], input="\n".join(lines), capture_output=True, text=True, check=True, timeout=60
    )
    found = [float(line) for line in done.stdout.splitlines()]
    assert found == pytest.approx(expected, rel=1e-9)
    assert len(set(expected)) >= 5


@pytest.mark.parametrize("seed", range(20))
def test_both_controllers_command_the_same_forces(program: Path, seed: int) -> None:
    assert_same_forces(program, messages(seed), seed)


@pytest.mark.parametrize("rate_hz", [100, 200, 500, 1000])
def test_both_controllers_command_the_same_forces_while_an_object_sways(program: Path, rate_hz: int) -> None:
    sway = (
        {
            "timestamp": k / rate_hz, "load": 0.7, "shear_y": 0.0, "friction_low": 0.5, "friction": 0.6,
            "shear_x": (k > 0.7 * rate_hz) * (2.0 + 0.4 * math.sin(4 * math.pi * k / rate_hz)),
            "state": "sticking", "board": "left", "valid": True, "late": False,
        }
        for k in range(3 * rate_hz)
    )  # fmt: skip
    assert_same_forces(program, sway, rate_hz)


@pytest.mark.parametrize(
    "limits",
    [
        (math.nan, 6.0, 1.0, 40.0),
        (0.0, 6.0, 1.0, 40.0),
        (0.9, math.nan, 1.0, 40.0),
        (0.9, 6.0, math.nan, 40.0),
        (0.9, 6.0, 50.0, 40.0),
        (0.9, 6.0, 1.0, math.nan),
        (0.9, 6.0, 1.0, math.inf),
    ],
)
def test_both_refuse_limits_that_mean_nothing(program: Path, limits: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="0 <= least_n <= most_n"):
        GripController(*limits)
    words = " ".join(map(str, limits))
    done = subprocess.run([program], input=words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0
    assert "0 <= least_n <= most_n" in done.stderr
