"""Build and check what a release uploads: ``./run release [--dry-run]``.

Everything is built from the last commit, in a temporary folder: first the sdist of each distribution, then a
wheel from each sdist. With ``--dry-run`` nothing remains but what is printed. Without it
the files stay in dist/ and the commit gets a tag, both on this machine only. Nothing is pushed or uploaded.

A wheel with compiled modules is left out of the upload: indexes refuse the platform `linux_x86_64`. pip takes
the sdist there, which compiles where a C compiler is installed and is plain Python elsewhere. twine sends
wheels before sdists: until the sdist of tactiled has arrived, its dependents cannot be installed.
"""

import argparse
import email
import email.message
import re
import shlex
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def run(command: list[str], folder: Path) -> str:
    """Return what a command prints in a folder; raise SystemExit with its output where it fails."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"release: {shlex.join(command)} failed\n{done.stdout}{done.stderr}")
    return done.stdout


def projects(tree: Path) -> list[Path]:
    """Folders of the distributions of a tree."""
    return [tree, *sorted(path.parent for path in tree.glob("packages/*/pyproject.toml"))]


def build(tree: Path, folder: Path) -> None:
    """Build an sdist of each distribution of a tree, and a wheel from each sdist, without the network."""
    hatchling = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    for project in projects(tree):
        run([*hatchling, "-t", "sdist"], project)
    # What `pip wheel --no-build-isolation` does with an sdist, in a third of the time.
    for sdist in sorted(folder.glob("*.tar.gz")):
        with tempfile.TemporaryDirectory() as unpacked, tarfile.open(sdist) as archive:
            archive.extractall(unpacked, filter="data")
            run([*hatchling, "-t", "wheel"], Path(unpacked, sdist.name.removesuffix(".tar.gz")))


def metadata_of(wheel: Path) -> email.message.Message:
    """Metadata of a wheel."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return email.message_from_string(archive.read(name).decode())


def siblings(wheel: Path) -> list[tuple[str, str]]:
    """Distributions of this repository that a wheel asks for, also for extras, each as name and condition."""
    asked = metadata_of(wheel).get_all("Requires-Dist", [])
    found = (re.match(r"(tactiled[\w-]*)(?:\[.*?\])?(.*)", line) for line in asked)
    return [(one[1], one[2].strip()) for one in found if one]


def version_of(tree: Path) -> str:
    """Version of all distributions of a tree."""
    text = (tree / "packages" / "client" / "tactiled" / "version.py").read_text()
    return str(re.findall(r'^__version__ = "(.+)"$', text, re.MULTILINE)[0])


def contradictions(tree: Path, folder: Path) -> list[str]:
    """Describe where built files disagree with each other or with the tree that they were built from."""
    version, found = version_of(tree), []
    wheels = {path.name.split("-")[0].replace("_", "-"): path for path in folder.glob("*.whl")}
    for project in projects(tree):
        name = tomllib.loads((project / "pyproject.toml").read_text())["project"]["name"]
        wheel = wheels[name]
        if (own := metadata_of(wheel)["Version"]) != version:
            found.append(f"{name} has version {own}, and version.py says {version}")
        for other, rest in siblings(wheel):
            if rest.partition(";")[0].strip() != f"=={version}":
                found.append(f"{name} asks for {other}{rest}, not =={version}")
        with zipfile.ZipFile(wheel) as archive:
            shipped = set(archive.namelist())
        sources = (path for path in (project / "tactiled").rglob("*") if path.is_file())
        names = {str(path.relative_to(project)) for path in sources}
        found += [f"{wheel.name} lacks {one}" for one in sorted(names - shipped)]
    if f"\nversion: {version}\n" not in (tree / "CITATION.cff").read_text():
        found.append(f"CITATION.cff does not say `version: {version}`")
    return found


def obstacles(root: Path, tree: Path) -> list[str]:
    """List what a person must still do before a release."""
    version, found = version_of(tree), []
    sections = re.split(r"^## ", (tree / "CHANGELOG.md").read_text(), flags=re.MULTILINE)[1:]
    headings = [one.partition("\n")[0] for one in sections]
    if not any(heading.split()[0] == version for heading in headings):
        found.append(f"CHANGELOG.md has no section `## {version}`")
    if any(one.partition("\n")[2].strip() for one in sections if one.startswith("Unreleased\n")):
        found.append("CHANGELOG.md has entries under `## Unreleased`; give that section the new version")
    tool = tomllib.loads((tree / "pyproject.toml").read_text())["tool"]["hatch"]
    if not tool["metadata"]["hooks"]["custom"]["address"]:
        found.append("pyproject.toml has no `address`: links of README.md would lead nowhere on an index")
    if run(["git", "status", "--porcelain"], root):
        found.append("the tree has changes that are not committed, which the release would leave out")
    if run(["git", "tag", "--list", f"v{version}"], root):
        found.append(f"the tag v{version} exists already")
    return found


def upload_order(folder: Path) -> list[Path]:
    """Files for an index as twine sends them: wheels, then sdists, both in the order of dependencies."""
    wheels = {path.name.split("-")[0].replace("_", "-"): path for path in sorted(folder.glob("*.whl"))}
    needs = {name: [one for one, rest in siblings(path) if ";" not in rest] for name, path in wheels.items()}
    order = [wheels[name] for name in TopologicalSorter(needs).static_order()]
    sdists = [next(folder.glob("-".join(path.name.split("-")[:2]) + ".tar.gz")) for path in order]
    return [path for path in order if not re.search(r"-linux_\w+\.whl$", path.name)] + sdists


def main(arguments: list[str] | None = None, root: Path = ROOT) -> int:
    """Run the command; 1 where built files contradict each other or, but for a dry run, at obstacles."""
    parser = argparse.ArgumentParser(prog="./run release", description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--dry-run", action="store_true", help="build and check; make no tag, keep no file")
    dry = parser.parse_args(arguments).dry_run
    with tempfile.TemporaryDirectory() as temporary:
        tree, built = Path(temporary, "tree"), Path(temporary, "built")
        built.mkdir()
        run(["git", "clone", "--quiet", "--depth=1", root.as_uri(), str(tree)], root)
        left = obstacles(root, tree)
        for one in left:
            print(f"release: before a release: {one}", file=sys.stderr)
        if left and not dry:
            return 1
        build(tree, built)
        run([sys.executable, "-m", "twine", "check", *map(str, sorted(built.iterdir()))], built)
        wrong = contradictions(tree, built)
        for one in wrong:
            print(f"release: {one}", file=sys.stderr)
        if wrong:
            return 1
        tag, files = f"v{version_of(tree)}", upload_order(built)
        kept = [path for path in sorted(built.iterdir()) if path not in files]
        if not dry:
            (root / "dist").mkdir(exist_ok=True)
            for path in [*files, *kept]:
                (root / "dist" / path.name).write_bytes(path.read_bytes())
            run(["git", "tag", "--annotate", tag, "--message", f"tactiled {tag[1:]}"], root)
    names = [f"dist/{path.name}" for path in files]
    print(f"{'would make' if dry else 'made'} the tag {tag}")
    print(f"{'would upload' if dry else 'to upload'}, in this order:", *names, sep="\n  ")
    if kept:
        print("not for an index:", *(f"dist/{path.name}" for path in kept), sep="\n  ")
    if not dry:
        print(f"Now run:\n  git push origin {tag}\n  .venv/bin/twine upload {' '.join(names)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
