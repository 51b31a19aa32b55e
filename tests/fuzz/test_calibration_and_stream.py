"""Five hundred damaged profiles, camera files of `calibrate` and messages to the live page each: taken, or refused in
one line. TWOHANDS_FUZZ says how many instead."""

import json
import os
import struct

import cv2
import numpy as np
import pytest
from tests.fuzz.mutations import damaged_bytes, damaged_text

from twohands.errors import TwoHandsError
from twohands.formats.camera_files import read_camera
from twohands.formats.profiles import Profile, camera_record, profile_bytes, profile_path, read_profile
from twohands.live.messages import Begin, End, Measure, parse_picture, parse_text
from twohands.types import PinholeCamera

COUNT = int(os.environ.get("TWOHANDS_FUZZ", "500"))
CAMERA = PinholeCamera(500.0, 501.0, 320.5, 180.25, 640, 360, (0.1, -0.05, 0.001, 0.0))
PROFILES = [
    profile_bytes(Profile(CAMERA, "board", 0.112, "board")),
    profile_bytes(Profile(PinholeCamera.from_fov(60, 640, 360), "assumed", 0.1, "distance")),
    profile_bytes(Profile(None, None, 0.1, "typed")),
]
CALIBRATED = (
    json.dumps(
        camera_record(CAMERA)
        | {"calibration_tool": "twohands calibrate camera", "number_of_views": 25, "reprojection_error_px": 0.21},
        indent=1,
    ).encode()
    + b"\n"
)
TEXTS = [
    json.dumps({"begin": {"source": "webcam", "hand_length_m": 0.11, "fov_deg": 70, "mirrored": True}}).encode(),
    json.dumps({"begin": {"hand_length_m": 0.1, "scale_source": "assumed"}}).encode(),
    b'{"end": true}',
    b'{"measure": {"distance_m": 0.5}}',
]
IMAGE = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
PICTURES = [struct.pack("<d", 1.5) + cv2.imencode(ending, IMAGE)[1].tobytes() for ending in (".jpg", ".png", ".webp")]


def one_line(error: TwoHandsError) -> bool:
    return "\n" not in str(error) and 0 < len(str(error)) < 400


def test_profiles(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    path = profile_path("me")
    path.parent.mkdir(parents=True)
    taken = 0
    for seed in range(COUNT):
        path.write_bytes(damaged_text(PROFILES[seed % 3], np.random.default_rng([seed, 1])))
        try:
            profile = read_profile("me")
        except TwoHandsError as error:
            assert one_line(error) and str(path) in str(error), (seed, str(error))
        else:
            taken += 1
            assert profile.hand_length_m is None or 0 < profile.hand_length_m < np.inf, seed
            assert (profile.camera is None) == (profile.intrinsics_source is None), seed
        assert [each.name for each in path.parent.iterdir()] == ["me.json"]
    assert 0.02 * COUNT < taken < 0.9 * COUNT, "damage that is neither nothing nor all"


def test_camera_files_of_calibrate(tmp_path):
    path = tmp_path / "camera.json"
    for seed in range(COUNT):
        path.write_bytes(damaged_text(CALIBRATED, np.random.default_rng([seed, 2])))
        try:
            camera = read_camera(path)
        except TwoHandsError as error:
            assert one_line(error) and path.name in str(error), (seed, str(error))
        else:
            assert camera.fx > 0 and camera.fy > 0, seed


def test_texts_to_the_live_page():
    for seed in range(COUNT):
        data = damaged_text(TEXTS[seed % len(TEXTS)], np.random.default_rng([seed, 3]))
        try:
            asked = parse_text(data.decode(errors="replace"))
        except TwoHandsError as error:
            assert one_line(error), (seed, str(error))
        else:
            assert isinstance(asked, Begin | End | Measure), seed


def test_pictures_to_the_live_page():
    for seed in range(COUNT):
        try:
            time_s, image = parse_picture(damaged_bytes(PICTURES[seed % 3], np.random.default_rng([seed, 4])))
        except TwoHandsError as error:
            assert one_line(error), (seed, str(error))
        else:
            assert np.isfinite(time_s) and image.dtype == np.uint8 and image.ndim == 3, seed


def test_a_server_that_gets_damaged_messages_goes_on():
    """Each client is answered or sent away with a reason; the next one is served."""
    pytest.importorskip("uvicorn")
    sync = pytest.importorskip("websockets.sync.client")
    from tests.live.fakes import serving
    from websockets.exceptions import ConnectionClosed

    with serving() as port:
        for seed in range(COUNT // 10):
            rng = np.random.default_rng([seed, 5])
            with sync.connect(f"ws://127.0.0.1:{port}/stream", open_timeout=300) as client:
                try:
                    client.send(damaged_text(TEXTS[seed % len(TEXTS)], rng).decode(errors="replace"))
                    client.send(damaged_bytes(PICTURES[seed % 3], rng))
                    client.send('{"end": true}')
                    client.ping(ack_on_close=True).wait(300)  # without it, who is sent away waits for ever
                    client.send("over")
                    while True:
                        assert json.loads(client.recv(timeout=300))
                except ConnectionClosed as closed:
                    assert closed.rcvd is not None and closed.rcvd.code in (1007, 1008, 1009) and closed.rcvd.reason
        with sync.connect(f"ws://127.0.0.1:{port}/stream", open_timeout=300) as client:
            client.send(TEXTS[0].decode())
            client.send(PICTURES[0])
            assert "version" in json.loads(client.recv(timeout=300))
