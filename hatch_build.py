"""Metadata of the distribution that depend on where the repository is: its page and addresses."""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

PAPER = "https://doi.org/10.3390/mi10090579"
_LINK = re.compile(r"(?P<picture>!?)\[(?P<words>[^\]]*)\]\((?P<path>(?!https?://|#)[^)]+)\)")


class RepositoryMetadata(MetadataHookInterface):
    """Set `readme` with links that work outside the repository, and `urls`.

    A package index shows README.md alone, so its relative links lead nowhere there. They become absolute once
    `address` in pyproject.toml names the repository; the file itself keeps relative links, which work in a
    checkout and wherever the repository is hosted.
    """

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill the dynamic fields."""
        address, tag = self.config["address"].rstrip("/"), f"v{metadata['version']}"
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["urls"] = {"Paper": PAPER}
        if address:
            metadata["urls"] |= {"Source": address, "Issues": f"{address}/issues"}
            text = with_absolute_links(text, address, tag)
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def with_absolute_links(text: str, address: str, tag: str) -> str:
    """Text whose links into the repository are absolute: pictures as raw files, pages as pages."""

    def absolute(link: re.Match[str]) -> str:
        kind = "raw" if link["picture"] else "blob"
        return f"{link['picture']}[{link['words']}]({address}/{kind}/{tag}/{link['path']})"

    return _LINK.sub(absolute, text)
