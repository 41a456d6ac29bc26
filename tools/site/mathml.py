"""Formulas as MathML, which browsers show without a script."""

from __future__ import annotations

import re

from latex2mathml.converter import convert

_CODE_OR_FORMULA = re.compile(
    r"""
    ^[ >]*(?P<fence>`{3,}|~{3,})[^\n]*\n.*?(?:^[ >]*(?P=fence)[`~]*[ ]*$|\Z)
    | (?<!`)(?P<ticks>`+)(?!`)(?:(?!\n[ ]*\n).)+?(?<!`)(?P=ticks)(?!`)
    | (?P<dollar>\\\$)
    | \$\$(?P<displayed>.+?)\$\$
    | \$(?![\s$])(?P<inline>(?:(?!\n[ ]*\n)(?:[^$\\]|\\.))+?)(?<!\s)\$(?!\d)(?P<after>[.,;:)]*)
    """,
    flags=re.DOTALL | re.MULTILINE | re.VERBOSE,
)

_BAR = re.compile("<mo>(&#x0007C;|&#x02016;)</mo>")
_SIGN = re.compile(  # a minus behind an operator that closes nothing
    r"(<mo(?! form=.postfix)[^>]*>(?!&#x00029;|&#x0005D;)[^<)\]]+</mo>)<mo>&#x02212;</mo>"
)
_SLASH = "<mo>&#x0002F;</mo>"


def with_mathml(text: str) -> str:
    r"""Return Markdown with MathML in place of its LaTeX formulas, `$...$` and `$$...$$`.

    Code, fenced or in a line, stays as it is. A dollar in text is written `\$`. As on GitHub,
    spaces inside an inline formula's dollars, or a digit after it, mean that it is none.
    """

    def replaced(found: re.Match[str]) -> str:
        if found["dollar"]:
            return "&#36;"
        if found["displayed"]:
            return _mathml(found["displayed"], "block")
        if found["inline"]:
            inline = _mathml(found["inline"], "inline")
            begins = not text[text.rfind("\n", 0, found.start()) + 1 : found.start()].strip()
            if begins or found["after"]:
                # at the beginning of a line Markdown takes <math> for a block, and without the
                # style browsers put what follows it on the next line
                return f'<span style="white-space: nowrap">{inline}{found["after"]}</span>'
            return inline
        return found.group()

    return _CODE_OR_FORMULA.sub(replaced, text)


def _mathml(latex: str, display: str) -> str:
    # `aligned` is known only by the name of its stand-alone environment
    known = latex.replace("{aligned}", "{align*}").replace(r"\tfrac", r"\frac")
    mathml: str = convert(known, display=display)
    sides = iter(re.findall(r"\\([lr])[vV]ert\b", known))
    forms = {"l": "prefix", "r": "postfix", "": "infix"}

    def bar(found: re.Match[str]) -> str:  # without a form browsers put spaces around it
        return f'<mo form="{forms[next(sides, "")]}" stretchy="false">{found[1]}</mo>'

    mathml = _BAR.sub(bar, mathml)
    mathml = _SIGN.sub(r'\1<mo form="prefix">&#x02212;</mo>', mathml)
    mathml = mathml.replace(_SLASH, _SLASH.replace("mo>", 'mo lspace="0" rspace="0">', 1))
    return re.sub(
        r'columnalign="(left|right)"', r'style="text-align: \1"', mathml
    )  # as browsers do
