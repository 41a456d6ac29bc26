"""Implementations of the benchmarks with other tools, each used as by an experienced user."""
