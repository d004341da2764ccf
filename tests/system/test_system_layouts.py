"""Real processes: a board with frames that have neither checksum nor sequence number, and a rate to be measured."""

from pathlib import Path

import pytest
from test_system_daemon import Setup, end

pytestmark = pytest.mark.system


@pytest.mark.parametrize("protocol", ["magnetometers-5", "lines-15"])
def test_magnetometers_from_the_board_to_the_client(tmp_path: Path, protocol: str) -> None:
    setup = Setup(tmp_path)
    with setup.config.open("a") as config:
        config.write(f'[board]\nprotocol = "{protocol}"\narray = "magnetometers-5"\n')
    arguments = ("emulate", "--scene", "rest", "--protocol", protocol, "--link", str(setup.link))
    try:
        with setup.process(*arguments), setup.run() as daemon:
            scans = setup.listen("--topic", "scan", "--count", "20")
            (status,) = setup.listen("--topic", "status", "--count", "1")
            end(daemon)
    finally:
        setup.notify.close()
    assert status["state"] == "running"
    assert status["rate_hz"] == pytest.approx(100.0, rel=0.02)
    assert (status["loss_known"], status["damage_known"]) == (False, False)
    for row in scans:
        volts = row["volts"]
        assert isinstance(volts, list)
        assert len(volts) == 15
        assert max(abs(value) for value in volts[0::3] + volts[1::3]) < 100.0  # no shear, in uT
        assert max(volts[2::3]) < -4900.0  # no load: the lower end of the range
