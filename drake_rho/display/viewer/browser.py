"""Headless browser for films and tests: an installed one, driven by Playwright."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from drake_rho.scenario.errors import DrakeRhoError

if TYPE_CHECKING:
    from playwright.sync_api import Browser

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
# Works without a screen or a graphics card, without network requests, and as root.
ARGUMENTS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


class BrowserError(DrakeRhoError):
    """The browser or its driver is missing; the message says what to install."""


@contextmanager
def browser() -> Iterator[Browser]:
    """Open a headless browser, and close it at the end.

    Raises:
        BrowserError: Playwright or Chromium is missing, or does not start.
    """
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        raise BrowserError("Playwright is not installed: pip install 'drake-rho[film]'") from None
    installed = next(filter(None, map(shutil.which, NAMES)), None)
    driver = sync_playwright()
    try:
        playwright = driver.start()
    except Exception as error:  # the driver's errors have no specific type
        raise BrowserError(f"Playwright's driver does not start: {error}") from None
    try:
        path = installed or playwright.chromium.executable_path
        if not Path(path).exists():
            raise BrowserError(
                "no Chromium or Chrome is installed: install one, or run 'playwright install "
                "chromium'"
            )
        try:
            found = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        except Error as error:
            message = error.message.splitlines()[0]
            raise BrowserError(f"{path} does not start: {message}") from None
        yield found
        found.close()
    finally:
        playwright.stop()
