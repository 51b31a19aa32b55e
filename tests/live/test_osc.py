"""Live's avatars: what a browser's pictures become on a real socket of VMC."""

import json
import socket

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytest.importorskip("pythonosc")
from pythonosc.osc_bundle import OscBundle
from tests.live.fakes import camera_for, estimate, picture, serving
from websockets.sync.client import connect

from twohands.live.clip import LiveClip
from twohands.live.messages import Settings
from twohands.motion.vmc import VmcSender

FRAMES = 5


def test_a_bundle_for_each_picture():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as avatar:
        avatar.bind(("127.0.0.1", 0))
        avatar.settimeout(300)
        sender = VmcSender("127.0.0.1", avatar.getsockname()[1])
        clip = LiveClip(estimate, camera_for, "fake", {}, Settings("stream", 0.1), sender)
        with serving(clip) as port, connect(f"ws://127.0.0.1:{port}/stream", open_timeout=300) as page:
            page.send(json.dumps({"begin": {"hand_length_m": 0.1}}))
            for index in range(FRAMES):
                page.send(picture(index / 10))
                for _ in range(2 if index == 0 else 1):
                    page.recv(timeout=300)
        for index in range(FRAMES):
            messages = [(message.address, message.params) for message in OscBundle(avatar.recv(65536))]
            assert messages[1] == ("/VMC/Ext/T", [pytest.approx(index / 10, abs=1e-6)])
            bones = [values[0] for address, values in messages if address == "/VMC/Ext/Bone/Pos"]
            assert len(bones) == 16 and bones[0] == "LeftHand" and bones[-1] == "LeftLittleDistal"
