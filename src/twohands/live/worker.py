"""A thread that estimates: the newest picture, never a queue of them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np

from twohands.errors import InputError
from twohands.inference.frames import STALL_TIMEOUT_S, Frame
from twohands.live.clip import LiveClip, Told
from twohands.live.messages import Settings, parse_picture, picture_of

_JPEG_QUALITY: Final = 85


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture that waits.

    Attributes:
        message: as the client has sent it.
        index: position among those of its clip.
        sender: the client.
    """

    message: bytes
    index: int
    sender: Any


@dataclass(frozen=True, slots=True)
class News:
    """One frame's results.

    Attributes:
        header: line of its clip; one string object for each clip.
        line: of the frame.
        time_s: of the frame.
        taken: when the picture was taken over, of `time.monotonic`.
        sender: the client whose picture it was; None for the machine's own camera.
        picture: its JPEG, PNG or WebP file; None where nobody wants it.
        note: the line for who measures, and that client; None where nobody does.
    """

    header: str
    line: str
    time_s: float
    taken: float
    sender: Any
    picture: bytes | None
    note: tuple[Any, str] | None = None


class Worker:
    """Estimates pictures of clients, or of a camera of this machine; a context manager.

    Args:
        clip: with which.
        publish: called in the thread with every frame's results.
        refuse: called in the thread with a sender, and why its picture cannot be used.
        ended: called in the thread when the camera has ended, with None, or with what went wrong.
        camera: frames of this machine's camera; None where clients send pictures.
        wanted: whether somebody wants the camera's pictures.
    """

    def __init__(
        self,
        clip: LiveClip,
        *,
        publish: Callable[[News], None],
        refuse: Callable[[Any, str], None],
        ended: Callable[[BaseException | None], None],
        camera: Iterable[Frame] | None = None,
        wanted: Callable[[], bool] = lambda: False,
    ) -> None:
        self._clip = clip
        self._publish, self._refuse, self._say_end = publish, refuse, ended
        self._camera, self._wanted = camera, wanted
        self._news = threading.Condition()
        self._settings: Settings | None = None
        self._picture: Picture | None = None
        self._measure: tuple[Any, float | None] | None = None
        self._measurer: Any = None
        self._taken = 0.0
        self._stopped = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> Worker:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._news:
            self._stopped = True
            self._news.notify()
        self._thread.join(STALL_TIMEOUT_S + 5.0)  # a process that ends while it estimates would abort

    def begin(self, settings: Settings) -> None:
        """A new clip; a picture that waits belongs to the old one and is dropped."""
        with self._news:
            self._settings, self._picture = settings, None
            self._news.notify()

    def measure(self, client: Any, distance_m: float | None) -> None:
        """Takes the hand length from a hand at that distance, metres; None: no more."""
        with self._news:
            self._measure = client, distance_m
            self._news.notify()

    def put(self, picture: Picture) -> None:
        """The newest picture; one that still waits is dropped."""
        with self._news:
            self._picture, self._taken = picture, time.monotonic()
            self._news.notify()

    def _run(self) -> None:
        try:
            self._work_on_camera(self._camera) if self._camera is not None else self._work_on_pictures()
        except BaseException as error:  # handed over, whatever it is
            self._say_end(error)

    def _do_what_is_asked(self) -> None:
        settings, self._settings = self._settings, None
        if settings is not None:
            self._clip.begin(settings)
        measure, self._measure = self._measure, None
        if measure is not None:
            self._measurer = measure[0]
            self._clip.measure(measure[1])

    def _work_on_pictures(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._stopped or self._settings or self._picture or self._measure)
                if self._stopped:
                    return
                self._do_what_is_asked()
                picture, self._picture = self._picture, None
                taken = self._taken
            if picture is None:
                continue
            try:
                time_s, image = parse_picture(picture.message)
                told = self._clip.frame(image, picture.index, time_s)
            except InputError as error:
                self._refuse(picture.sender, str(error))
                continue
            self._tell(told, time_s, taken, picture.sender, picture_of(picture.message))

    def _work_on_camera(self, frames: Iterable[Frame]) -> None:
        for frame in frames:
            taken = time.monotonic()
            with self._news:
                if self._stopped:
                    return
                self._do_what_is_asked()
            told = self._clip.frame(frame.image, frame.index, frame.time_s)
            self._tell(told, frame.time_s, taken, None, _jpeg(frame.image) if self._wanted() else None)
        self._say_end(None)

    def _tell(self, told: Told, time_s: float, taken: float, sender: Any, picture: bytes | None) -> None:
        note = None if told.note is None else (self._measurer, told.note)
        self._publish(News(told.header, told.line, time_s, taken, sender, picture, note))


def _jpeg(image: np.ndarray) -> bytes:
    quality = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), quality)[1].tobytes()
