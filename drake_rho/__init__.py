"""Cooperative trajectories for several UAVs by convex optimisation with a receding horizon.

The method of Zhou et al., ASCC 2017, on Drake's `MathematicalProgram`. SI units throughout.
"""

from importlib import import_module

import lazy_loader

# `__init__.pyi` lists the public names. They are imported on first access, together with the
# modules they need: importing Drake and matplotlib takes a second, which loading a scenario or
# interrupting a command does not need.
_imported, _, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module("importlib.metadata").version("drake-rho")
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = _imported(name)
    import_module("drake_rho.scenario.described").ShownInNotebooks.shown_by(_html_of)
    return found


def _html_of(record: object) -> str:
    """Return the HTML by which a notebook shows a record."""
    found: str = import_module("drake_rho.display.notebook").html_of(record)
    return found


def __dir__() -> list[str]:
    special = (name for name in globals() if name.startswith("__"))
    return sorted({*__all__, "__version__", *special})
