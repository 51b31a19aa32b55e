"""`twohands live`: what it refuses before anything is opened, and what it tells the page."""

import json
import queue
import threading
import time

import cv2
import numpy as np
import pytest

pytest.importorskip("starlette")
from tests.oracles import write_tiny_weights

from twohands.cli import live
from twohands.cli.main import main


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--host", "0.0.0.0"], "--host 0.0.0.0 lets others in: give them a --token"),
        (["--token", "short"], "--token must be at least 8 letters and digits"),
        (["--allow-origin", "evil.example"], "an origin such as http://localhost:3000 expected"),
        (["--camera", "front.json"], "a number expected, 0 for the first; intrinsics go to --camera-file"),
        (["--camera", "77"], "camera:77: no such camera"),
        (["--camera-file", "missing.json"], "missing.json: no such camera file"),
        (["--camera-file", "missing.json", "--fov", "60"], "give --camera-file or --fov, not both"),
        (["--fov", "0"], "field of view must lie between 0 and 180 degrees"),
        (["--hand-length", "-1"], "--hand-length must be a positive number of cm"),
        (["--osc", "39539"], "--osc 39539: HOST:PORT expected, such as 127.0.0.1:39539"),
        (["--osc", "127.0.0.1:0"], "--osc 127.0.0.1:0: HOST:PORT expected"),
        (["--port", "99999"], "--port must lie between 0 and 65535, got 99999"),
        (["--weights", "none"], "none"),
    ],
)
def test_a_bad_option_is_one_line_exit_2(arguments, message, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert main(["live", "--port", "0", "--no-open", *arguments]) == 2
    captured = capfd.readouterr()
    assert message in captured.err and captured.err.count("twohands: error") == 1 and captured.out == ""
    assert list(tmp_path.iterdir()) == []


def test_the_page_knows_what_was_given_and_ctrl_c_is_the_end(tmp_path, monkeypatch, capsys):
    pages = []

    def interrupted(self, listening, started):
        pages.append(self._page)
        started()
        raise KeyboardInterrupt

    monkeypatch.setattr("twohands.live.server.LiveServer.run", interrupted)
    monkeypatch.setattr(live.webbrowser, "open", lambda address: pytest.fail("nobody asked for it"))
    weights = str(write_tiny_weights(tmp_path / "tiny"))
    arguments = ["--port", "0", "--no-open", "--weights", weights, "--hand-length", "11.5", "--mirrored", "--fov", "70"]
    assert main(["live", *arguments]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("live at http://127.0.0.1:") and "live has ended" in captured.err
    known = (
        '{"camera": null, "hand_length_cm": 11.5, "fov_deg": 70.0, "mirrored": true, "camera_file": false, '
        '"scale_source": "typed", "ours": true}'
    )
    assert f'<script id="live" type="application/json">{known}</script>' in pages[0]


def test_a_camera_of_this_machine_from_its_capture_to_a_client(tmp_path, monkeypatch):
    """`--camera 0`: header, pictures and lines as long as it gives pictures; then all ends, exit 0."""
    websockets = pytest.importorskip("websockets.sync.client")
    addresses: queue.Queue[str] = queue.Queue()
    unplugged = threading.Event()

    class Capture:
        def __init__(self, number: int) -> None:
            assert number == 0

        def isOpened(self) -> bool:
            return True

        def set(self, *_: float) -> None:
            pass

        def read(self) -> tuple[bool, np.ndarray | None]:
            time.sleep(0.02)
            return (False, None) if unplugged.is_set() else (True, np.full((96, 160, 3), (200, 100, 50), np.uint8))

        def release(self) -> None:
            pass

    monkeypatch.setattr("twohands.inference.frames.cv2.VideoCapture", Capture)
    monkeypatch.setattr(live, "_say_where", lambda address, wanted: addresses.put(address))
    weights = str(write_tiny_weights(tmp_path / "tiny"))
    ended: list[int] = []
    arguments = live.LiveArgs(camera="0", port=0, weights=weights, mirrored=True)
    server = threading.Thread(target=lambda: ended.append(live.run(arguments)))
    server.start()
    try:
        address = addresses.get(timeout=300).replace("http:", "ws:")
        with websockets.connect(f"{address}stream?pictures=1", open_timeout=300) as client:
            header, picture = client.recv(timeout=300), ""
            while isinstance(picture, str):  # those of frames before we came are not sent
                picture = client.recv(timeout=300)
            line = client.recv(timeout=300)
            assert json.loads(header)["source"] == "camera:0" and json.loads(header)["mirrored"] is True
            assert json.loads(header)["camera"]["width"] == 160 and "index" in json.loads(line)
            shown = cv2.imdecode(np.frombuffer(picture[16:], np.uint8), cv2.IMREAD_COLOR)
            np.testing.assert_allclose(shown.mean(axis=(0, 1)), (200, 100, 50), atol=4)
            client.send(json.dumps({"begin": {"hand_length_m": 0.12, "fov_deg": 70}}))
            while json.loads(header)["hand_length_m"] != 0.12:
                header = next(text for text in iter(client.recv, None) if isinstance(text, str) and "version" in text)
    finally:
        unplugged.set()
        server.join(300)
    assert ended == [0]
