"""Entry point of `python -m drake_rho`."""

from drake_rho.cli import main

main()
