"""Seeing it: plots, the paper's figures, and tables for the terminal."""
