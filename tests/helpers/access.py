"""Faults of a page for those who use no mouse, or see it badly: axe-core's rules, in both themes."""

from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

_UNREACHABLE = """() => [...document.querySelectorAll("body *")]
  .filter((e) => e.checkVisibility() && e.scrollHeight > e.clientHeight && e.tabIndex < 0)
  .filter((e) => /auto|scroll/.test(getComputedStyle(e).overflowY)).map((e) => e.outerHTML)"""
# Another theme has other colours, and nothing else.
_RULES: dict[str, dict[str, Any]] = {"light": {}, "dark": {"runOnly": ["color-contrast"]}}
_THEME = "(theme) => { document.documentElement.dataset.theme = theme; }"


def faults(page: Page) -> list[str]:
    """Return what axe-core finds, and places that no key can scroll; the page is left in the dark theme."""
    found = [str(html) for html in page.evaluate(_UNREACHABLE)]
    for theme, rules in _RULES.items():
        page.evaluate(_THEME, theme)
        options = {"resultTypes": ["violations"], **rules}
        for rule in Axe().run(page, options=options).response["violations"]:
            found += [
                f"{theme}, {rule['id']}: {one['html']} {one['failureSummary']}" for one in rule["nodes"]
            ]
    return found
