"""Formatting of numbers."""

from __future__ import annotations

import math

_LEAST = 1e-6
"""Least ratio that is written in per cent; smaller ones are within the accuracy of plans."""


def percent(ratio: float) -> str:
    """Return the size of a deviation as text in per cent, such as '12 %', '0.35 %' or '310 %'.

    It has two digits, or all those before the decimal point, and no exponent. Values below 0.0001 %
    are rounded up to it.
    """
    if not math.isfinite(ratio):
        return f"{ratio} %"
    size = 100.0 * max(abs(ratio), _LEAST)
    decimals = max(0, 1 - math.floor(math.log10(size)))
    text = f"{size:.{decimals}f}"
    return f"{text.rstrip('0').rstrip('.') if decimals else text} %"
