"""The stream over a real socket: lines to everybody, pictures from one, and every rule of the door."""

import contextlib
import itertools
import json
import re
import struct
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("starlette")
pytest.importorskip("uvicorn")
pytest.importorskip("websockets")
from tests.live.fakes import IMAGE, estimate, make_clip, picture, seen_hand, serving
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.sync.client import connect

from twohands.errors import InputError
from twohands.inference.frames import Frame
from twohands.live import server
from twohands.live.measuring import FRAMES
from twohands.live.messages import MAX_BYTES
from twohands.live.server import MAX_CLIENTS, listen
from twohands.live.worker import Worker

BEGIN = json.dumps({"begin": {"source": "test", "hand_length_m": 0.1, "fov_deg": 60}})
WAIT_S = 300
DOCS = Path(__file__).resolve().parents[2] / "docs/stream.md"


def join(port: int, query: str = "", **options):
    return connect(f"ws://127.0.0.1:{port}/stream{query}", **({"open_timeout": WAIT_S} | options))


def receive(socket):
    return socket.recv(timeout=WAIT_S)


def get(port: int, path: str = "/", **headers: str):
    request = urllib.request.Request(f"http://127.0.0.1:{port}{path}", headers=headers)
    return urllib.request.urlopen(request, timeout=WAIT_S)


def counting(monkeypatch, owner, name: str) -> threading.Semaphore:
    """Released whenever a function of the server has done its work. The pong of a ping comes sooner: it says that what
    was sent before has arrived, not that it has been read."""
    calls, function = threading.Semaphore(0), getattr(owner, name)

    def counted(*arguments):
        try:
            return function(*arguments)
        finally:
            calls.release()

    monkeypatch.setattr(owner, name, counted)
    return calls


def documented(code: str, port: int) -> threading.Thread:
    """A client of docs/stream.md, running against this port."""
    program = compile(code.replace("127.0.0.1:8765", f"127.0.0.1:{port}"), "docs/stream.md", "exec")
    client = threading.Thread(target=exec, args=(program, {}))
    client.start()
    return client


def until_it_listens() -> Iterator[int]:
    """Numbers, twenty a second, as long as it may take a client to come."""
    until = time.monotonic() + WAIT_S
    for index in itertools.count():
        yield index
        assert time.monotonic() < until
        time.sleep(0.05)


def test_the_documented_client_in_python(capsys):
    """It prints a fingertip, and ends when the server does."""
    code = re.search(r"### Python\n\n```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    assert code is not None
    with serving() as port:
        reader = documented(code[1], port)
        with join(port) as sender:
            sender.send(BEGIN)
            for index in until_it_listens():
                sender.send(picture(index / 10))
                receive(sender)
                if "index fingertip" in (said := capsys.readouterr().out):
                    break
    reader.join(WAIT_S)
    assert not reader.is_alive() and "left index fingertip: 0.008 0.008 0.508 m" in said


def test_the_documented_client_for_ros(monkeypatch):
    """It publishes every joint, in metres; rclpy and its messages are stand-ins that take what the real ones take."""
    published: list[tuple[str, list[list[float]], str]] = []

    class Point:
        def __init__(self, **axes: float) -> None:
            assert set(axes) == {"x", "y", "z"} and all(type(value) is float for value in axes.values())
            self.axes = [axes[name] for name in "xyz"]

    class Pose:
        def __init__(self, *, position: Point) -> None:
            self.position = position

    class PoseArray:
        def __init__(self, *, poses: list[Pose]) -> None:
            assert all(isinstance(pose, Pose) for pose in poses)
            self.poses, self.header = poses, SimpleNamespace(frame_id="", stamp=None)

    def publisher(kind, topic: str, depth: int):
        assert kind is PoseArray and depth == 1

        def publish(message: PoseArray) -> None:
            assert message.header.stamp == "now"
            published.append((topic, [pose.position.axes for pose in message.poses], message.header.frame_id))

        return SimpleNamespace(publish=publish)

    clock = SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))
    node = SimpleNamespace(create_publisher=publisher, get_clock=lambda: clock)
    ros = SimpleNamespace(init=lambda: None, create_node=lambda name: node)
    monkeypatch.setitem(sys.modules, "rclpy", ros)
    messages = SimpleNamespace(Point=Point, Pose=Pose, PoseArray=PoseArray)
    monkeypatch.setitem(sys.modules, "geometry_msgs", SimpleNamespace(msg=messages))
    monkeypatch.setitem(sys.modules, "geometry_msgs.msg", messages)
    code = re.search(r"### ROS 2, rclpy\n.*?```python\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    assert code is not None
    with serving() as port:
        reader = documented(code[1], port)
        with join(port) as sender:
            sender.send(BEGIN)
            for index in until_it_listens():
                sender.send(picture(index / 10))
                told = receive(sender)
                if published:
                    break
            while "hands" not in json.loads(told):
                told = receive(sender)
    reader.join(WAIT_S)
    assert not reader.is_alive()
    assert published[0] == ("hands/left", json.loads(told)["hands"]["left"]["joints_m"], "camera_optical_frame")


def test_everybody_gets_header_and_lines():
    with serving() as port, join(port) as sender, join(port) as other:
        sender.send(BEGIN)
        for index in range(3):
            sender.send(picture(index / 10))
            mine = [receive(sender) for _ in range(2 if index == 0 else 1)]
            theirs = [receive(other) for _ in range(2 if index == 0 else 1)]
            assert mine == theirs
        last = json.loads(mine[-1])
        assert (last["index"], last["time_s"]) == (2, 0.2) and set(last["hands"]) == {"left", "right"}
        sender.send(BEGIN)  # a new clip: the header comes again
        sender.send(picture(0.0))
        assert json.loads(receive(other))["version"] == 2 and json.loads(receive(other))["index"] == 0


def test_pictures_come_before_their_lines_to_those_who_want_them():
    with (
        serving() as port,
        join(port, "?pictures=1") as sender,
        join(port, "?pictures=1") as viewer,
    ):
        sender.send(BEGIN)
        sender.send(picture(0.5))
        header, message, line = (receive(viewer) for _ in range(3))
        time_s, age_s = struct.unpack_from("<dd", message)
        assert (time_s, message[16:]) == (0.5, picture(0.5)[8:]) and 0 <= age_s < WAIT_S
        assert [receive(sender), receive(sender)] == [header, line]  # its own picture does not come back


def test_measuring_is_told_to_who_asked_and_everybody_gets_the_new_clip():
    with serving(make_clip(seen_hand(0.4))) as port, join(port) as sender, join(port) as other:
        sender.send(BEGIN)
        sender.send(json.dumps({"measure": {"distance_m": 0.5}}))
        notes, headers = [], []
        for index in range(FRAMES + 1):
            sender.send(picture(index / 10))
            while "index" not in (line := json.loads(receive(other))):
                headers.append(line)
            while "index" not in (mine := json.loads(receive(sender))):
                notes += [mine["measured"]] if "measured" in mine else []
        assert line == mine and notes[-1]["hand_length_m"] is not None
        assert [header["hand_length_m"] for header in headers] == [0.1, notes[-1]["hand_length_m"]]


def test_a_measuring_before_a_clip_is_refused():
    with serving() as port, join(port) as client, pytest.raises(ConnectionClosed) as closed:
        client.send('{"measure": {"distance_m": 0.5}}')
        receive(client)
    assert closed.value.rcvd is not None and "a clip must begin first" in closed.value.rcvd.reason


def test_late_pictures_are_dropped_not_queued(monkeypatch):
    """While one is estimated three more come: the newest alone is estimated next."""
    begun, go_on, arrived = threading.Event(), threading.Event(), counting(monkeypatch, Worker, "put")

    def slow(*arguments, **options):
        begun.set()
        assert go_on.wait(WAIT_S)
        return estimate(*arguments, **options)

    with serving(make_clip(slow)) as port, join(port) as sender:
        sender.send(BEGIN)
        sender.send(picture(0.0))
        assert begun.wait(WAIT_S)
        for index in (1, 2, 3):
            sender.send(picture(index / 10))
        assert all(arrived.acquire(timeout=WAIT_S) for _ in range(4))
        go_on.set()
        receive(sender)
        indices = [json.loads(receive(sender))["index"]]
        if indices == [0]:  # or else its line was late itself
            indices.append(json.loads(receive(sender))["index"])
        assert indices[-1] == 3 and 1 not in indices and 2 not in indices


@pytest.mark.parametrize(
    ("messages", "reason"),
    [
        ([picture(0.0)], "a clip must begin first"),
        (["nonsense"], "JSON"),
        ([BEGIN.replace("0.1", "-1")], "hand_length_m"),
        ([BEGIN, b"12345678no picture"], "JPEG, PNG or WebP"),
        ([BEGIN, picture(1.0), picture(0.5)], "time"),
        ([BEGIN, picture(0.0), picture(0.1, IMAGE[:, :40])], "the size changes"),
    ],
)
def test_what_is_no_message_closes_with_its_reason(messages, reason):
    with serving() as port, join(port) as client:
        seen = []
        with pytest.raises(ConnectionClosed) as closed:
            for message in messages:
                client.send(message)
                if message is not messages[-1] and isinstance(message, bytes):
                    seen += [receive(client), receive(client)]
            while True:
                receive(client)
        assert closed.value.rcvd is not None and reason in closed.value.rcvd.reason
        with join(port) as next_one:  # and nobody else has noticed
            next_one.send(BEGIN)
            next_one.send(picture(0.0))
            assert "version" in json.loads(receive(next_one))


def test_messages_over_two_megabytes_are_refused():
    with serving() as port, join(port) as client, pytest.raises(ConnectionClosed) as closed:
        client.send(BEGIN)
        client.send(bytes(MAX_BYTES + 1))
        receive(client)
    assert closed.value.rcvd is not None and closed.value.rcvd.code == 1009


def test_the_ninth_client_is_refused_until_one_leaves():
    with serving() as port:
        with contextlib.ExitStack() as clients:
            for _ in range(MAX_CLIENTS):
                clients.enter_context(join(port))
            with join(port) as ninth, pytest.raises(ConnectionClosed) as closed:
                receive(ninth)
            assert closed.value.rcvd is not None and closed.value.rcvd.code == 1013
        for _ in until_it_listens():  # the server may learn a little later that they have left
            with contextlib.suppress(ConnectionClosed), join(port) as again:
                again.send(BEGIN)
                again.send(picture(0.0))
                assert "version" in json.loads(receive(again))
                break


def test_one_camera_at_a_time_and_the_next_when_it_has_ended(monkeypatch):
    read = counting(monkeypatch, server, "parse_text")
    with serving() as port, join(port) as first, join(port) as second:
        first.send(BEGIN)
        assert read.acquire(timeout=WAIT_S)
        second.send(BEGIN)
        with pytest.raises(ConnectionClosed) as closed:
            receive(second)
        assert closed.value.rcvd is not None and "another client is sending" in closed.value.rcvd.reason
        assert read.acquire(timeout=WAIT_S)
        first.send('{"end": true}')
        assert read.acquire(timeout=WAIT_S)
        with join(port) as third:
            third.send(BEGIN)
            third.send(picture(0.0))
            assert "version" in json.loads(receive(third))


@pytest.mark.parametrize("origin", ["http://evil.example", "http://localhost:1", "null"])
def test_pages_of_another_origin_are_refused(origin):
    with serving() as port, pytest.raises(InvalidStatus) as refused:
        join(port, origin=origin).__enter__()
    assert refused.value.response.status_code == 403


def test_our_own_page_and_an_allowed_one_are_let_in():
    with serving(origins=("http://localhost:3000",)) as port:
        for origin in (f"http://127.0.0.1:{port}", "http://localhost:3000"):
            with join(port, origin=origin) as client:
                assert client.ping().wait(WAIT_S)


def test_the_token_is_asked_for():
    with serving(token="abcdefgh") as port:
        with join(port, "?token=abcdefgh") as client:
            assert client.ping().wait(WAIT_S)
        for query in ("", "?token=abcdefgi"):
            with pytest.raises(InvalidStatus):
                join(port, query).__enter__()
            with pytest.raises(urllib.error.HTTPError) as refused:
                get(port, f"/{query}")
            assert refused.value.code == 403
        assert get(port, "/?token=abcdefgh").status == 200


def test_there_is_one_page_and_no_file():
    with serving() as port:
        with get(port) as answer:
            assert answer.read() == b"<!doctype html>page"
            assert answer.headers["Content-Security-Policy"] == "default-src 'none'"
            assert answer.headers["X-Frame-Options"] == "DENY" and answer.headers["Referrer-Policy"] == "no-referrer"
        for path in ("/etc/passwd", "/../pyproject.toml", "/view.js", "/%2e%2e/%2e%2e/etc/passwd", "/stream"):
            with pytest.raises(urllib.error.HTTPError) as missing:
                get(port, path)
            assert missing.value.code == 404
        with pytest.raises(urllib.error.HTTPError) as refused:
            get(port, Host="evil.example")
        assert refused.value.code == 403


def test_the_camera_of_this_machine(monkeypatch):
    """Its pictures and lines come to everybody; settings begin a new clip; nobody else's pictures are taken."""
    go_on, begun = threading.Semaphore(0), counting(monkeypatch, Worker, "begin")

    def frames():
        for index in range(100):
            go_on.acquire()
            yield Frame(IMAGE, index, index / 30)

    with serving(camera=("camera:0", frames())) as port, join(port, "?pictures=1") as viewer:
        viewer.ping().wait(WAIT_S)
        go_on.release()
        header, message, line = (receive(viewer) for _ in range(3))
        assert json.loads(header)["source"] == "stream" and json.loads(line)["index"] == 0
        assert message[16:18] == b"\xff\xd8"
        viewer.send(BEGIN)
        assert begun.acquire(timeout=WAIT_S)
        go_on.release()
        changed = json.loads(receive(viewer))
        assert (changed["version"], changed["source"]) == (2, "camera:0")
        viewer.send(picture(0.0))
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                receive(viewer)
        assert closed.value.rcvd is not None and "this machine's camera" in closed.value.rcvd.reason
        go_on.release(100)


def test_when_the_camera_ends_all_is_closed():
    with serving(camera=("camera:0", iter([]))) as port, pytest.raises(OSError):
        for _ in until_it_listens():  # until it has ended
            with contextlib.suppress(WebSocketException):  # it ends while it answers
                join(port).close()


def test_a_port_in_use_is_one_line():
    with listen("127.0.0.1", 0) as taken:
        taken.listen()
        with pytest.raises(InputError, match="try another --port"):
            listen("127.0.0.1", taken.getsockname()[1])
    for host, port in (("127.0.0.1", 70000), ("127.0.0.1", -1), ("no such host", 0), ("192.0.2.1", 0)):
        with pytest.raises(InputError, match=r"cannot be used|must lie between"):
            listen(host, port)
