"""Faults of a page for those who use no mouse, or see it badly: axe-core's rules, in both themes."""

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

_UNREACHABLE = """() => [...document.querySelectorAll("body *")]
  .filter((e) => e.checkVisibility() && e.scrollHeight > e.clientHeight && e.tabIndex < 0)
  .filter((e) => /auto|scroll/.test(getComputedStyle(e).overflowY)).map((e) => e.outerHTML)"""
_THEME = "(theme) => { document.documentElement.dataset.theme = theme; }"


def faults(page: Page) -> list[str]:
    """Return what axe-core finds, and places that no key can scroll; the page is left in the dark theme."""
    found = [str(html) for html in page.evaluate(_UNREACHABLE)]
    for theme in ("light", "dark"):
        page.evaluate(_THEME, theme)
        for rule in Axe().run(page).response["violations"]:
            found += [
                f"{theme}, {rule['id']}: {one['html']} {one['failureSummary']}" for one in rule["nodes"]
            ]
    return found
