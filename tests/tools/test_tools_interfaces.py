"""Generated interfaces: what is committed is what the schemas give."""

import pytest

from tools.interfaces import ROOT, generated


@pytest.mark.parametrize("name", sorted(generated()))
def test_what_is_generated_is_committed(name: str) -> None:
    assert (ROOT / name).read_text() == generated()[name]


def test_the_message_package_has_no_other_message() -> None:
    folder = ROOT / "ros2" / "tactiled_msgs" / "msg"
    found = {str(path.relative_to(ROOT)) for path in folder.iterdir()}
    assert found == {name for name in generated() if name.endswith(".msg")}
