"""What a configuration alone says of grooves: for `check-config`, which touches no board."""

from tactiled.config import Setup
from tactiled.doctor.finding import Finding
from tactiled.doctor.resolving import check_array

_RATE_HZ = 100.0  # of the published board, where the configuration leaves the rate to the board


def resolved_in_words(setup: Setup) -> list[str]:
    """Lines on which grooves can be told, at the speed of the file or, where it says none, at any."""
    detect = setup.config.detect
    texture = detect.wang2019.texture if detect.setting == "wang2019" else detect.texture
    rate_hz = setup.config.session.rate_hz or _RATE_HZ
    return [
        _line(finding)
        for finding in check_array(setup.array, texture, rate_hz, texture.speed_mm_s)
        if finding.check != "direction"
    ]


def _line(finding: Finding) -> str:
    remedy = f" -> {finding.remedy}" if finding.remedy else ""
    return f"{finding.check}: {finding.words}{remedy}"
