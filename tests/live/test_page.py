"""The page in a real browser: what it shows of a webcam is what `track` says of the same frames.

Needs Debian's chromium (`scripts/system-packages.sh browser`) and playwright. TWOHANDS_SCREENSHOTS names a folder for
pictures of the pages, which are there to be looked at.
"""

from __future__ import annotations

import contextlib
import functools
import http.server
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("playwright")
pytest.importorskip("uvicorn")
pytest.importorskip("av")
import av
from playwright.sync_api import sync_playwright
from tests.live.fakes import IMAGE, make_clip, seen_hand, serving

from twohands.cli.demo import examples_folder
from twohands.cli.main import main
from twohands.formats.pictures import read_image
from twohands.inference.clip_files import read_clip
from twohands.live.messages import parse_picture
from twohands.visualization.view_page import live_page, view_policy

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no chromium: scripts/system-packages.sh browser installs it"),
]
ROOT = Path(__file__).resolve().parents[2]
FOV_DEG = 104
FRAMES = 12
"""That are compared."""
PATIENCE_MS = 600_000
"""A machine that runs all tests at once may take long; nothing here is timed."""


def moving_hands(count: int) -> list[np.ndarray]:
    """A packaged picture of both hands, generated, under a camera that moves a little; (360, 640, 3) uint8 RGB."""
    image = read_image(examples_folder() / "example_06.png")
    frames = []
    for phase in np.linspace(0, 2 * np.pi, count, endpoint=False):
        zoom, (u, v) = 1.1 + 0.06 * np.sin(phase), (480 + 20 * np.sin(2 * phase), 270 + 12 * np.cos(phase))
        matrix = np.array([[zoom, 0, 480 - zoom * u], [0, zoom, 270 - zoom * v]])
        moved = cv2.warpAffine(image, matrix, (960, 540), borderMode=cv2.BORDER_REFLECT)
        frames.append(cv2.resize(moved, (640, 360), interpolation=cv2.INTER_AREA))
    return frames


def lossless_clip(path: Path, frames: list[np.ndarray], times_s: list[float]) -> Path:
    """A video file that gives the very pixels and times back; a Matroska file would round these to milliseconds."""
    clock = Fraction(1, 1_000_000)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("png", rate=30)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = "rgb24"
        stream.codec_context.time_base = clock
        for image, time_s in zip(frames, times_s, strict=True):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = round(time_s / clock), clock
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@pytest.fixture(scope="module")
def webcam(tmp_path_factory) -> Path:
    """What the browser takes for its camera."""
    path = tmp_path_factory.mktemp("webcam") / "clip.mjpeg"
    quality = [cv2.IMWRITE_JPEG_QUALITY, 95]
    frames = [cv2.imencode(".jpg", image[..., ::-1], quality)[1].tobytes() for image in moving_hands(60)]
    path.write_bytes(b"".join(frames))
    return path


@pytest.fixture(scope="module")
def browser(webcam):
    fake = ["--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream"]
    drawing = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    arguments = [*fake, f"--use-file-for-fake-video-capture={webcam}", *drawing, "--no-sandbox"]
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=arguments, timeout=PATIENCE_MS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser):
    context = browser.new_context(viewport={"width": 1280, "height": 900}, permissions=["camera"])
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    page.problems = []
    page.on("pageerror", lambda error: page.problems.append(str(error)))
    page.on("console", lambda said: said.type == "error" and page.problems.append(said.text))
    yield page
    context.close()


@contextlib.contextmanager
def live(*arguments: str):
    """`twohands live` on a free port; gives its address. Ends it by Ctrl-C, which must do."""
    command = [sys.executable, "-m", "twohands", "live", "--port", "0", "--no-open", "--fov", str(FOV_DEG), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found is not None, process.stderr and process.stderr.read()
        yield found[0]
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_MS / 1000) == 0
        assert "Traceback" not in (process.stderr.read() if process.stderr else "")
    finally:
        process.kill()


@contextlib.contextmanager
def other_site(folder: Path):
    """A web site of somebody else; gives its origin."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    handler = functools.partial(Quiet, directory=folder)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


def until(page, expression: str) -> None:
    """Waits for an expression; playwright's own waiting evaluates text in the page, which its policy forbids."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not page.evaluate(expression):
        assert time.monotonic() < deadline, f"{expression}; {page.inner_text('body')[:500]}"
        page.wait_for_timeout(100)


def until_it_shows(page, frames: list[np.ndarray], index: int) -> None:
    """Waits until the page's picture is that frame rather than another; a browser may draw it after its joints."""
    small = np.stack([cv2.resize(frame, (64, 36), interpolation=cv2.INTER_AREA) for frame in frames]).astype(float)
    deadline = time.monotonic() + PATIENCE_MS / 1000
    nearest = None
    while nearest != index:
        assert time.monotonic() < deadline, f"frame {nearest} is shown, expected {index}"
        painted = page.evaluate(
            """() => { const canvas = document.querySelector("#picture canvas");
                       const small = Object.assign(document.createElement("canvas"), { width: 64, height: 36 });
                       const context = small.getContext("2d");
                       context.drawImage(canvas, 0, 0, 64, 36);
                       return [...context.getImageData(0, 0, 64, 36).data] }"""
        )
        off = np.abs(np.array(painted).reshape(36, 64, 4)[..., :3] - small).mean((1, 2, 3))
        nearest = int(np.argmin(off))


def shots(page, name: str) -> None:
    """Pictures of a page, wide and narrow, where somebody wants them."""
    folder = os.environ.get("TWOHANDS_SCREENSHOTS")
    if folder:
        Path(folder).mkdir(parents=True, exist_ok=True)
        for width, height in ((1280, 900), (400, 860)):
            page.set_viewport_size({"width": width, "height": height})
            time.sleep(2)
            page.screenshot(path=f"{folder}/{name}_{width}.png", full_page=True)


def joints_on_the_page(page) -> tuple[int, np.ndarray]:
    """Index of the frame, and (2, 21, 3) metres of both hands; NaN where nothing is shown."""
    index, cells = page.evaluate(
        """() => { const table = document.querySelector("#joints");
                   const cells = [...table.querySelectorAll("td")].map((cell) => cell.textContent);
                   return [Number(table.dataset.index), cells] }"""
    )
    values = np.array([np.nan if text in ("–", "") else float(text) / 1000 for text in cells])
    return index, values.reshape(21, 2, 3).transpose(1, 0, 2)


def joints(pose) -> np.ndarray:
    return np.stack([np.full((21, 3), np.nan) if hand.joints_m is None else hand.joints_m for hand in pose.hands])


def test_joints_on_the_page_are_those_of_track(page, tmp_path):
    sent, lines = [], []

    def listen(socket):
        socket.on("framesent", lambda data: isinstance(data, bytes) and sent.append(data))
        socket.on("framereceived", lambda data: isinstance(data, str) and lines.append(data))

    page.on("websocket", listen)
    with live() as address:
        page.goto(address)
        page.click("summary")
        page.click("#webcam")
        until(page, f"Number(document.querySelector('#joints').dataset.index) >= {FRAMES}")
        until(page, "/fps.*delay/.test(document.querySelector('#facts').textContent)")
        print("live page:", page.inner_text("#facts"))
        shots(page, "live")
        page.click("#stop")
        page.wait_for_timeout(500)
        shown_index, shown = joints_on_the_page(page)
        with page.expect_download() as download:
            page.click("#webcam")
            page.click("#record")
            until(page, "/[1-9] frames recorded/.test(document.querySelector('#facts').textContent)")
            page.click("#record")
        header, poses = read_clip(Path(shutil.copy(download.value.path(), tmp_path / "hands.jsonl")))
        assert header["source"] == "webcam" and len(list(poses)) > 0
    assert page.problems == []
    told = {}
    for line in map(json.loads, lines):
        if "version" in line:
            if told:
                break  # the second clip, which was recorded
            assert abs(line["camera"]["width"] - 2 * line["camera"]["fx"] * np.tan(np.radians(FOV_DEG / 2))) < 1e-3
        else:
            told[line["index"]] = line
    order = sorted(told)  # a machine with much to do drops some
    taken = [parse_picture(sent[index]) for index in order]
    clip = lossless_clip(tmp_path / "sent.mov", [image for _, image in taken], [time_s for time_s, _ in taken])
    out = tmp_path / "track"
    assert main(["track", str(clip), "--out", str(out), "--fov", str(FOV_DEG), "--no-overlay"]) == 0
    poses = dict(zip(order, read_clip(out / "hands.jsonl")[1], strict=True))
    assert np.isfinite(joints(poses[shown_index])).all(), "both hands were to be seen"
    for index, line in told.items():
        streamed = [line["hands"][side]["joints_m"] or np.full((21, 3), np.nan) for side in ("left", "right")]
        np.testing.assert_allclose(np.array(streamed), joints(poses[index]), atol=1e-3, equal_nan=True)
    np.testing.assert_allclose(shown, joints(poses[shown_index]), atol=1e-3, equal_nan=True)


ONE_HAND = """
const real = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
navigator.mediaDevices.getUserMedia = async (wanted) => {
  const video = Object.assign(document.createElement("video"), { muted: true, srcObject: await real(wanted) });
  await video.play();
  const canvas = Object.assign(document.createElement("canvas"), { width: 640, height: 360 });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  setInterval(() => context.drawImage(video, 0, 0, 320, 360, 0, 0, 320, 360), 100);
  return canvas.captureStream(10);
};
"""
"""The webcam's left half, which shows the left hand alone, beside black."""


def test_a_taped_distance_and_the_fields_change_what_is_estimated(page):
    lines: list[dict] = []

    def listen(socket):
        socket.on("framereceived", lambda data: isinstance(data, str) and lines.append(json.loads(data)))

    def header() -> dict:
        return next(line for line in reversed(lines) if "version" in line)

    def begun(test) -> dict:
        """The header of the clip that a change has begun, once a frame of it is there."""
        deadline = time.monotonic() + PATIENCE_MS / 1000
        while not (lines and "index" in lines[-1] and test(header())):
            assert time.monotonic() < deadline, header()
            page.wait_for_timeout(100)
        return header()

    page.add_init_script(ONE_HAND)
    page.on("websocket", listen)
    with live() as address:
        page.goto(address)
        shots(page, "empty")
        page.click("#webcam")
        until(page, "/cm/.test(document.querySelector('#tile-left').textContent)")
        until(page, "document.querySelector('#tile-left .about').textContent !== 'not seen'")
        assert "assumed hand length" in page.inner_text("#assumed")
        page.click("#calibrate")
        page.fill("#distance", "50")
        page.click("#measure")
        shots(page, "tape")
        until(page, "/^Hand length/.test(document.querySelector('#tape-text').textContent)")
        said = page.inner_text("#tape-text")
        shots(page, "taped")
        told = next(line["measured"] for line in reversed(lines) if "measured" in line)
        assert f"{100 * told['hand_length_m']:.1f} ±" in said and f"{141.42 * told['sigma']:.0f} %" in said
        assert page.input_value("#length") == f"{100 * told['hand_length_m']:.2f}"
        assert float(page.input_value("#fov")) == told["fov_deg"]
        begun(lambda clip: clip["hand_length_m"] == told["hand_length_m"])
        hand = lines[-1]["hands"]["left"]
        assert hand["scale_source"] == "distance" and hand["range_m"] == pytest.approx(0.5, rel=0.12)
        assert page.is_hidden("#assumed")
        page.click("#undo")
        assert begun(lambda clip: clip["hand_length_m"] == 0.1)["camera"]["fx"] == pytest.approx(250, abs=1)
        assert lines[-1]["hands"]["left"]["scale_source"] == "assumed"
        page.click("#calibrate")
        page.fill("#length", "12")
        page.press("#length", "Enter")
        begun(lambda clip: clip["hand_length_m"] == 0.12)
        assert lines[-1]["hands"]["left"]["scale_source"] == "typed"
        page.fill("#fov", "70")
        page.press("#fov", "Enter")
        assert begun(lambda clip: clip["camera"]["fx"] > 300)["camera"]["fx"] == pytest.approx(457, abs=1)
        page.check("#mirrored")
        begun(lambda clip: clip["mirrored"])
        page.fill("#fov", "999")
        page.press("#fov", "Enter")
        page.wait_for_timeout(300)
        assert header()["camera"]["fx"] == pytest.approx(457, abs=1), "what cannot be is not sent"
    until(page, "!document.querySelector('#message').hidden")
    shots(page, "ended")
    assert re.match("Twohands live has ended|No answer from twohands live", page.inner_text("#message"))


SMALL = """
navigator.mediaDevices.getUserMedia = async () => {
  const canvas = Object.assign(document.createElement("canvas"), { width: %d, height: %d });
  const context = canvas.getContext("2d");
  let turn = 0;
  setInterval(() => { context.fillStyle = turn++ %% 2 ? "#456" : "#457"; context.fillRect(0, 0, 999, 999); }, 50);
  return canvas.captureStream(20);
};
""" % IMAGE.shape[1::-1]  # noqa: UP031  braces are the script's own
"""A webcam of pictures as small as `seen_hand` wants them."""


@pytest.fixture
def quick(page):
    """The page with an estimator that takes no time and sees one hand at 40 cm; its webcam runs."""
    config = {"camera": None, "hand_length_cm": 10, "fov_deg": None, "mirrored": False, "camera_file": False}
    html = live_page(config | {"scale_source": "assumed", "ours": True})
    page.add_init_script(SMALL)
    with serving(make_clip(seen_hand(0.4)), page=(html, view_policy(live=True))) as port:
        page.goto(f"http://127.0.0.1:{port}/")
        page.click("#webcam")
        until(page, "!document.querySelector('#calibrate').disabled")
        page.click("#calibrate")
        yield page
    assert page.problems == []


def test_a_recording_ends_what_is_measured_and_holds_one_clip(quick, tmp_path):
    quick.evaluate("document.querySelector('#measure').click(); document.querySelector('#record').click()")
    assert quick.is_disabled("#measure") and quick.is_disabled("#undo") and quick.is_hidden("#tape-says")
    until(quick, "/(\\d\\d|[3-9])\\d frames recorded/.test(document.querySelector('#facts').textContent)")
    assert quick.is_disabled("#measure") and quick.is_hidden("#tape-says")
    with quick.expect_download() as download:
        quick.click("#record")
    header, poses = read_clip(Path(shutil.copy(download.value.path(), tmp_path / "hands.jsonl")))
    assert header["hand_length_m"] == 0.1 and len(list(poses)) >= 30


def test_a_clip_that_begins_under_a_recording_is_another_file(quick, tmp_path):
    """As another page of this machine's camera may begin one; here the length is changed behind the page's back."""
    quick.click("#record")
    until(quick, "/[1-9] frames recorded/.test(document.querySelector('#facts').textContent)")
    for length_m, act in (
        (0.1, "const field = document.querySelector('#length'); field.value = 12; field.onchange()"),
        (0.12, "document.querySelector('#record').click()"),
    ):
        until(quick, "/[1-9] frames recorded/.test(document.querySelector('#facts').textContent)")
        with quick.expect_download() as download:
            quick.evaluate(act)
        header, poses = read_clip(Path(shutil.copy(download.value.path(), tmp_path / f"{length_m}.jsonl")))
        assert header["hand_length_m"] == length_m and len(list(poses)) > 0


def test_a_hand_is_measured_again_after_a_recording_and_in_another_clip(quick):
    def measured() -> None:
        quick.click("#measure")
        until(quick, "/^Hand length/.test(document.querySelector('#tape-text').textContent)")
        until(quick, "!document.querySelector('#record').disabled")

    measured()
    quick.click("#record")
    assert quick.is_disabled("#measure")
    quick.click("#record")
    measured()
    quick.click("#stop")
    assert quick.is_disabled("#measure")
    quick.click("#webcam")
    until(quick, "!document.querySelector('#measure').disabled")
    measured()


@pytest.mark.parametrize(
    ("field", "change"), [("length", "value = 12"), ("fov", "value = 70"), ("mirrored", "checked = true")]
)
def test_a_change_while_a_hand_is_measured_frees_the_panel(quick, field, change):
    """Both in one task, so that no frame comes between."""
    changed = f"const field = document.querySelector('#{field}'); field.{change}; field.onchange()"
    quick.evaluate(f"document.querySelector('#measure').click(); {changed}")
    until(quick, "!document.querySelector('#measure').disabled")
    assert quick.is_enabled("#distance") and quick.is_hidden("#tape-says")


def test_a_dropped_video_is_tracked(page, tmp_path):
    clip = tmp_path / "moving.webm"
    with av.open(str(clip), "w") as container:
        stream = container.add_stream("libvpx", rate=2, options={"deadline": "realtime"})
        stream.width, stream.height, stream.pix_fmt = 640, 360, "yuv420p"
        for image in moving_hands(15):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    with live("--mirrored", "--hand-length", "12") as address:
        page.goto(address)
        assert page.is_checked("#mirrored") and page.input_value("#length") == "12"
        page.set_input_files("#file", clip)
        until(page, "/cm/.test(document.querySelector('#numbers').textContent)")
        until(page, "document.querySelector('#stop').disabled")
        assert page.inner_text("#source") == "moving.webm"
    assert page.problems == []


def test_pages_of_another_site_are_refused_and_the_documented_client_is_let_in(page, tmp_path):
    snippet = re.search(r"```javascript\n(.*?)```", (ROOT / "docs/stream.md").read_text(encoding="utf-8"), re.DOTALL)
    assert snippet is not None
    (tmp_path / "index.html").write_text("<!doctype html>a page")
    with other_site(tmp_path) as origin:
        for allowed in (False, True):
            with live(*(["--allow-origin", origin] if allowed else [])) as address:
                said = []
                page.on("console", lambda message, said=said: said.append(message.text))
                page.goto(origin)
                script = snippet[1].replace("ws://127.0.0.1:8765", address.replace("http:", "ws:").rstrip("/"))
                page.evaluate(f"{script}; globalThis.asked = stream")
                until(page, f"asked.readyState === {1 if allowed else 3}")
                if allowed:
                    viewer = page.context.new_page()
                    viewer.goto(address)
                    viewer.click("#webcam")
                    deadline = time.monotonic() + PATIENCE_MS / 1000
                    while not any("index fingertip" in text for text in said) and time.monotonic() < deadline:
                        page.wait_for_timeout(200)
                    assert any("index fingertip" in text for text in said)


def test_the_report_opens_from_disk_and_asks_nobody(page, tmp_path):
    frames = moving_hands(20)
    clip = lossless_clip(tmp_path / "clip.mov", frames, [index / 10 for index in range(20)])
    out = tmp_path / "out"
    assert main(["track", str(clip), "--out", str(out), "--fov", str(FOV_DEG)]) == 0
    _, poses = read_clip(out / "hands.jsonl")
    poses = list(poses)
    asked = []
    page.context.set_offline(True)
    page.route(re.compile(r"^(?!file:|blob:|data:)"), lambda route: route.abort())
    page.on("request", lambda request: asked.append(request.url))
    page.goto((out / "report.html").as_uri())
    page.click("summary")
    until(page, "document.querySelector('#joints').dataset.index === '0'")
    for index in (0, 7, 19):
        page.evaluate(f"document.querySelector('#seek').value = {index}; document.querySelector('#seek').oninput()")
        until(page, f"document.querySelector('#joints').dataset.index === '{index}'")
        np.testing.assert_allclose(joints_on_the_page(page)[1], joints(poses[index]), atol=1e-4, equal_nan=True)
        until_it_shows(page, frames, index)
    shots(page, "report")
    page.evaluate("document.querySelector('#seek').value = 0; document.querySelector('#seek').oninput()")
    page.click("#play")
    until(page, "Number(document.querySelector('#joints').dataset.index) >= 15")
    assert page.problems == []
    assert [url for url in asked if not url.startswith(("file:", "blob:", "data:"))] == []
    assert [url for url in asked if url.startswith("file:")] == [(out / "report.html").as_uri()]
