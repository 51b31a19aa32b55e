"""The view of hands in motion as one HTML file that needs nothing beside it: live, or a clip's report.

The view itself is written in TypeScript (`view/` of the repository) and bundled into `view/view.js` here; it reads
lines of hands.jsonl, from a WebSocket or from the file that it lies in.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html
import json
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import IO, Any, Final

import cv2
import numpy as np

from twohands.files import appearing, partial_path
from twohands.visualization.movie import Movie

REPORT: Final = "report.html"
MAX_FRAMES: Final = 3000
"""In a report; of longer clips every n-th frame is shown."""
MAX_FILM_BYTES: Final = 40_000_000
"""Of a film in a report; a longer one is left out."""
FILM_SIDE_PX: Final = 640
"""Longer side of a report's film."""
_CHUNK: Final = 3 << 18


@lru_cache(maxsize=1)
def view_script() -> str:
    """The bundled view."""
    return (resources.files("twohands.visualization") / "view" / "view.js").read_text(encoding="utf-8")


def view_policy(*, live: bool) -> str:
    """The Content-Security-Policy of a page: nothing but the view runs, and nothing is asked of anybody but, live, of
    the page's own server."""
    digest = base64.b64encode(hashlib.sha256(view_script().encode()).digest()).decode()
    rules = ["default-src 'none'", f"script-src 'sha256-{digest}'", "style-src 'unsafe-inline'", "img-src data: blob:"]
    rules += ["media-src blob:", "base-uri 'none'", "form-action 'none'"]
    return "; ".join([*rules, "connect-src 'self'"] if live else rules)


def live_page(config: dict[str, Any]) -> str:
    """The page of `twohands live`.

    Args:
        config: `LiveConfig` of view/src/live.ts.
    """
    data = f'<script id="live" type="application/json">{_inert(json.dumps(config))}</script>\n'
    return _head("twohands live", view_policy(live=True)) + data + _tail()


class ClipReport:
    """Writes report.html of a clip; a context manager, which writes it when it is left, from the lines that are there.

    While frames come a small film of their pictures is written beside it, which then moves into the report.

    Args:
        folder: where the report goes; exists.
        lines: hands.jsonl, whole when the report is left.
        name: of the clip.
        size: width and height of the pictures; None for a report without them.
        rate: frames a second, about.

    Raises:
        MissingExtraError: there are pictures, and PyAV is not installed.
    """

    def __init__(self, folder: Path, lines: Path, name: str, size: tuple[int, int] | None, rate: float) -> None:
        self._path, self._lines, self._name = folder / REPORT, lines, name
        self._film = partial_path(folder / "film.mp4")
        self._movie: Movie | None = None
        if size is not None:
            scale = min(1.0, FILM_SIDE_PX / max(size))
            self._size = max(2, round(size[0] * scale)), max(2, round(size[1] * scale))
            self._how = cv2.INTER_LINEAR if scale > 0.5 else cv2.INTER_AREA  # a quarter of the time, and as good there
            self._movie = Movie(self._film, *self._size, rate)

    def __enter__(self) -> ClipReport:
        if self._movie is not None:
            self._movie.__enter__()
        return self

    def write(self, image: np.ndarray, time_s: float) -> None:
        """One more picture, (H, W, 3) uint8 RGB, and its time after the first one's, seconds."""
        if self._movie is not None:
            self._movie.write(cv2.resize(image, self._size, interpolation=self._how), time_s)

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        try:
            if self._movie is not None:
                self._movie.__exit__(kind, *rest)
            with contextlib.suppress(OSError) if kind is not None else contextlib.nullcontext():
                self._write_page()
        finally:
            self._film.unlink(missing_ok=True)

    def _write_page(self) -> None:
        with (
            appearing(self._path) as partial,
            partial.open("w", encoding="utf-8", errors="backslashreplace") as page,
        ):
            page.write(_head(f"{self._name} - twohands", view_policy(live=False)))
            _write_lines(page, self._lines)
            if self._film.exists() and 0 < self._film.stat().st_size <= MAX_FILM_BYTES:
                _write_film(page, self._film)
            page.write(_tail())


def _write_lines(page: IO[str], path: Path) -> None:
    """The header and at most `MAX_FRAMES` of the frames, evenly taken; never all in memory."""
    with path.open(encoding="utf-8") as lines:
        step = max(1, -(-(sum(1 for _ in lines) - 1) // MAX_FRAMES))
    page.write('<script id="lines" type="application/x-ndjson">\n')
    with path.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines):
            if number == 0 or (number - 1) % step == 0:
                page.write(_inert(line))
    page.write("</script>\n")


def _write_film(page: IO[str], film: Path) -> None:
    page.write('<script id="film" type="text/plain">')
    with film.open("rb") as file:
        while chunk := file.read(_CHUNK):
            page.write(base64.b64encode(chunk).decode())
    page.write("</script>\n")


def _head(title: str, policy: str) -> str:
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{html.escape(policy)}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{html.escape(title)}</title>
<link rel="icon" href="data:,">
</head>
<body>
<noscript>This page needs JavaScript; it asks nobody for anything.</noscript>
"""


def _tail() -> str:
    return f"<script>{view_script()}</script>\n</body>\n</html>\n"


def _inert(text: str) -> str:
    """JSON that cannot end the element it stands in: < is found within its strings only."""
    return text.replace("<", "\\u003c")
