"""The three views of the paper: what the camera sees, from above, from the side; centimetres, one scale.

Needs matplotlib (extra `view`). Source: paper, figures of qualitative results.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import cv2
import numpy as np

from twohands.errors import MissingExtraError
from twohands.skeleton import N_JOINTS, ROOT, SIDES
from twohands.types import HandPose, HandSample, PinholeCamera, TwoHandPose
from twohands.visualization.palette import HAND_COLOURS, finger_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_TEXT = "#2f333a"
_QUIET = "#7d838e"
_GRID = "#e3e6ea"
_LABELS = "#5c6270"
_FIELD = "#f5f6f8"
_DARKER = 0.82
"""The palette is made for photographs; on white paper the same hues are drawn darker."""
_PANEL_IN = 3.5
"""Height of every panel in inches; top and side view are squares of this side."""
_MIN_REACH_CM = 40.0
MOST_PIXELS_SHOWN = 2000
"""Along the longer side of the picture in the figure, which is about 700 dots high."""


def draw_views(
    image: np.ndarray, pose: TwoHandPose, *, title: str = "Camera view", truth: HandSample | None = None
) -> Figure:
    """Draw camera view, top view and side view of both hands.

    Top and side view show the same length in cm on the same length of paper.

    Args:
        image: (H, W, 3) uint8 RGB.
        pose: what was estimated in it.
        title: written above the camera view.
        truth: labels of the picture, drawn beside the estimate as thin grey lines; None for none.

    Returns:
        A matplotlib figure, not bound to any window.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("the three-view figure", "view") from error

    aspect = float(np.clip(image.shape[1] / image.shape[0], 0.5, 2.4))
    left, gap, right, bottom, top = 0.2, 0.75, 0.2, 0.62, 0.4
    widths = (_PANEL_IN * aspect, _PANEL_IN, _PANEL_IN)
    width, height = left + sum(widths) + 2 * gap + right, bottom + _PANEL_IN + top
    figure = Figure(figsize=(width, height), dpi=150, facecolor="white")
    axes, at = [], left
    for panel in widths:
        axes.append(figure.add_axes((at / width, bottom / height, panel / width, _PANEL_IN / height)))
        at += panel + gap
    reach = max(_reach_cm(pose), _reach_cm(_labelled(truth)) if truth is not None else 0.0)
    _camera_view(axes[0], image, pose, title, truth)
    _plan_view(axes[1], pose, reach, truth, across=0)
    _plan_view(axes[2], pose, reach, truth, across=1)
    return figure


def render_views(
    image: np.ndarray, pose: TwoHandPose, *, title: str = "Camera view", truth: HandSample | None = None
) -> bytes:
    """The figure of `draw_views` as the bytes of a PNG file.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    figure = draw_views(image, pose, title=title, truth=truth)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _camera_view(axes: Axes, image: np.ndarray, pose: TwoHandPose, title: str, truth: HandSample | None) -> None:
    """The picture, slightly faded, with both skeletons; below it the legend."""
    from matplotlib.lines import Line2D

    height, width = image.shape[:2]
    smaller = MOST_PIXELS_SHOWN / max(height, width)  # matplotlib would take gigabytes for a telephone's picture
    shown = image if smaller >= 1 else cv2.resize(image, None, fx=smaller, fy=smaller, interpolation=cv2.INTER_AREA)
    axes.imshow(shown, extent=(0, width, height, 0), interpolation="antialiased")
    axes.set(xlim=(0, width), ylim=(height, 0), xticks=[], yticks=[])
    axes.set_title(title, fontsize=10.5, color=_TEXT, parse_math=False)
    for spine in axes.spines.values():
        spine.set_visible(False)
    handles = []
    if truth is not None:
        for side in np.flatnonzero(truth.present):
            _label_lines(axes, truth.joints_px[side], "white")
    for side, hand in enumerate(pose.hands):
        if hand.joints_px is not None:
            _skeleton(axes, hand.joints_px, side, width=1.3, rim="#18181c", darker=1.0)
        if not hand.present:
            found = "not found"
        else:
            found = "range not solved" if hand.range_m is None else f"{100 * hand.range_m:.1f} cm"
        handles.append(
            Line2D(
                [],
                [],
                color=_paper_colour(HAND_COLOURS[side]),
                lw=3.5,
                label=f"{SIDES[side].capitalize()} hand: {found}",
            )
        )
    if any(hand.range_m is not None for hand in pose.hands):
        dots = Line2D([], [], color=_QUIET, lw=1.2, ls=(0, (1, 1.6)), label="camera to middle knuckle")
        handles.append(dots)
    if truth is not None:
        handles.append(Line2D([], [], color=_LABELS, lw=1.0, label="labels"))
    axes.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.03),
        ncols=4,
        frameon=False,
        fontsize=9,
        labelcolor=_TEXT,
        handlelength=1.4,
        columnspacing=2.0,
    )


def _plan_view(axes: Axes, pose: TwoHandPose, reach: float, truth: HandSample | None, *, across: int) -> None:
    """Seen from above (across = 0: x to the right, z up) or from the side (across = 1: z to the right, y down)."""
    from_above = across == 0
    order = (across, 2) if from_above else (2, across)

    def place(points: np.ndarray) -> np.ndarray:
        return np.asarray(points)[..., order]

    edges = _frustum(pose.camera, across, 3 * reach)
    axes.fill(*place(edges).T, color=_FIELD, zorder=0)
    for edge in edges[1:]:
        axes.plot(*place(np.stack([np.zeros(3), edge])).T, color=_QUIET, lw=0.8, ls=(0, (4, 3)), zorder=1)
    _camera_mark(axes, place, across, reach)
    if truth is not None:
        for side in np.flatnonzero(truth.present):
            _label_lines(axes, place(100 * truth.joints_m[side]), _LABELS)
    for side, hand in enumerate(pose.hands):
        if hand.joints_m is None:
            continue
        joints = 100 * hand.joints_m
        colour = _paper_colour(HAND_COLOURS[side])
        axes.plot(*place(np.stack([np.zeros(3), joints[ROOT]])).T, color=colour, lw=1.0, ls=(0, (1, 1.6)), zorder=2)
        _skeleton(axes, place(joints), side, width=2.0, rim="white", darker=_DARKER)
    low, high = -0.5 * reach, 0.5 * reach
    near, far = -0.07 * reach, 0.93 * reach
    axes.set_xlim((low, high) if from_above else (near, far))
    axes.set_ylim((near, far) if from_above else (high, low))
    axes.set_aspect("equal")
    _style(axes, reach)
    axes.set_xlabel("x, right (cm)" if from_above else "z, forward (cm)", fontsize=9, color=_TEXT, labelpad=2)
    axes.set_ylabel("z, forward (cm)" if from_above else "y, down (cm)", fontsize=9, color=_TEXT, labelpad=2)
    axes.set_title("Top view" if from_above else "Side view", fontsize=10.5, color=_TEXT)


def _skeleton(axes: Axes, points: np.ndarray, side: int, *, width: float, rim: str, darker: float) -> None:
    """One hand in 2D: a line per finger from the wrist to the tip, each in its shade, the root joint marked."""
    chains = [[0, *range(first, first + 4)] for first in range(1, N_JOINTS, 4)]
    for colour, extra in ((rim, 1.3), (None, 0.0)):
        for finger, chain in enumerate(chains):
            axes.plot(
                *points[chain].T,
                color=colour or _paper_colour(finger_colour(side, finger), darker),
                lw=width + extra,
                solid_capstyle="round",
                solid_joinstyle="round",
                zorder=3,
            )
    edge = _paper_colour(HAND_COLOURS[side], darker)
    axes.plot(*points[ROOT], "o", ms=2.4 * width, mfc="white", mec=edge, mew=0.6 * width, zorder=4)


def _label_lines(axes: Axes, points: np.ndarray, colour: str) -> None:
    """One labelled hand in 2D, thin; unlabelled joints break the lines."""
    for first in range(1, N_JOINTS, 4):
        chain = [0, *range(first, first + 4)]
        axes.plot(*points[chain].T, color=colour, lw=0.9, solid_capstyle="round", zorder=2.5)


def _labelled(sample: HandSample) -> TwoHandPose:
    """A sample's labels as a pose, for the extent of the axes."""
    left, right = (
        HandPose(present=bool(sample.present[side]), joints_m=joints if np.isfinite(joints).all() else None)
        for side, joints in enumerate(sample.joints_m)
    )
    return TwoHandPose(left, right, sample.camera)


def _camera_mark(axes: Axes, place, across: int, reach: float) -> None:
    """A small camera at the origin, looking along z."""
    size = 0.028 * reach
    outline = np.zeros((4, 3))
    outline[:, across] = np.array([-1.0, 1.0, 1.0, -1.0]) * size
    outline[:, 2] = np.array([-1.6, -1.6, 0.0, 0.0]) * size
    lens = np.zeros((3, 3))
    lens[:, across] = np.array([0.0, 0.8, -0.8]) * size
    lens[:, 2] = np.array([-0.4, 0.9, 0.9]) * size
    for shape in (outline, lens):
        axes.fill(*place(shape).T, facecolor=_TEXT, edgecolor="white", lw=0.6, zorder=5)


def _style(axes: Axes, reach: float) -> None:
    """Same grid on both axes, quiet frame."""
    from matplotlib.ticker import MultipleLocator

    step = next((step for step in (5, 10, 20, 50, 100, 200, 500) if reach / step <= 7), reach / 5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))
    axes.grid(color=_GRID, lw=0.7, zorder=0)
    axes.set_axisbelow(True)
    axes.tick_params(length=0, labelsize=8.5, labelcolor=_QUIET, pad=3)
    for spine in axes.spines.values():
        spine.set(color=_GRID, linewidth=0.9)


def _reach_cm(pose: TwoHandPose) -> float:
    """Side of the square, in cm, that shows camera and hands in both plans."""
    joints = [100 * hand.joints_m for hand in pose.hands if hand.joints_m is not None]
    if not joints:
        return _MIN_REACH_CM
    largest = np.nanmax(np.abs(np.concatenate(joints)), axis=0)
    return max(_MIN_REACH_CM, *(float(r) for r in largest * (2.2, 2.2, 1.15)))


def _frustum(camera: PinholeCamera, across: int, depth: float) -> np.ndarray:
    """Origin and the two edges of the field of view at one depth, (3, 3); lens distortion is ignored."""
    focal, centre, size = (camera.fx, camera.cx, camera.width) if across == 0 else (camera.fy, camera.cy, camera.height)
    edges = np.zeros((3, 3))
    edges[1:, 2] = depth
    edges[1:, across] = depth * (np.array([0.0, size]) - centre) / focal
    return edges


def _paper_colour(rgb: tuple[int, int, int], darker: float = _DARKER) -> tuple[float, float, float]:
    """RGB 0..255 as matplotlib's 0..1, darkened for white paper."""
    red, green, blue = (darker * c / 255 for c in rgb)
    return red, green, blue
