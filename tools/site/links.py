"""Check of a built site: every link leads somewhere, and no page loads external files."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADED = {"img", "script", "iframe", "source", "video", "embed", "audio"}
"""Elements whose `src` is loaded when the page is opened; so is a `link`'s `href`."""


@dataclass
class _Links(HTMLParser):
    """Links of a page, files that it loads, and its link targets."""

    followed: list[str] = field(default_factory=list)
    loaded: list[str] = field(default_factory=list)
    places: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def has(self, place: str) -> bool:
        """Return whether a fragment leads somewhere in the page; an empty one leads to its top."""
        return not place or place in self.places

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record links, loaded files and identifiers of a tag."""
        given = {name: value for name, value in attrs if value}
        self.places |= {given[name] for name in ("id", "name") if name in given}
        if tag in _LOADED and "src" in given:
            self.loaded.append(given["src"])
        elif tag == "link" and "href" in given and given.get("rel") != "canonical":
            self.loaded.append(given["href"])
        elif tag == "a" and "href" in given:
            self.followed.append(given["href"])


def broken_links(site: Path) -> list[str]:
    """Return the faults of the pages under a folder, one line each; none if all is well.

    External links are not followed; a page that loads an external file is listed, as it would be
    incomplete without a network.
    """
    pages = {path.resolve(): _read(path) for path in sorted(site.rglob("*.html"))}
    wrong = []
    for path, page in pages.items():
        here = path.relative_to(site.resolve())
        wrong += [f"{here} loads {each}" for each in page.loaded if urlsplit(each).netloc]
        for link in [*page.followed, *page.loaded]:
            to = urlsplit(link)
            if to.scheme or to.netloc:
                continue
            target = (path.parent / unquote(to.path)).resolve() if to.path else path
            if not target.is_file():
                wrong.append(f"{here} links to {link}, which is not there")
            elif target in pages and not pages[target].has(unquote(to.fragment)):
                wrong.append(f"{here} links to {link}, where there is no such place")
    return wrong


def _read(path: Path) -> _Links:
    page = _Links()
    page.feed(path.read_text())
    return page


if __name__ == "__main__":
    found = broken_links(Path(sys.argv[1]))
    sys.stdout.writelines(f"{line}\n" for line in found)
    sys.exit(1 if found else 0)
