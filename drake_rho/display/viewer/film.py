"""Films of a viewer page, recorded frame by frame in a headless browser."""

from __future__ import annotations

import base64
import dataclasses
import io
import math
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
from drake_rho.scenario.times import Clock
from drake_rho.system.files import atomic_write

ENDINGS = (".mp4", ".gif")
"""File endings of films."""
_LONGEST = 20.0
"""Longest film if no rate is given [s]."""
_RATES = {".mp4": 30.0, ".gif": 12.5}
"""Frames per second; a GIF counts in hundredths of a second."""
SIZES = {".mp4": (1280, 720), ".gif": (840, 472)}
"""Default width and height of a film [px]."""
SIDES = (240, 4096)
"""Least and largest side of a film [px]; not every H.264 decoder takes a larger one."""
_PAGE = 720.0
"""Shorter side of the recorded page [CSS px], which is scaled to the film's size."""
_LEAST_SCALE = 0.6
"""Least scale of the page with legible text; smaller films show less of the page."""
_COMMON, _RARE = 96, 159
"""Numbers of colours of a GIF for large areas, such as the background, and for small details."""
_SAMPLES = 6
"""Number of frames for choosing the colours of a GIF."""
_ENCODER = (
    *("ffmpeg", "-loglevel", "error", "-y", "-f", "image2pipe", "-c:v", "mjpeg"),
    *("-framerate", f"{_RATES['.mp4']:g}", "-i", "-"),
    *("-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart"),
)
"""Command that encodes JPEG frames as a film that plays everywhere."""


class FilmError(DrakeRhoError):
    """A program for films is missing or fails; the message names it."""


def size_of(text: str) -> tuple[int, int]:
    """Return width and height [px] from a text such as '1920x1080'.

    Raises:
        ValueError: the text is not of this form, or a side is odd or outside `SIDES`.
    """
    sides = [int(each) for each in text.split("x") if each.isdecimal()]
    least, largest = SIDES
    if (
        text.count("x") != 1
        or len(sides) != 2
        or any(side % 2 or not least <= side <= largest for side in sides)
    ):
        expected = f"width and height in pixels as in 1920x1080, even, {least} to {largest}"
        raise ValueError(f"size: got {text!r}, expected {expected}")
    wide, high = sides
    return wide, high


def check_film(path: str | Path) -> None:
    """Check, before any work, that a film can be recorded.

    Raises:
        ValueError: the ending is not that of a film.
        FilmError: ffmpeg is missing.
        BrowserError: the browser is missing.
    """
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise ValueError(f"film: got {str(path)!r}, expected a file that ends in .mp4 or .gif")
    if ending == ".mp4" and shutil.which("ffmpeg") is None:
        raise FilmError(
            "an .mp4 needs ffmpeg, which is not installed: install it, or choose a .gif"
        )
    with browser():
        pass


@dataclasses.dataclass(frozen=True, eq=False)
class Footage:
    """Times of a film's frames and its rate."""

    times: FloatArray
    """times of the frames since the first knot [s], shape (M,)"""
    rate: float
    """seconds of flight per second of film"""

    @classmethod
    def of(cls, duration: float, ending: str, rate: float | None = None) -> Footage:
        """Return the frames of a whole flight, including its last instant.

        Args:
            duration: duration of the flight [s].
            ending: file ending of the film.
            rate: seconds of flight per second of film; if not given, 1 for flights of up to 20 s,
                and for longer ones the rate at which the film takes 20 s.
        """
        rate = max(1.0, duration / _LONGEST) if rate is None else rate
        step = rate / _RATES[ending]
        times = np.arange(0.0, duration, step)
        times = np.append(times[Clock.of(step).before(times, duration)], duration)
        return cls(times, rate)


def write_film(
    page: str,
    path: str | Path,
    footage: Footage,
    *,
    size: tuple[int, int] | None = None,
    before: str = "",
    progress: Callable[[], None] = lambda: None,
) -> None:
    """Write a film of a page made by `viewer_page`.

    Args:
        page: the page, HTML.
        path: file of the film, ending in .mp4 or .gif; written completely or not at all.
        footage: frames of the film.
        size: width and height [px], as of `SIZES` if not given; even numbers for an .mp4.
        before: JavaScript to run first, such as `drakeRho.theme(true)`.
        progress: called after every frame.

    Raises:
        ValueError: the ending is not that of a film.
        FilmError: ffmpeg is missing or fails.
        BrowserError: the browser is missing.
        OSError: the file cannot be written.
    """
    check_film(path)
    ending = Path(path).suffix.lower()
    with tempfile.TemporaryDirectory(prefix="drake_rho.") as folder:
        source, made = Path(folder) / "page.html", Path(folder) / f"film{ending}"
        source.write_text(page, "utf-8")
        with closing(_pictures(source, footage, ending, size, before, progress)) as pictures:
            (_write_mp4 if ending == ".mp4" else _write_gif)(pictures, made)
        with atomic_write(path) as file:
            file.write(made.read_bytes())


def _pictures(
    source: Path,
    footage: Footage,
    ending: str,
    size: tuple[int, int] | None,
    before: str,
    progress: Callable[[], None],
) -> Generator[bytes, None, None]:
    """Yield the frames of the page, as JPEG for an MP4 and as PNG for a GIF."""
    wide, high = size or SIZES[ending]
    scale = max(_LEAST_SCALE, min(wide, high) / _PAGE)
    clip = {"x": 0, "y": 0, "width": wide / scale, "height": high / scale, "scale": scale}
    kind = {"format": "jpeg", "quality": 95} if ending == ".mp4" else {"format": "png"}
    options = {**kind, "clip": clip, "optimizeForSpeed": True}
    with browser() as found:
        context = found.new_context(
            viewport={"width": math.ceil(wide / scale), "height": math.ceil(high / scale)},
            device_scale_factor=scale,
            offline=True,
        )
        page = context.new_page()
        page.goto(source.as_uri())
        page.wait_for_function("window.drakeRho")
        page.evaluate(f"() => {{ {before} }}")
        session = context.new_cdp_session(page)
        for time in footage.times.tolist():
            page.evaluate("([time, rate]) => drakeRho.frame(time, rate)", [time, footage.rate])
            page.evaluate("() => new Promise(requestAnimationFrame)")
            taken = session.send("Page.captureScreenshot", options)
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
        _, message = encoder.communicate()
    if encoder.returncode != 0:
        raise FilmError(f"ffmpeg failed: {message.decode(errors='replace').strip()}")


def _write_gif(pictures: Iterator[bytes], path: Path) -> None:
    """Write frames with one palette, so that unchanged areas take no space."""
    from PIL import Image  # slow to load

    frames = []
    for picture in pictures:
        frames.append(Image.open(io.BytesIO(picture)).convert("RGB"))
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
