"""Hooks of MkDocs, which `mkdocs.yml` names."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from tools.figures import load_figures, with_figures
from tools.site.pages import ROOT, repository_files, with_four_column_lists, with_links_to_pages
from tools.site.reference import generated_pages


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of the repository with what they link to, and the generated pages."""
    for place, source in {**repository_files(), **generated_pages()}.items():
        if isinstance(source, Path):
            files.append(File.generated(config, place, abs_src_path=str(source)))
        else:
            files.append(File.generated(config, place, content=source))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Mark old figures; translate what hosts of git repositories and Python-Markdown read differently."""
    current = with_figures(markdown, load_figures())
    return with_four_column_lists(with_links_to_pages(current, ROOT / page.file.src_uri))
