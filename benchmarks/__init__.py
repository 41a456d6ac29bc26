"""Side-by-side benchmarks: this package, and the same work done by hand with other tools."""
