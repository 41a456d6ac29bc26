"""Memory use of the current process."""

from __future__ import annotations

import resource
from pathlib import Path


def peak_memory() -> float:
    """Return the peak memory of this process so far [MB]."""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # macOS counts in bytes
    # not `getrusage`, which on Linux starts from the parent process's peak
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024
