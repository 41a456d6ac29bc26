"""A real browser for tests: one that is installed, driven by Playwright."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import ConsoleMessage, Error, Page, sync_playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
# Without a screen or a graphics card, as root, and without asking anybody on the network.
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


def _note(message: ConsoleMessage, errors: list[str]) -> None:
    if message.type in {"error", "warning"}:
        errors.append(message.text)


@contextmanager
def open_page(**options: Any) -> Iterator[tuple[Page, list[str]]]:
    """A page of 1280 x 800 and the list of errors that appear on its console.

    Skips the test, with the reason, where no browser is installed.
    """
    installed = next(filter(None, map(shutil.which, NAMES)), None)
    with ExitStack() as stack:
        try:
            playwright = stack.enter_context(sync_playwright())
        except Exception as error:  # of no type of its own, where the driver does not start
            pytest.skip(f"Playwright's driver does not start: {error}")
        path = installed or playwright.chromium.executable_path
        if not Path(path).exists():
            pytest.skip("no Chromium or Chrome is installed, nor one of Playwright's own")
        try:
            browser = playwright.chromium.launch(executable_path=path, args=list(ARGUMENTS))
        except Error as error:
            pytest.skip(f"{path} does not start: {error.message.splitlines()[0]}")
        context = browser.new_context(viewport={"width": 1280, "height": 800}, **options)
        page = context.new_page()
        errors: list[str] = []
        page.on("console", lambda message: _note(message, errors))
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page, errors
        browser.close()
