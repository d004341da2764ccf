"""The distributions: what each ships, what each needs, and that no file belongs to two."""

import ast
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from tactiled.version import __version__
from tools import release
from tools.release import metadata_of

ROOT = Path(__file__).resolve().parent.parent
PROJECTS = [ROOT, *sorted(path.parent for path in ROOT.glob("packages/*/pyproject.toml"))]
COMPILED = "tactiled.twice"  # only in the copy that wheels are built from
ADDRESS = "https://example.org/robots/tactiled"


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """All wheels, each built from its sdist, without the network, from a copy that knows its repository."""
    folder = tmp_path_factory.mktemp("wheels")
    copy = folder / "checkout"
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "-z"], cwd=ROOT, capture_output=True, check=True
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file() and not name.startswith(("tests/", "docs/")):
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            (copy / name).write_bytes((ROOT / name).read_bytes())
    project = copy / "pyproject.toml"
    project.write_text(project.read_text().replace('address = ""', f'address = "{ADDRESS}"'))
    # One small compiled module shows that a wheel carries what its hook compiles; each of ours costs seconds.
    (copy / "tactiled" / "twice.py").write_text("def twice(x):\n    return 2 * x\n")
    (copy / "tactiled" / "twice.pxd").write_text("cpdef double twice(double x)\n")
    names = copy / "tactiled" / "compiled.py"
    text, n = re.subn(r"(?ms)^MODULES = \(.*?^\)", f"MODULES = ({COMPILED!r},)", names.read_text())
    assert n == 1
    names.write_text(text)
    release.build(copy, folder)
    assert release.contradictions(copy, folder) == []
    return {path.name.split("-")[0]: path for path in folder.glob("*.whl")}


def files_of(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def test_no_file_belongs_to_two_distributions_and_none_is_missing(wheels: dict[str, Path]) -> None:
    assert len(wheels) == len(PROJECTS)
    shipped = sorted(name for wheel in wheels.values() for name in files_of(wheel))
    assert len(shipped) == len(set(shipped))
    sources = {str(path.relative_to(part)) for part in PROJECTS for path in (part / "tactiled").rglob("*.py")}
    assert {name for name in shipped if name.endswith(".py")} == sources | {"tactiled/twice.py"}
    assert "tactiled/py.typed" in files_of(wheels["tactiled_client"])


@pytest.mark.skipif(
    shutil.which("cc") is None and "TACTILED_CI" not in os.environ, reason="needs a C compiler"
)
def test_the_wheel_carries_what_the_hook_compiles_and_no_other_does(wheels: dict[str, Path]) -> None:
    compiled = {name: [file for file in files_of(wheels[name]) if file.endswith(".so")] for name in wheels}
    (library,) = compiled.pop("tactiled")
    assert library.startswith("tactiled/_twice_")
    assert not any(compiled.values())


def test_tactiled_is_a_namespace_in_every_distribution() -> None:
    """A `tactiled/__init__.py` in one of them would hide the modules of all others."""
    assert not [part for part in PROJECTS if (part / "tactiled" / "__init__.py").exists()]


def test_a_distribution_imports_only_those_that_it_depends_on() -> None:
    """Extras count: what needs one imports it where it is used."""
    names: list[str] = []
    places: dict[str, str] = {}
    needs: dict[str, set[str]] = {}
    for part in PROJECTS:
        project = tomllib.loads((part / "pyproject.toml").read_text())["project"]
        names.append(project["name"])
        asked = [*project["dependencies"]]
        if part != ROOT:  # the extras of the core are names for the distributions beside it
            asked += itertools.chain(*project.get("optional-dependencies", {}).values())
        needs[project["name"]] = {re.split(r"[\[=<>; ]", one)[0] for one in asked}
        for path in (part / "tactiled").rglob("*.py"):
            name = ".".join(path.relative_to(part).with_suffix("").parts).removesuffix(".__init__")
            places[name] = project["name"]
    wrong = []
    for name, part in zip(names, PROJECTS, strict=True):
        allowed = {name} | needs[name]
        allowed |= set(itertools.chain(*(needs.get(one, ()) for one in allowed)))
        for path in (part / "tactiled").rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                found: list[str] = []
                if isinstance(node, ast.ImportFrom) and node.module == "tactiled":
                    found = [f"tactiled.{one.name}" for one in node.names]
                elif isinstance(node, ast.ImportFrom) and node.module:
                    found = [node.module]
                elif isinstance(node, ast.Import):
                    found = [one.name for one in node.names]
                ours = [one for one in found if one.startswith("tactiled.")]
                wrong += [f"{path.relative_to(ROOT)}: {one}" for one in ours if places[one] not in allowed]
    assert wrong == []


def test_the_distributions_have_one_version_and_ask_for_each_other_at_it(wheels: dict[str, Path]) -> None:
    for wheel in wheels.values():
        metadata = metadata_of(wheel)
        assert metadata["Version"] == __version__
        asked = [line for line in metadata.get_all("Requires-Dist", []) if line.startswith("tactiled")]
        assert all(line.partition(";")[0].strip().endswith(f"=={__version__}") for line in asked), asked
    assert f"tactiled-client=={__version__}" in metadata_of(wheels["tactiled"]).get_all("Requires-Dist", [])


def test_every_sdist_brings_the_licence() -> None:
    """A link to the one at the top would lead nowhere in an archive."""
    for project in PROJECTS:
        assert (project / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_twine_accepts_the_files_and_dependencies_come_first(
    wheels: dict[str, Path],
) -> None:
    folder = wheels["tactiled"].parent
    order = release.upload_order(folder)
    release.run([sys.executable, "-m", "twine", "check", *map(str, order)], folder)
    assert {path.name for path in order if path.suffix == ".gz"} == {
        path.name for path in folder.glob("*.tar.gz")
    }
    names = [path.name.split("-")[0] for path in order if path.suffix == ".gz"]
    assert names[:2] == ["tactiled_client", "tactiled"]
    assert not [path.name for path in order if "-linux_" in path.name]  # an index refuses these


def test_the_daemon_installs_nothing_for_pictures(wheels: dict[str, Path]) -> None:
    needed = metadata_of(wheels["tactiled"]).get_all("Requires-Dist", [])
    plain = {re.split(r"[<>=\[; ]", line)[0] for line in needed if "extra ==" not in line}
    assert not plain & {"matplotlib", "mypy", "pytest"}
    extras = {line.split(";")[0].strip() for line in needed if "extra ==" in line}
    assert {"matplotlib>=3.9"} <= extras
    client = metadata_of(wheels["tactiled_client"]).get_all("Requires-Dist", [])
    assert {re.split("[<>=]", line)[0] for line in client if "extra ==" not in line} == {"pyzmq", "msgpack"}


def test_the_client_runs_with_zmq_and_msgpack_alone(wheels: dict[str, Path], tmp_path: Path) -> None:
    """In a bare environment; pyzmq and msgpack, and nothing else of ours, are linked into it."""
    import msgpack
    import zmq

    venv.create(tmp_path / "bare", with_pip=False, symlinks=True)
    python = tmp_path / "bare" / "bin" / "python"
    (site,) = (tmp_path / "bare").glob("lib/python*/site-packages")
    with zipfile.ZipFile(wheels["tactiled_client"]) as archive:
        archive.extractall(site)
    for package in (zmq, msgpack):
        folder = Path(str(package.__file__)).parent
        for beside in folder.parent.glob(f"{'pyzmq' if package is zmq else 'msgpack'}*"):
            (site / beside.name).symlink_to(beside)  # with the libraries that a wheel puts beside it
        if not (site / folder.name).exists():
            (site / folder.name).symlink_to(folder)
    script = (
        "import sys\n"
        "for name in ('numpy', 'scipy', 'pydantic', 'click', 'serial'): sys.modules[name] = None\n"
        "import tactiled.client, tactiled.client.listen, tactiled.client.__main__\n"
        "print(tactiled.client.__file__)\n"
    )
    done = subprocess.run([python, "-I", "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(site / "tactiled" / "client" / "__init__.py")

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [str(python), "-I", "-m", "tactiled.client", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    assert "Example: python -m tactiled.client" in run("--help").stdout
    assert run("--topic", "slipp").returncode == 2
    assert "it should look like" in run("nonsense").stderr
    silent = run(f"ipc://{tmp_path}/none.ipc", "--timeout", "0.1")
    assert (silent.returncode, silent.stdout) == (1, "")


def test_the_wheels_carry_all_that_the_program_needs(wheels: dict[str, Path], tmp_path: Path) -> None:
    """Installed from wheels, away from the checkout, protocols, config and scenes are still there."""
    for wheel in wheels.values():
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(tmp_path / "site")
    (tmp_path / "elsewhere").mkdir()

    def python(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, *arguments], cwd=tmp_path / "elsewhere", capture_output=True, text=True,
            timeout=60, check=False, env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(tmp_path / "site")},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "Example: tactiled listen" in python("-m", "tactiled", "listen", "--help")
    (tmp_path / "elsewhere" / "board.toml").write_text('[port]\nurl = "board"\n')
    assert json.loads(python("-m", "tactiled", "check-config", "board.toml"))["port"]["url"] == "board"
    script = (
        "import tactiled.resources as r; print(r.__file__);"
        "from tactiled.emulator.scene.description import load_scene; load_scene('demo');"
        "from tactiled.wire.layout import load_layout; load_layout('board-v1');"
        "print(r.shipped('systemd', 'tactiled@.service').exists());"
        "print(r.shipped('protocols', 'board.md').exists())"
    )
    own = str(tmp_path / "site" / "tactiled" / "resources.py")
    assert python("-c", script).split() == [own, "True", "True"]


@pytest.mark.parametrize("name", [path.name for path in sorted((ROOT / "systemd").glob("*.service"))])
def test_the_unit_names_documents_that_the_install_brings(wheels: dict[str, Path], name: str) -> None:
    installed = {name.partition(".data/data/")[2] for name in files_of(wheels["tactiled"])}
    unit = (ROOT / "systemd" / name).read_text()
    documents = re.findall(r"(?m)^Documentation=file:/opt/tactiled/(.*)$", unit)
    assert documents
    assert set(documents) <= installed  # pip of /opt/tactiled puts them where the unit says


def test_links_of_the_page_on_an_index_are_absolute(wheels: dict[str, Path]) -> None:
    """A package index shows README alone: a relative picture is a broken one there."""
    metadata = metadata_of(wheels["tactiled"])
    page = metadata.get_payload()
    assert f"({ADDRESS}/raw/v{__version__}/docs/demo.png)" in page
    assert f"({ADDRESS}/blob/v{__version__}/protocols/board.md)" in page
    assert not re.search(r"\]\((?!https?://)", str(page))
    addresses = metadata.get_all("Project-URL", [])
    assert f"Source, {ADDRESS}" in addresses
    assert any(line.startswith("Paper, https://doi.org/") for line in addresses)
    assert metadata["Keywords"]
    assert "Topic :: Scientific/Engineering" in metadata.get_all("Classifier", [])


@pytest.mark.parametrize("level", ["daemon", "plot", "dev"])
def test_every_pin_has_hashes_and_no_address(level: str) -> None:
    text = (ROOT / "requirements" / f"{level}.txt").read_text()
    pins = re.split(r"\n(?=[a-zA-Z])", text.strip())
    assert all("==" in pin and "--hash=sha256:" in pin for pin in pins)
    assert "://" not in text  # aiohttp is a name


def test_the_levels_pin_the_same_versions_and_the_build() -> None:
    def pins(level: str) -> dict[str, str]:
        text = (ROOT / "requirements" / f"{level}.txt").read_text()
        return dict(re.findall(r"^([\w.-]+)==(\S+)", text, re.MULTILINE))

    daemon, plot, dev = pins("daemon"), pins("plot"), pins("dev")
    assert daemon.items() < dev.items()
    assert plot.items() < dev.items()
    assert {"hatchling", "editables", "numpy", "pyzmq", "rich"} <= daemon.keys()
    assert not {"matplotlib", "mypy"} & daemon.keys()
    assert not {"mypy", "pytest"} & plot.keys()
