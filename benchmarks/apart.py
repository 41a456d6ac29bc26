"""Peers in environments of their own, `.venv-<peer>`, with conflicting dependencies."""

from __future__ import annotations

import atexit
import functools
import json
import subprocess
from pathlib import Path

import numpy as np

from benchmarks.race import Skipped
from benchmarks.stopwatch import reported
from drake_rho import Scenario
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.files import scenario_to_json

ROOT = Path(__file__).parents[1]


def run_apart(peer: str, script: str, *files: Path) -> None:
    """Run `benchmarks/peers/<script>` with files as arguments, in the environment of a peer.

    It runs in the folder of the first file, so that the peer's logs land there.

    Raises:
        Skipped: the environment does not exist, or the script fails.
    """
    command = [_python(peer), str(ROOT / "benchmarks" / "peers" / script), *map(str, files)]
    done = subprocess.run(  # noqa: S603  # scripts of this folder
        command, capture_output=True, text=True, cwd=files[0].parent, check=False
    )
    if done.returncode != 0:
        said = done.stderr.strip().splitlines()
        raise Skipped(f"{script} failed: {said[-1] if said else 'without a message'}")


def accelerations_apart(peer: str, module: str, scenario: Scenario) -> FloatArray:
    """Return the plan of `python -m <module>` in a peer's environment: [m/s²], shape (N, K-1, 3).

    The module is started once and runs as long as this process: it reads scenarios, each a line of
    JSON, and answers each with a line, `{"accelerations": [...], "processor": ...}` or `{"error":
    "...", "processor": ...}`, with its processor time [s].

    Raises:
        Skipped: the environment does not exist, or the peer does not start.
        RuntimeError: the peer finds no plan.
    """
    serving = _serving(peer, module)
    if serving.stdin is None or serving.stdout is None:  # never: both are pipes
        raise Skipped(f"{peer}: no pipes")
    try:
        serving.stdin.write(f"{scenario_to_json(scenario)}\n")
        serving.stdin.flush()
        line = serving.stdout.readline()
    except BrokenPipeError:
        line = ""
    if not line:
        raise Skipped(
            f"{peer} does not start: run `.venv-{peer}/bin/python -m {module}` for the reason"
        )
    answer = json.loads(line)
    reported(answer["processor"])
    if "error" in answer:
        raise RuntimeError(answer["error"])
    return np.array(answer["accelerations"])


@functools.cache
def _serving(peer: str, module: str) -> subprocess.Popen[str]:
    """Start a module of this folder that keeps running in a peer's environment."""
    process = subprocess.Popen(  # noqa: S603  # a module of this folder
        [_python(peer), "-m", module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=ROOT,
    )
    atexit.register(process.kill)
    return process


def _python(peer: str) -> str:
    """Return the interpreter of a peer's environment."""
    python = ROOT / f".venv-{peer}" / "bin" / "python"
    if not python.exists():
        raise Skipped(f"no environment for {peer}; `make .venv-{peer}/.ready` sets it up")
    return str(python)


def version(peer: str) -> str:
    """Return the version of a peer installed in its environment, or what is wrong with it."""
    python = ROOT / f".venv-{peer}" / "bin" / "python"
    code = f"import importlib.metadata as m; print(m.version({peer!r}))"
    try:
        done = subprocess.run(  # noqa: S603  # a fixed command
            [str(python), "-c", code], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return "not installed"
    return done.stdout.strip()
