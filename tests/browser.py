"""Real browser for tests, the one that films use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pytest
from playwright.sync_api import ConsoleMessage, Page

from drake_rho.display.viewer.browser import BrowserError, browser


def _note(message: ConsoleMessage, errors: list[str]) -> None:
    errors.append(f"{message.type}: {message.text}")


def _touch(width: int, height: int, scale: float) -> dict[str, Any]:
    size = {"width": width, "height": height}
    return {"viewport": size, "device_scale_factor": scale, "is_mobile": True, "has_touch": True}


TOUCH: dict[str, dict[str, Any]] = {
    "iPhone SE": _touch(320, 568, 2.0),
    "iPhone 13 landscape": _touch(750, 342, 3.0),
    "Pixel 7": _touch(412, 839, 2.625),
    "iPad Mini landscape": _touch(1024, 768, 2.0),
}
"""Options of pages on devices that Playwright knows by these names."""


@contextmanager
def open_page(**options: Any) -> Iterator[tuple[Page, list[str]]]:
    """Open a page, of 1280 x 800 by default; yield it and its console messages and errors.

    The test is skipped, with the reason, where no browser is installed.
    """
    with ExitStack() as stack:
        try:
            started = stack.enter_context(browser())
        except BrowserError as error:
            pytest.skip(str(error))
        context = started.new_context(**{"viewport": {"width": 1280, "height": 800}, **options})
        page = context.new_page()
        errors: list[str] = []
        page.on("console", lambda message: _note(message, errors))
        page.on("pageerror", lambda error: errors.append(str(error)))
        yield page, errors
