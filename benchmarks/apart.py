"""Running a peer's script in an environment of its own, which has the peer and not this package."""

from __future__ import annotations

import subprocess
from pathlib import Path

from benchmarks.race import Skipped

ROOT = Path(__file__).parents[1]


def run_apart(peer: str, script: str, *files: Path) -> None:
    """Run `benchmarks/peers/<script>` with files as arguments, in the environment of a peer.

    It runs in the folder of the first file, so that logs of the peer's land there.

    Raises:
        Skipped: there is no such environment, or the script fails.
    """
    python = ROOT / f".venv-{peer}" / "bin" / "python"
    if not python.exists():
        raise Skipped(f"no environment for {peer}; `make .venv-{peer}/.ready` sets it up")
    command = [str(python), str(ROOT / "benchmarks" / "peers" / script), *map(str, files)]
    done = subprocess.run(  # noqa: S603  # scripts of this folder
        command, capture_output=True, text=True, cwd=files[0].parent, check=False
    )
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        raise Skipped(f"{script} failed: {said[-1] if said else 'without a word'}")


def version(peer: str) -> str:
    """Version of a peer that is installed in its environment, or what is wrong with it."""
    python = ROOT / f".venv-{peer}" / "bin" / "python"
    code = f"import importlib.metadata as m; print(m.version({peer!r}))"
    try:
        done = subprocess.run(  # noqa: S603  # a fixed command
            [str(python), "-c", code], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "not installed"
    return done.stdout.strip()
