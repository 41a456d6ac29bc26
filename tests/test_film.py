"""Films: every frame shows its time, and missing programs are reported before any work."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import drake_rho as rho
from drake_rho.display.viewer import browser, film
from drake_rho.display.viewer.browser import BrowserError
from drake_rho.display.viewer.film import FilmError, Footage, check_film, write_film
from tests.browser import open_page
from tests.scenarios import slow
from tests.test_animation import crossing
from tests.test_cli import run


def test_footage_covers_the_whole_flight_at_its_speed() -> None:
    short = Footage.of(10.0, ".mp4")
    assert (short.rate, len(short.times), short.times[-1]) == (1.0, 301, 10.0)
    np.testing.assert_allclose(np.diff(short.times), 1.0 / 30.0)
    long = Footage.of(49.0, ".gif")
    assert len(long.times) == pytest.approx(20.0 * 12.5 + 1, abs=1)
    assert (long.times[0], long.times[-1]) == (0.0, 49.0)
    assert len(Footage.of(49.0, ".gif", 24.5).times) == 26


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".gif", *slow(".mp4")])
def test_a_film_moves_from_the_first_to_the_last_instant(ending: str, tmp_path: Path) -> None:
    if ending == ".mp4" and shutil.which("ffmpeg") is None:
        pytest.skip("no ffmpeg is installed")
    with open_page():  # skips without a browser
        pass
    page, path, seen = rho.viewer_page(crossing(3)), tmp_path / f"film{ending}", []
    footage = Footage(np.array([0.0, 5.0, 10.0]), 1.0)
    write_film(page, path, footage, progress=lambda: seen.append(1))
    assert len(seen) == 3
    if ending == ".mp4":
        command = ["ffmpeg", "-i", str(path), str(tmp_path / "frame%d.png")]
        subprocess.run(command, check=True, capture_output=True)
        pictures = [Image.open(tmp_path / f"frame{i}.png").convert("RGB") for i in (1, 2, 3)]
        assert not (tmp_path / "frame4.png").exists()
    else:
        with Image.open(path) as found:
            assert getattr(found, "n_frames", 1) == 3
            pictures = []
            for i in range(3):
                found.seek(i)
                pictures.append(found.convert("RGB"))
    shown = [np.asarray(each, dtype=int) for each in pictures]
    for one, other in ((0, 1), (1, 2), (0, 2)):
        assert np.mean(np.abs(shown[one] - shown[other]).max(axis=2) > 40) > 1e-3


def test_missing_programs_are_reported_before_any_work(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=r"expected a file that ends in \.mp4 or \.gif"):
        check_film("film.avi")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(FilmError, match=r"needs ffmpeg.*install it"):
        check_film("film.mp4")
    monkeypatch.undo()
    monkeypatch.setattr(browser, "NAMES", ())
    monkeypatch.setenv("PLAYWRIGHT_BROWSERS_PATH", str(tmp_path))
    with pytest.raises(BrowserError, match=r"Chromium.*install"):
        check_film("film.gif")


def test_a_film_that_fails_leaves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    if shutil.which("ffmpeg") is None:
        pytest.skip("no ffmpeg is installed")
    with open_page():
        pass
    monkeypatch.setattr(film, "_ENCODER", ("ffmpeg", "-loglevel", "error", "-i", "/nowhere"))
    with pytest.raises(FilmError, match=r"ffmpeg failed: .*nowhere"):
        write_film(
            rho.viewer_page(crossing(3)), tmp_path / "film.mp4", Footage(np.array([0.0]), 1.0)
        )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_the_command_line_makes_a_film(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_page():
        pass
    kept, made = tmp_path / "plan.npz", tmp_path / "film.gif"
    rho.save(crossing(3), kept)
    words = ("show", str(kept), "--film", str(made), "--rate", "100")
    status, out, _ = run(capsys, monkeypatch, *words)
    assert (status, out) == (0, f"a film in {made}\n")
    with Image.open(made) as found:
        assert getattr(found, "n_frames", 1) == 3  # at 0, 8 and 10 s


SIZES = ((1280, 720), (640, 360), (720, 1280), (1920, 1080), (506, 318))


@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 24, 120])
def test_films_show_the_list_and_the_legend_at_any_size(count: int) -> None:
    """Nobody can scroll in a film: every part is inside the frame, and what is left out is told."""
    scenario = rho.random_transitions(
        count, np.random.default_rng(1), volume=rho.Box([-9, -9, 0], [9, 9, 3]), separation=None
    )
    source = rho.viewer_page(rho.plan(scenario), trails=False)
    with open_page() as (page, _):
        for wide, high in SIZES:
            scale = max(0.6, min(wide, high) / 720)
            frame = [math.ceil(wide / scale), math.ceil(high / scale)]
            page.set_viewport_size({"width": frame[0], "height": frame[1]})
            page.set_content(source)
            page.wait_for_function("window.drakeRho")
            page.evaluate("() => drakeRho.frame(4, 1)")
            boxes = page.evaluate(
                """() => [...document.querySelectorAll(".panel, .panel tr, .panel .legend div")]
                    .map((each) => each.getBoundingClientRect()).filter((box) => box.width > 0)
                    .map((box) => [box.left, box.top, box.right, box.bottom])"""
            )
            assert np.min(boxes) >= 0.0
            assert np.all(np.array(boxes)[:, 2:] <= frame)
            rows = page.locator(".panel tbody tr:visible").count()
            told = page.locator(".panel .more:visible").all_inner_texts()
            if rows < count:
                assert told == [f"{rows} of {count} vehicles, least clearance first"]
                assert rows >= 5
            else:
                assert told == []
                assert rows == count


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_a_film_has_the_size_asked_for(size: tuple[int, int], tmp_path: Path) -> None:
    with open_page():
        pass
    path, page = tmp_path / "film.gif", rho.viewer_page(crossing(3))
    write_film(page, path, Footage(np.array([0.0]), 1.0), size=size)
    with Image.open(path) as found:
        assert found.size == size


@pytest.mark.parametrize(
    "text", ["1280", "1280x", "axb", "1281x720", "100x100", "1280x720x3", "-2x4"]
)
def test_a_wrong_size_is_one_line(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    film = str(tmp_path / "film.gif")
    status, _, err = run(capsys, monkeypatch, "show", "paper", "--film", film, f"--size={text}")
    assert status == 2
    assert err.count("\n") == 1
    assert text in err
