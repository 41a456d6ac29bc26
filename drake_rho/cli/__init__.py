"""The command line: `drake-rho COMMAND`.

Commands: reproduce, plan, fly, simulate, verify, show, export, schema, campaign,
results.

Exit status: 0 all constraints hold; 1 some do not; 2 bad input; 3 there is no plan; 4 the solvers
failed numerically; 130 interrupted; 141 the reader of the output has gone.
"""

from drake_rho.cli.commands import main

__all__ = ["main"]
