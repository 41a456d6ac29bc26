"""A user's script with every step from a scenario to files runs, and prints what it should."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.user_script import main


def test_a_users_script_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(tmp_path)
    said = capsys.readouterr().out
    assert "mine: all constraints hold" in said
    assert "(3, 3) [0.0, 0.38" in said
    assert "True 0.010" in said
    assert {path.name for path in tmp_path.iterdir()} == {"plan.npz", "paths.png", "page.html"}
