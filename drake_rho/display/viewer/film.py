"""Films of the page that shows a flight, frame by frame through a browser that nobody sees."""

from __future__ import annotations

import base64
import dataclasses
import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from drake_rho.display.viewer.browser import browser
from drake_rho.scenario.errors import DrakeRhoError
from drake_rho.scenario.fields import FloatArray
from drake_rho.scenario.parts import SAME_TIME
from drake_rho.system.files import atomic_write

ENDINGS = (".mp4", ".gif")
"""Of films."""
_LONGEST = 20.0
"""Longest film whose pace is not asked for [s]."""
_RATES = {".mp4": 30.0, ".gif": 12.5}
"""Frames a second; a GIF counts in hundredths of a second."""
_SIZES = {".mp4": (1280, 720), ".gif": (1120, 630)}
"""Width and height of the page [px]."""
_GIF_WIDTH = 840
"""Of the pictures in a GIF, to which the page is brought down [px]."""
_COMMON, _RARE = 96, 159
"""Colours of a GIF for what is large, as the background, and for all else, as names and lines."""
_SAMPLES = 6
"""Pictures of a film by which the colours are chosen."""
_ENCODER = (
    *("ffmpeg", "-loglevel", "error", "-y", "-f", "image2pipe", "-c:v", "mjpeg"),
    *("-framerate", f"{_RATES['.mp4']:g}", "-i", "-"),
    *("-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart"),
)
"""What makes a film that plays everywhere of JPEG pictures."""


class FilmError(DrakeRhoError):
    """No film can be made here; says what to install."""


def check_film(path: str | Path) -> None:
    """Find out before any work whether a film can be made.

    Raises:
        ValueError: the ending is none of a film.
        FilmError: ffmpeg is missing.
        BrowserError: the browser is.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise ValueError(f"film: got {str(path)!r}, expected a file that ends in .mp4 or .gif")
    if ending == ".mp4" and shutil.which("ffmpeg") is None:
        raise FilmError("no ffmpeg here, which a .mp4 needs: install it, or ask for a .gif")
    with browser():
        pass


@dataclasses.dataclass(frozen=True, eq=False)
class Footage:
    """What a film consists of."""

    times: FloatArray
    """of its frames, since the first knot [s], shape (M,)"""
    rate: float
    """seconds of flight in a second of film"""

    @classmethod
    def of(cls, duration: float, ending: str, rate: float | None = None) -> Footage:
        """All of a flight of `duration` [s], to its last instant.

        At `rate` seconds of flight in a second of a film with this ending; if not given, at 1, or
        at what makes a film of 20 s.
        """
        rate = max(1.0, duration / _LONGEST) if rate is None else rate
        step = rate / _RATES[ending]
        times = np.append(np.arange(0.0, duration - SAME_TIME * step, step), duration)
        return cls(times, rate)


def write_film(
    page: str,
    path: str | Path,
    footage: Footage,
    *,
    before: str = "",
    progress: Callable[[], None] = lambda: None,
) -> None:
    """Write a film of a page of `viewer_page`.

    Args:
        page: HTML.
        path: of the film, ending in .mp4 or .gif; written whole or not at all.
        footage: its frames.
        before: JavaScript that is run first, as `drakeRho.theme(true)`.
        progress: called after every frame.

    Raises:
        ValueError: the ending is none of a film.
        FilmError: ffmpeg is missing or fails.
        BrowserError: there is no browser.
        OSError: the file cannot be written.
    """
    check_film(path)
    ending = Path(path).suffix.lower()
    with tempfile.TemporaryDirectory(prefix="drake_rho.") as folder:
        source, made = Path(folder) / "page.html", Path(folder) / f"film{ending}"
        source.write_text(page, "utf-8")
        with closing(_pictures(source, footage, ending, before, progress)) as pictures:
            (_write_mp4 if ending == ".mp4" else _write_gif)(pictures, made)
        with atomic_write(path) as file:
            file.write(made.read_bytes())


def _pictures(
    source: Path,
    footage: Footage,
    ending: str,
    before: str,
    progress: Callable[[], None],
) -> Generator[bytes, None, None]:
    """Yield the page at several times, as JPEG for a film and as PNG for a GIF."""
    wide, high = _SIZES[ending]
    kind = {"format": "jpeg", "quality": 95} if ending == ".mp4" else {"format": "png"}
    with browser() as found:
        context = found.new_context(viewport={"width": wide, "height": high}, offline=True)
        page = context.new_page()
        page.goto(source.as_uri())
        page.wait_for_function("window.drakeRho")
        page.evaluate(f"() => {{ {before} }}")
        session = context.new_cdp_session(page)
        for time in footage.times.tolist():
            page.evaluate("([time, rate]) => drakeRho.frame(time, rate)", [time, footage.rate])
            page.evaluate("() => new Promise(requestAnimationFrame)")
            taken = session.send("Page.captureScreenshot", {**kind, "optimizeForSpeed": True})
            progress()
            yield base64.b64decode(taken["data"])


def _write_mp4(pictures: Iterator[bytes], path: Path) -> None:
    with subprocess.Popen(  # noqa: S603 - a fixed command
        [*_ENCODER, str(path)], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as encoder:
        assert encoder.stdin is not None  # noqa: S101 - piped above
        try:
            for picture in pictures:
                encoder.stdin.write(picture)
        except BrokenPipeError:
            pass  # the error is raised below
        _, said = encoder.communicate()
    if encoder.returncode != 0:
        raise FilmError(f"ffmpeg failed: {said.decode(errors='replace').strip()}")


def _write_gif(pictures: Iterator[bytes], path: Path) -> None:
    """Pictures with one palette: what does not change from one to the next costs nothing."""
    from PIL import Image  # slow to load

    frames = []
    for picture in pictures:
        image = Image.open(io.BytesIO(picture)).convert("RGB")
        size = (_GIF_WIDTH, round(image.height * _GIF_WIDTH / image.width))
        frames.append(image.resize(size, Image.Resampling.LANCZOS))
    some = frames[:: max(1, len(frames) // _SAMPLES)]
    samples = Image.fromarray(np.concatenate([np.asarray(each) for each in some]))
    common = samples.quantize(_COMMON, Image.Quantize.MEDIANCUT).getpalette() or []
    rare = samples.quantize(_RARE, Image.Quantize.FASTOCTREE).getpalette() or []
    palette = Image.new("P", (1, 1))
    palette.putpalette(common[: 3 * _COMMON] + rare[: 3 * _RARE])
    first, *rest = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
    milliseconds = round(1000.0 / _RATES[".gif"])
    first.save(
        path, save_all=True, append_images=rest, duration=milliseconds, loop=0, optimize=True
    )
