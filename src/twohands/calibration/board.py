"""The printed board: 7x9 squares with markers (ChArUco), drawn to scale on A4, and found again in pictures.

Its corners are told apart by the markers beside them, so that a part of the board is enough. Printers scale; the rule
beside the board, 10 cm, tells by how much.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

COLUMNS: Final = 7
ROWS: Final = 9
SQUARE_M: Final = 0.025
MARKER_M: Final = 0.018
N_CORNERS: Final = (COLUMNS - 1) * (ROWS - 1)
"""Inner corners, row by row."""
PAPER_M: Final = (0.210, 0.297)
"""A4, upright: width and height."""
CORNER_M: Final = (0.0175, 0.015)
"""From the paper's upper left corner to the board's."""
RULE_M: Final = 0.10

_DICTIONARY: Final = cv2.aruco.DICT_4X4_50
_CELLS: Final = 6
"""Of a marker, in a row, its black border included."""
_POINTS_PER_METRE: Final = 72 / 0.0254
_LEAST_MARKERS: Final = 2


@dataclass(frozen=True, slots=True)
class BoardView:
    """A board in a picture.

    Attributes:
        ids: (N,) which of the inner corners, increasing.
        corners_px: (N, 2) pixels, (0, 0) the outer corner of the first pixel.
        size: (width, height) of the picture.
    """

    ids: np.ndarray
    corners_px: np.ndarray
    size: tuple[int, int]

    @property
    def corners_m(self) -> np.ndarray:
        """(N, 3) where these corners are on the board."""
        return corners_m()[self.ids]


def corners_m() -> np.ndarray:
    """(N_CORNERS, 3) inner corners on the board: x along its rows from its upper left corner, y down, z 0, metres."""
    return np.asarray(_board().getChessboardCorners(), np.float64)


def printed_areas() -> tuple[np.ndarray, np.ndarray]:
    """What is printed of the board: rectangles (N, 4) x0, y0, x1, y1 in metres from its upper left corner, first black
    ones, then white ones on top of them."""
    squares = [(column, row) for row in range(ROWS) for column in range(COLUMNS) if (row + column) % 2 == 0]
    black = [(SQUARE_M * x, SQUARE_M * y, SQUARE_M * (x + 1), SQUARE_M * (y + 1)) for x, y in squares]
    white, cell = [], MARKER_M / _CELLS
    board = _board()
    for number, outline in zip(np.ravel(board.getIds()), board.getObjPoints(), strict=True):
        x0, y0 = np.asarray(outline, np.float64).min(axis=0)[:2]
        black.append((x0, y0, x0 + MARKER_M, y0 + MARKER_M))
        cells = cv2.aruco.generateImageMarker(board.getDictionary(), int(number), _CELLS)
        white += [
            (x0 + cell * x, y0 + cell * y, x0 + cell * (x + 1), y0 + cell * (y + 1)) for y, x in np.argwhere(cells > 0)
        ]
    return np.array(black), np.array(white)


def board_pdf() -> bytes:
    """The board and the rule on one page of A4, a PDF file."""
    black, white = printed_areas()
    below = CORNER_M[1] + ROWS * SQUARE_M
    left, rule_y = (PAPER_M[0] - RULE_M) / 2, below + 0.016
    ticks = [(left + 0.001 * i, rule_y, 0.006 if i % 10 == 0 else 0.0045 if i % 5 == 0 else 0.003) for i in range(101)]
    lines = [
        "0 g",
        _rectangles(black + np.tile(CORNER_M, 2)),
        "1 g",
        _rectangles(white + np.tile(CORNER_M, 2)),
        "0 G 0.4 w",
        _line(left, rule_y, left + RULE_M, rule_y),
        *(_line(x, y, x, y - length) for x, y, length in ticks),
        "0 g",
        _text(left, rule_y + 0.005, 9, "10 cm: measure this rule; print at 100 %, without fitting to the page"),
        _text(left, rule_y + 0.010, 9, "twohands calibrate camera CLIP    keep the paper flat, on a board or a table"),
        _text(left, rule_y + 0.015, 9, f"{COLUMNS} x {ROWS} squares of {1000 * SQUARE_M:g} mm"),
    ]
    return _pdf("\n".join(lines).encode())


def find_board(image: np.ndarray) -> BoardView | None:
    """The board in a picture; None where less than two of its markers, or no corner between them, can be made out.

    Args:
        image: (H, W, 3) uint8 RGB.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector: Any = cv2.aruco.CharucoDetector(_board(), cv2.aruco.CharucoParameters(), parameters)
    corners, ids, _, markers = detector.detectBoard(grey)
    if ids is None or markers is None or len(markers) < _LEAST_MARKERS or len(ids) < 4:
        return None
    order = np.argsort(np.ravel(ids))
    found = np.asarray(corners, np.float64).reshape(-1, 2)[order]
    known = np.ravel(ids)[order].astype(int)
    return BoardView(known, found + 0.5, (image.shape[1], image.shape[0]))


@functools.cache
def _board() -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(_DICTIONARY)
    return cv2.aruco.CharucoBoard((COLUMNS, ROWS), SQUARE_M, MARKER_M, dictionary)


def _points(x: float, y: float) -> str:
    """Metres from the paper's upper left corner as a PDF counts: 1/72 inch from the lower left."""
    return f"{x * _POINTS_PER_METRE:.4f} {(PAPER_M[1] - y) * _POINTS_PER_METRE:.4f}"


def _rectangles(areas: np.ndarray) -> str:
    """All in one path, so that no hairlines show between neighbours."""
    sides = (areas[:, 2:] - areas[:, :2]) * _POINTS_PER_METRE
    paths = [
        f"{_points(x, y)} {width:.4f} {height:.4f} re"
        for (x, _, _, y), (width, height) in zip(areas, sides, strict=True)
    ]
    return "\n".join([*paths, "f"])


def _line(x0: float, y0: float, x1: float, y1: float) -> str:
    return f"{_points(x0, y0)} m {_points(x1, y1)} l S"


def _text(x: float, y: float, size: float, words: str) -> str:
    return f"BT /F1 {size:g} Tf {_points(x, y)} Td ({words}) Tj ET"


def _pdf(content: bytes) -> bytes:
    """A file of one page."""
    width, height = (side * _POINTS_PER_METRE for side in PAPER_M)
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n" % len(content) + content + b"\nendstream",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    out, starts = bytearray(b"%PDF-1.4\n"), []
    for number, body in enumerate(objects, 1):
        starts.append(len(out))
        out += b"%d 0 obj\n" % number + body + b"\nendobj\n"
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % start for start in starts)
    out += b"trailer << /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, table)
    return bytes(out)
