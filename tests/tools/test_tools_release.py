"""`./run release` on a repository of two small distributions: what it builds, refuses, tags and keeps."""

import subprocess
from pathlib import Path

import pytest

from tools import release

PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "{name}"
version = "{version}"
description = "Small"
requires-python = ">=3.11"
readme = {{ text = "Small.", content-type = "text/markdown" }}
dependencies = {needs}
[tool.hatch.build.targets.wheel]
packages = ["tactiled"]
"""
ADDRESS = '[tool.hatch.metadata.hooks.custom]\naddress = "https://example.org/robots/tactiled"\n'
HOOK = """
from hatchling.metadata.plugin.interface import MetadataHookInterface
class Hook(MetadataHookInterface):
    def update(self, metadata): pass
"""


def git(root: Path, *arguments: str) -> str:
    who = ["-c", "user.name=A", "-c", "user.email=a@example.org"]
    done = subprocess.run(["git", *who, *arguments], cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository that is ready for the release of 1.2.0."""
    for role in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{role}_NAME", "A")
        monkeypatch.setenv(f"GIT_{role}_EMAIL", "a@example.org")
    root = tmp_path / "repository"
    core = PROJECT.format(name="tactiled", version="1.2.0", needs='["tactiled-client==1.2.0"]') + ADDRESS
    client = PROJECT.format(name="tactiled-client", version="1.2.0", needs="[]")
    files = {
        ".gitignore": "dist/\n",
        "CHANGELOG.md": "# Changelog\n\n## Unreleased\n\n## 1.2.0\n\nSmall.\n",
        "CITATION.cff": "title: small\nversion: 1.2.0\n",
        "hatch_build.py": HOOK,
        "pyproject.toml": core,
        "tactiled/core.py": "",
        "packages/client/pyproject.toml": client,
        "packages/client/tactiled/version.py": '__version__ = "1.2.0"\n',
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    git(root, "init", "--quiet")
    commit(root)
    return root


def commit(root: Path) -> None:
    git(root, "add", "--all")
    git(root, "commit", "--quiet", "--message", "small")


def replace(path: Path, old: str, new: str) -> None:
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def test_a_release_tags_the_commit_leaves_the_files_and_names_two_commands(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert release.main([], root) == 0
    assert git(root, "rev-parse", "v1.2.0^{commit}") == git(root, "rev-parse", "HEAD")
    files = [
        "dist/tactiled_client-1.2.0-py3-none-any.whl",
        "dist/tactiled-1.2.0-py3-none-any.whl",
        "dist/tactiled_client-1.2.0.tar.gz",
        "dist/tactiled-1.2.0.tar.gz",
    ]
    assert sorted(f"dist/{path.name}" for path in (root / "dist").iterdir()) == sorted(files)
    *_, push, upload = capsys.readouterr().out.splitlines()
    assert push.strip() == "git push origin v1.2.0"
    assert upload.split() == [".venv/bin/twine", "upload", *files]
    assert release.main([], root) == 1  # a version is released once
    assert "the tag v1.2.0 exists already" in capsys.readouterr().err


def test_a_dry_run_says_what_is_missing_and_leaves_nothing(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replace(root / "CHANGELOG.md", "## 1.2.0\n", "- Something new.\n")
    replace(root / "pyproject.toml", "https://example.org/robots/tactiled", "")
    commit(root)
    (root / "new.py").touch()
    assert release.main(["--dry-run"], root) == 0
    said = capsys.readouterr()
    assert "would make the tag v1.2.0" in said.out
    for words in ("no section `## 1.2.0`", "under `## Unreleased`", "no `address`", "not committed"):
        assert words in said.err
    assert not (root / "dist").exists()
    assert release.main([], root) == 1
    assert not (root / "dist").exists()
    assert git(root, "tag") == ""


def test_versions_and_pins_that_disagree_are_refused(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    replace(root / "pyproject.toml", "client==1.2.0", "client==1.1.0")
    replace(root / "packages/client/pyproject.toml", "1.2.0", "1.3.0")
    replace(root / "CITATION.cff", "1.2.0", "1.1.0")
    commit(root)
    assert release.main(["--dry-run"], root) == 1
    said = capsys.readouterr().err
    assert "tactiled asks for tactiled-client==1.1.0, not ==1.2.0" in said
    assert "tactiled-client has version 1.3.0, and version.py says 1.2.0" in said
    assert "CITATION.cff does not say `version: 1.2.0`" in said


def test_an_sdist_that_does_not_build_the_whole_wheel_is_refused(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = root / "pyproject.toml"
    project.write_text(f'{project.read_text()}[tool.hatch.build.targets.sdist]\nexclude = ["/tactiled"]\n')
    commit(root)
    assert release.main(["--dry-run"], root) == 1
    assert "tactiled-1.2.0-py3-none-any.whl lacks tactiled/core.py" in capsys.readouterr().err
    project.write_text(
        f'{project.read_text()}[tool.hatch.build.targets.wheel.force-include]\n"none" = "none"\n'
    )
    commit(root)
    with pytest.raises(SystemExit, match=r"hatchling build.*-t wheel"):
        release.main(["--dry-run"], root)


def test_hooks_run_tools_of_the_checkout_and_download_nothing() -> None:
    text = (release.ROOT / ".pre-commit-config.yaml").read_text()
    assert "://" not in text
    assert text.count("repo: local") == text.count("- repo:") == 1
    assert text.count("language: system") == text.count("entry: .venv/bin/") == text.count("- id:")
