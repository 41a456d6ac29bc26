"""Side-by-side benchmarks: this package, and the same work done by hand with other tools.

BLAS has one thread here, as this package holds it while it plans: in every process of a benchmark,
so for peers too. The variable has to be set before numpy is imported.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
