"""What axe-core finds on a page against WCAG 2.2, levels A and AA, in both themes."""

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

_RULES = {"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"], "resultTypes": ["violations"]}
_THEME = "(theme) => { document.documentElement.dataset.theme = theme; }"


def violations(page: Page) -> list[str]:
    """Return a line for each element that breaks a rule; the page is left in the dark theme."""
    found = []
    for theme in ("light", "dark"):
        page.evaluate(_THEME, theme)
        for rule in Axe().run(page, options=_RULES).response["violations"]:
            found += [
                f"{theme}, {rule['id']}: {node['html']} {node['failureSummary']}" for node in rule["nodes"]
            ]
    return found
