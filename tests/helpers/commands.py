"""Commands of tactiled, run in this process."""

import sys

import pytest

from tactiled.cli import main


def call(*arguments: str) -> int:
    """Run a command of tactiled in this process, and return its exit code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["tactiled", *arguments])
        with pytest.raises(SystemExit) as left:
            main()
    return int(left.value.code or 0)
