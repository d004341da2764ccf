"""The clients of C++ and C as others build them: installed, found by CMake and pkg-config, no warning."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from cpp import HEADERS, ROOT, WARNINGS, compile_native, need_native

from tactiled.version import __version__

HEADER_C = HEADERS / "tactiled.h"
EXAMPLE, EXAMPLE_C = ROOT / "examples" / "hold.cpp", ROOT / "examples" / "listen.c"
PAGE = (ROOT / "docs" / "native.md").read_text()
MORE_LISTS = """
target_sources(hold PRIVATE other.cpp)
add_executable(listen listen.c)
target_link_libraries(listen tactiled::c)
"""
# A small header, and the library that the client needs.
SMALL = "#include <tactiled_grip_controller.hpp>\n#include <zmq.h>\nint main() { return zmq_errno(); }\n"
OTHER = "#include <tactiled.hpp>\nbool is_open(tactiled::Subscription& events) { return events.poll(); }\n"


def blocks(language: str) -> list[str]:
    """Blocks of code of the page."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Prefix of an installation."""
    need_native("cmake", "pkg-config")
    folder = tmp_path_factory.mktemp("installed")
    run("cmake", "-S", HEADERS, "-B", folder / "build", "-DCMAKE_BUILD_TYPE=Debug", cwd=folder)
    run("cmake", "--build", folder / "build", cwd=folder)
    run("cmake", "--install", folder / "build", "--prefix", folder / "prefix", cwd=folder)
    return folder / "prefix"


def test_cmake_finds_it(installed: Path, tmp_path: Path) -> None:
    (lists,) = blocks("cmake")
    (tmp_path / "CMakeLists.txt").write_text(lists.replace("tactiled REQ", "tactiled 0.1 REQ") + MORE_LISTS)
    for source in (EXAMPLE, EXAMPLE.with_name("emulated_gripper.hpp")):
        shutil.copy(source, tmp_path)
    (tmp_path / "listen.c").write_text(EXAMPLE_C.read_text())
    (tmp_path / "other.cpp").write_text(OTHER)  # two files of one program include the header
    flags = f"-DCMAKE_CXX_FLAGS={' '.join(WARNINGS)}"
    run("cmake", "-B", "build", f"-DCMAKE_PREFIX_PATH={installed}", flags, cwd=tmp_path)
    run("cmake", "--build", "build", cwd=tmp_path)
    assert (tmp_path / "build" / "hold").exists()
    says_what_is_wrong(tmp_path / "build" / "listen")


def says_what_is_wrong(listen: Path) -> None:
    """Assert that the program has found libtactiled, which refuses to listen to nothing."""
    done = subprocess.run([listen], capture_output=True, text=True, check=False)
    assert done.stderr.startswith("listen: endpoint")


def test_pkg_config_finds_it(installed: Path, tmp_path: Path) -> None:
    (library,) = installed.glob("lib*/**/pkgconfig")
    environ = ("env", f"PKG_CONFIG_PATH={installed}/share/pkgconfig:{library}", "pkg-config")
    flags = run(*environ, "--cflags", "--libs", "tactiled", cwd=tmp_path).split()
    (tmp_path / "small.cpp").write_text(SMALL)
    run("c++", *WARNINGS, "small.cpp", *flags, "-o", "small", cwd=tmp_path)
    flags = run(*environ, "--cflags", "--libs", "libtactiled", cwd=tmp_path).split()
    run("cc", EXAMPLE_C, *flags, f"-Wl,-rpath,{library.parent}", "-o", "listen", cwd=tmp_path)
    says_what_is_wrong(tmp_path / "listen")
    for name in ("tactiled", "libtactiled"):
        assert run(*environ, "--modversion", name, cwd=tmp_path).strip() == __version__


# OTHER does the same for tactiled.hpp.
@pytest.mark.parametrize(
    "header", sorted({*HEADERS.glob("*.hpp")} - {HEADERS / "tactiled.hpp"}), ids=lambda header: header.name
)
def test_each_header_includes_what_it_needs(header: Path, tmp_path: Path) -> None:
    need_native()
    (tmp_path / "only.cpp").write_text(f'#include "{header.name}"\nint main() {{}}\n')
    compile_native(tmp_path / "only.cpp", tmp_path / "only", "-fsyntax-only")


def test_the_page_compiles(tmp_path: Path) -> None:
    need_native()
    programs = blocks("cpp")
    assert len(programs) >= 2
    for number, block in enumerate(programs):
        source = tmp_path / f"{number}.cpp"
        source.write_text(block)
        compile_native(source, tmp_path / str(number), "-fsyntax-only")


def test_the_example_has_30_lines() -> None:
    assert len(EXAMPLE.read_text().splitlines()) <= 30


def test_the_manual_has_every_function(installed: Path) -> None:
    page = installed / "share" / "man" / "man3" / "libtactiled.3"
    words = re.findall(r"^\.Fn (tactiled_\w+) \S", page.read_text(), re.MULTILINE)
    declared = re.findall(
        r"\b(tactiled_\w+)\(", re.sub(r"/\*.*?\*/", "", HEADER_C.read_text(), flags=re.DOTALL)
    )
    assert sorted(set(words)) == sorted(declared)
    if shutil.which("groff") is not None:
        done = subprocess.run(
            ["groff", "-mdoc", "-Tutf8", "-ww", page], capture_output=True, text=True, check=True
        )
        assert done.stderr == ""
