"""What clients may send; everything else is one line that says why not."""

import json
import math
import struct

import cv2
import numpy as np
import pytest

from twohands.errors import InputError
from twohands.live.messages import (
    MAX_BYTES,
    Begin,
    End,
    Measure,
    Settings,
    parse_picture,
    parse_text,
    picture_message,
    picture_of,
)

IMAGE = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
GOOD = {"source": "webcam", "hand_length_m": 0.11, "fov_deg": 70, "mirrored": True}


def picture(time_s: float = 0.5, ending: str = ".png", image: np.ndarray = IMAGE) -> bytes:
    return struct.pack("<d", time_s) + cv2.imencode(ending, image)[1].tobytes()


def test_begin_and_end():
    assert parse_text(json.dumps({"begin": GOOD})) == Begin(Settings("webcam", 0.11, 70.0, True))
    assert parse_text('{"begin": {"hand_length_m": 0.1}}') == Begin(Settings("stream", 0.1, None, False))
    assert parse_text('{"end": true}') == End()
    assert parse_text(json.dumps({"begin": GOOD | {"scale_source": "assumed"}})).settings.scale_source == "assumed"


def test_a_taped_distance_and_its_end():
    assert parse_text('{"measure": {"distance_m": 0.5}}') == Measure(0.5)
    assert parse_text('{"measure": {"distance_m": null}}') == parse_text('{"measure": {}}') == Measure(None)


def test_a_picture_keeps_its_pixels_and_its_time():
    time_s, image = parse_picture(picture(1.25))
    assert time_s == 1.25
    np.testing.assert_array_equal(image, IMAGE[..., ::-1])


def test_the_server_says_time_and_age_before_a_picture():
    assert picture_message(b"jpeg", 1.5, 0.25) == struct.pack("<dd", 1.5, 0.25) + b"jpeg"
    assert picture_of(struct.pack("<d", 1.5) + b"jpeg") == b"jpeg"


@pytest.mark.parametrize(
    "text",
    [
        "", "x", "[]", "1", "null", "{}", '{"end": false}', '{"begin": 1}', '{"begin": {}, "end": true}', "[" * 100_000,
        *(
            json.dumps({"begin": GOOD | change})
            for change in (
                {"hand_length_m": 0}, {"hand_length_m": -1}, {"hand_length_m": 1}, {"hand_length_m": "0.1"},
                {"hand_length_m": True}, {"hand_length_m": math.nan}, {"hand_length_m": None},
                {"hand_length_m": 10**400}, {"fov_deg": 0}, {"fov_deg": 180}, {"fov_deg": math.inf},
                {"fov_deg": []}, {"mirrored": 1}, {"source": 3}, {"path": "/etc/passwd"}, {"scale_source": "guess"},
                {"scale_source": []},
            )
        ),
        *(json.dumps({"measure": value}) for value in (1, [], {"distance_m": 0.05}, {"distance_m": 50},
          {"distance_m": "0.5"}, {"distance_m": True}, {"distance_m": math.nan}, {"at": 0.5})),
    ],
)  # fmt: skip
def test_other_texts_are_refused(text):
    with pytest.raises(InputError):
        parse_text(text)


def test_a_source_is_a_short_printable_name():
    (settings,) = [parse_text(json.dumps({"begin": GOOD | {"source": "a\n\x1b[2J" + "b" * 999}})).settings]
    assert settings.source.startswith("a[2Jb") and len(settings.source) == 200


@pytest.mark.parametrize(
    "data",
    [
        b"", b"1234567", b"12345678", picture(math.nan), picture(math.inf), picture(1e300), picture()[:-30],
        picture(ending=".bmp"), picture(ending=".tiff"), struct.pack("<d", 0) + b"GIF89a" * 20,
        picture() + bytes(MAX_BYTES), picture(image=np.zeros((5000, 5000, 3), np.uint8)), picture(image=IMAGE[:8, :8]),
    ],
)  # fmt: skip
def test_other_pictures_are_refused(data):
    with pytest.raises(InputError):
        parse_picture(data)


def test_five_hundred_damaged_messages():
    """Each is taken or refused in one line; nothing else comes out."""
    rng = np.random.default_rng(40)
    texts = [json.dumps({"begin": GOOD}), '{"end": true}', '{"measure": {"distance_m": 0.5}}']
    pictures = [picture(ending=ending) for ending in (".jpg", ".png", ".webp")]
    for attempt in range(500):
        whole = texts[attempt % 3].encode() if attempt % 5 < 2 else pictures[attempt % 3]
        data = bytearray(whole[: rng.integers(1, len(whole) + 1)] if rng.random() < 0.3 else whole)
        for _ in range(rng.integers(1, 6)):
            data[rng.integers(len(data))] = rng.integers(256)
        try:
            if attempt % 5 < 2:
                parse_text(data.decode(errors="replace"))
            else:
                parse_picture(bytes(data))
        except InputError as error:
            assert "\n" not in str(error)
