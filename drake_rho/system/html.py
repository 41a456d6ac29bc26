"""HTML tables of records for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

_LEFT, _RIGHT = (
    f"text-align:{side};white-space:nowrap;padding:0.1em 0.6em" for side in ("left", "right")
)


def html_table(
    title: str,
    heads: Sequence[str],
    rows: Iterable[Sequence[str]],
    below: Iterable[str],
    *,
    left: int,
    above: Iterable[str] = (),
) -> str:
    """Return a table with a title above, lines of text below, and cells that do not wrap.

    Args:
        title: text above the table.
        heads: heads of the columns.
        rows: cells of each row.
        below: lines of text below the table.
        left: number of text columns, from the left; the others hold numbers.
        above: lines of text between the title and the table.
    """

    def line(tag: str, cells: Sequence[str]) -> str:
        styles = [_LEFT] * left + [_RIGHT] * (len(cells) - left)
        made = zip(cells, styles, strict=True)
        return "".join(f'<{tag} style="{style}">{escape(cell)}</{tag}>' for cell, style in made)

    body = "".join(f"<tr>{line('td', cells)}</tr>" for cells in rows)
    first, rest = (
        "".join(f"<div>{escape(words)}</div>" for words in lines) for lines in (above, below)
    )
    head = f"<thead><tr>{line('th', heads)}</tr></thead>" if body else ""
    table = f"<table>{head}<tbody>{body}</tbody></table>" if body else ""
    return f"<div><b>{escape(title)}</b></div>{first}{table}{rest}"
