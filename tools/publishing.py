"""Addresses of the published project, from one constant of pyproject.toml: `[tool.drake_rho]`.

They are set before publishing, `site` only if the documentation is served. Until then the
package's description has no links into the repository, which would be broken on an index page, and
the documentation has no address of its own.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

ROOT = Path(__file__).parents[1]

_LINK = re.compile(r"(?<!!)\[([^\]]*)\]\((?!https?:)([^)\s]+)\)")
_IMAGE = re.compile(r'<img src="(?!https?:)([^"]+)"[^>]*>')


def addresses() -> dict[str, str]:
    """Return the addresses that are set: of `repository` and of `site`."""
    tools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
    return {name: each.rstrip("/") for name, each in tools["drake_rho"].items() if each}


def description(repository: str | None) -> str:
    """Return the README for an index page: links lead into the repository, or become text.

    Args:
        repository: address of the repository; None if it is not published.
    """
    text = (ROOT / "README.md").read_text()
    if repository is None:
        return _LINK.sub(r"\1", _IMAGE.sub("", text))
    raw = rf'<img src="{repository}/raw/main/\1"'
    text = re.sub(r'<img src="(?!https?:)([^"]+)"', raw, text)
    return _LINK.sub(rf"[\1]({repository}/blob/main/\2)", text)


class CustomMetadataHook(MetadataHookInterface):
    """Hook of hatchling that adds the description and the project's addresses."""

    def update(self, metadata: dict[str, object]) -> None:
        """Add `readme` and `urls` to the project's metadata."""
        known = addresses()
        text = description(known.get("repository"))
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
        urls = {"Documentation": known.get("site"), "Repository": known.get("repository")}
        if "repository" in known:
            urls["Issues"] = f"{known['repository']}/issues"
            urls["Changelog"] = f"{known['repository']}/blob/main/CHANGELOG.md"
        metadata["urls"] = {name: each for name, each in urls.items() if each}
