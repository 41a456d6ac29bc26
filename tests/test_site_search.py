"""The site's search, in a browser: words of the field lead to the right page."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from playwright.sync_api import Page, expect

from tests.browser import open_page
from tests.test_site import BUILDS, ROOT

WORDS = {
    "MPC": "guides/mpc",
    "robust MPC": "glossary|flight|guides/wind",
    "collision avoidance": "glossary|guides/shapes|guides/fleet",
    "formation": "guides/fleet",
    "geofence": "guides/mission|guides/requirements",
    "take-off": "guides/mission",
    "landing": "guides/mission",
    "swarm": "guides/fleet|fleets|glossary",
    "separation minima": "glossary|guides/fleet|fleets",
    "waypoint": "guides/mission",
    "no-fly zone": "guides/shapes",
    "trajectory optimisation": "glossary|quick_start",
    "SCP": "glossary|design",
    "wind": "guides/wind",
    "gust": "guides/wind",
    "ROS 2": "guides/recipes|guides/mpc",
    "Crazyflie": "guides/recipes|guides/export|export",
    "PX4": "guides/recipes|guides/export|export",
    "QP solver": "guides/fast|glossary",
    "warm start": "guides/fast|guides/mpc|glossary",
}
"""For each query the page, or the pages, of which one has to be among the first three results."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site without notebooks, which take minutes to run."""
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip(BUILDS)
    folder = tmp_path_factory.mktemp("site")
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    config["plugins"] = [each for each in config["plugins"] if "mkdocs-jupyter" not in each]
    (python,) = (each["mkdocstrings"] for each in config["plugins"] if "mkdocstrings" in each)
    python["handlers"]["python"]["paths"] = [str(ROOT)]
    config["docs_dir"], config["hooks"] = str(ROOT / "docs"), [str(ROOT / "tools/site/hooks.py")]
    config["nav"] = list(_without_notebooks(config["nav"]))
    (folder / "mkdocs.yml").write_text(yaml.safe_dump(config))
    words = ["-m", "mkdocs", "build", "--quiet", "-f", str(folder / "mkdocs.yml")]
    subprocess.run([sys.executable, *words], cwd=ROOT, check=True, capture_output=True)
    return folder / "site"


def _without_notebooks(entries: list[Any]) -> Iterator[Any]:
    for entry in entries:
        ((name, place),) = entry.items()
        if isinstance(place, list):
            yield {name: list(_without_notebooks(place))}
        elif not place.endswith(".ipynb"):
            yield entry


def _found(page: Page, words: str) -> list[str]:
    """Type words into the search and return the first three pages it finds."""
    box = page.locator("input[data-md-component=search-query]")
    box.fill("")
    box.press("Backspace")
    expect(page.locator(".md-search-result__item")).to_have_count(0)
    box.press_sequentially(words)
    results = page.locator(".md-search-result__item")
    expect(results.first).to_be_visible()
    page.wait_for_timeout(500)  # results come while one types
    links = results.evaluate_all("each => each.map((one) => one.querySelector('a').href)")
    return [link.split("/site/")[1].partition(".html")[0] for link in links][:3]


@pytest.mark.slow
def test_twenty_words_of_the_field_lead_to_the_right_page(site: Path) -> None:
    assert len(WORDS) == 20
    with open_page() as (page, _):
        page.goto((site / "index.html").as_uri())
        page.locator("input[data-md-component=search-query]").click()
        wrong = {}
        for words, places in WORDS.items():
            found = _found(page, words)
            if not set(places.split("|")) & set(found):
                wrong[words] = found
        assert wrong == {}


@pytest.mark.slow
def test_words_that_begin_with_any_digit_are_searched(site: Path) -> None:
    with open_page() as (page, messages):
        page.goto((site / "index.html").as_uri())
        page.locator("input[data-md-component=search-query]").click()
        for digit in "0123456789":
            assert _found(page, digit), digit
        assert not any("Invalid query" in message for message in messages)
