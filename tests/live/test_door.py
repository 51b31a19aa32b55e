"""Who is let in: the rules of the page and the stream, one by one."""

import pytest

from twohands.errors import InputError
from twohands.live.door import Door, check_door

LOCAL, OPEN = Door(8765), Door(8765, token="abcdefgh")


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765"])
def test_this_machine_is_let_in(host):
    assert LOCAL.refusal({"host": host}, None) is None
    assert LOCAL.refusal({"host": host, "origin": f"http://{host}"}, None) is None


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://127.0.0.1:8766",
        "http://127.0.0.1",
        "null",
        "",
        "http://127.0.0.1:8765.evil.example",
    ],
)
def test_a_page_of_another_origin_is_refused(origin):
    assert "another origin" in (LOCAL.refusal({"host": "127.0.0.1:8765", "origin": origin}, None) or "")
    assert "another origin" in (OPEN.refusal({"host": "10.0.0.5:8765", "origin": origin}, "abcdefgh") or "")


def test_a_foreign_name_that_leads_here_is_refused():
    """DNS rebinding: the page's origin and the host agree, and are both not ours."""
    foreign = {"host": "evil.example:8765", "origin": "http://evil.example:8765"}
    assert "host name" in (LOCAL.refusal(foreign, None) or "")
    assert "host name" in (LOCAL.refusal({}, None) or "")


@pytest.mark.parametrize("token", [None, "", "abcdefgg", "abcdefgh ", "äbcdefgh"])
def test_others_need_the_token(token):
    assert "token" in (OPEN.refusal({"host": "10.0.0.5:8765"}, token) or "")


def test_with_the_token_any_host_name_of_the_machine_will_do():
    assert OPEN.refusal({"host": "10.0.0.5:8765", "origin": "http://10.0.0.5:8765"}, "abcdefgh") is None


def test_an_origin_may_be_allowed():
    door = Door(8765, origins=("http://localhost:3000",))
    assert door.refusal({"host": "127.0.0.1:8765", "origin": "http://localhost:3000"}, None) is None
    assert door.refusal({"host": "127.0.0.1:8765", "origin": "http://localhost:3001"}, None) is not None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("0.0.0.0", None, ()), "--host 0.0.0.0 lets others in: give them a --token"),
        (("192.168.0.4", "short", ()), "--token must be at least 8"),
        (("127.0.0.1", "with space", ()), "--token must be at least 8"),
        (("127.0.0.1", None, ("localhost:3000",)), "--allow-origin localhost:3000: an origin such as"),
        (("127.0.0.1", None, ("http://a/b",)), "an origin such as"),
        (("127.0.0.1", None, ("*",)), "an origin such as"),
    ],
)
def test_a_door_that_stands_open_is_refused(arguments, message):
    with pytest.raises(InputError, match=message.replace("*", r"\*")):
        check_door(*arguments)


def test_a_door_that_is_none():
    check_door("127.0.0.1", None, ())
    check_door("0.0.0.0", "abcdefgh", ("https://hands.example",))
