"""XML files of others: parsed without declarations, bounded in size and depth."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from drake_rho.scenario.errors import Description, ScenarioError
from drake_rho.scenario.maps.source import named
from drake_rho.system.files import check_readable, read_bytes, reason_of

LARGEST = 64 << 20
"""Largest size of an XML file, and of any file that a world refers to [bytes]."""

_DEEPEST = 100
"""Largest nesting depth of elements; readers recurse once per level."""


def check_size(path: Path) -> None:
    """Check that a file can be read and is not too large.

    Raises:
        ScenarioError: it cannot be read, or is too large.
    """
    try:
        check_readable(path, LARGEST)
    except OSError as error:
        expected = f"a file of at most {LARGEST} bytes"
        raise ScenarioError(named(path), Description(reason_of(error)), expected) from None


def parsed(path: Path) -> Element:
    """Return the root of an XML file, without declarations of types or entities."""
    builder, parser = TreeBuilder(), expat.ParserCreate()

    def refuse(*_: object) -> None:
        expected = "XML without declarations of types and entities"
        raise ScenarioError(named(path), Description("a DOCTYPE or an ENTITY"), expected)

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    open_elements = list[str]()

    def start(tag: str, given: dict[str, str]) -> None:
        open_elements.append(tag)
        if len(open_elements) > _DEEPEST:
            depth = Description(f"more than {_DEEPEST} elements in each other")
            raise ScenarioError(named(path), depth, "fewer")
        builder.start(tag, given)

    def end(tag: str) -> None:
        open_elements.pop()
        builder.end(tag)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = lambda text: builder.data(text)
    try:
        content = read_bytes(path, LARGEST)
        content.decode("utf-8")
        parser.Parse(content, True)
    except ScenarioError:
        raise
    except (expat.ExpatError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise ScenarioError(
            named(path), Description("a damaged file"), f"XML in UTF-8; {reason}"
        ) from None
    return builder.close()
