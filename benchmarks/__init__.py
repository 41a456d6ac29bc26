"""Side-by-side benchmarks: this package, and its work done by hand with other tools."""
