"""Verbs of the distributions beside the core: found by entry points, listed without an import."""

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import pytest

from tactiled.cli import packages
from tactiled.cli.entry import cli

ROOT = Path(__file__).resolve().parent.parent
PROJECTS = {
    path.parent.name: tomllib.loads(path.read_text()) for path in ROOT.glob("packages/*/pyproject.toml")
}
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]

STRANGER = """
import click

@click.command()
def wave() -> None:
    print("waved")
"""


def run(*arguments: str, script: str = "", path: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """A call in a process of its own, after a script."""
    command = f"import sys; sys.argv[0] = 'tactiled'\n{script}\nfrom tactiled.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path.append({str(path)!r})\n{command}", *arguments],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_the_table_of_verbs_is_that_of_the_entry_points() -> None:
    offered = {
        entry: name
        for name, project in PROJECTS.items()
        for entry in project["project"].get("entry-points", {}).get(packages.GROUP, {})
    }
    verbs = {entry: verb.package for entry, verb in packages.VERBS.items()}
    assert verbs | packages.PARTS == offered


@pytest.mark.parametrize("entry", packages.VERBS)
def test_a_summary_is_the_first_line_of_the_help_of_the_verb(entry: str) -> None:
    verb = packages.DeferredCommand(entry.rpartition(".")[2], entry).load()
    assert verb.name == entry.rpartition(".")[2]
    assert " ".join((verb.help or "").partition("\n\n")[0].split()) == packages.VERBS[entry].summary


@pytest.mark.parametrize("package", sorted({verb.package for verb in packages.VERBS.values()}))
def test_the_extra_of_a_package_installs_it(package: str) -> None:
    version = PROJECTS[package]["project"]["version"]
    assert f"tactiled-{package}=={version}" in EXTRAS[package]


def test_help_imports_no_verb_of_another_distribution() -> None:
    script = (
        "import atexit, json\n"
        "atexit.register(lambda: print(json.dumps([m for m in sys.modules if m.startswith('tactiled.')])))"
    )
    done = run("--help", script=script)
    assert done.returncode == 0
    shown, _, loaded = done.stdout.rstrip().rpartition("\n")
    verbs = [entry for entry in packages.VERBS if "." not in entry]
    assert [verb for verb in verbs if f"\n  {verb} " not in shown] == []
    folders = {path.name for path in ROOT.glob("packages/*/tactiled/*") if "client" not in path.parts}
    assert {name.split(".")[1] for name in json.loads(loaded)} & folders == set()


@pytest.mark.parametrize("entry", packages.VERBS)
def test_a_verb_that_is_not_installed_says_what_to_install(entry: str) -> None:
    absent = "from tactiled.cli import packages; packages._installed = dict"
    package = packages.VERBS[entry].package
    done = run(*entry.split("."), script=absent)
    assert done.returncode == 2
    assert f"pip install 'tactiled[{package}]', or ./packages/{package} in a checkout" in done.stderr
    assert "Traceback" not in done.stderr
    group, _, verb = entry.rpartition(".")
    listed = run(*filter(None, [group]), "--help", script=absent)
    assert f"  {verb} " in listed.stdout
    assert f"Not installed: tactiled-{package}." in listed.stdout


def test_detect_of_many_files_says_what_to_install() -> None:
    absent = "from tactiled.cli import packages; packages._installed = dict"
    done = run("detect", "a.mcap", "b.mcap", "--to", "events.parquet", script=absent)
    assert done.returncode == 2
    assert "detect --to needs tactiled-archive" in done.stderr


def test_a_distribution_of_others_adds_a_verb(tmp_path: Path) -> None:
    (tmp_path / "stranger.py").write_text(STRANGER)
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{packages.GROUP}]\nwave = stranger:wave\n")
    assert run("wave", path=tmp_path).stdout == "waved\n"
    assert "wave" in (help_words := " ".join(run("--help", path=tmp_path).stdout.split()))
    assert "Verb of stranger." in help_words


def test_a_verb_that_nobody_has_is_a_mistake_in_the_call() -> None:
    assert cli.get_command(click.Context(cli), "frobnicate") is None
    assert run("frobnicate").returncode == 2


def test_a_subcommand_of_a_distribution_is_no_verb_by_its_entry_point() -> None:
    with click.Context(cli) as context:
        assert cli.get_command(context, "keys.fleet") is None
