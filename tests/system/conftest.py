"""What several modules of this folder need, made once."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from nspawn import NEW, OLD, ContainerError, check_able, download_pins, make_root, make_wheels


@pytest.fixture(scope="session")
def bare_debian(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Root of a small Debian, to be copied; tests are skipped, with the reason, where none can be."""
    root = tmp_path_factory.mktemp("debian") / "root"
    try:
        check_able()
        make_root(root)
        yield root
    except ContainerError as reason:
        pytest.skip(f"not tested in a container: {reason}")
    finally:
        shutil.rmtree(root, ignore_errors=True)


@pytest.fixture(scope="session")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two versions of tactiled, `OLD` and `NEW`, and all that they need."""
    folder = tmp_path_factory.mktemp("wheels")
    try:
        check_able()
        download_pins(folder)
    except ContainerError as reason:
        pytest.skip(f"not tested in a container: {reason}")
    for version in (OLD, NEW):
        make_wheels(folder, version)
    return folder
