"""Profiles: where they lie, the round trip, and files that are none."""

import json
from pathlib import Path

import pytest

from twohands.errors import DataFormatError, InputError
from twohands.formats.profiles import Profile, profile_bytes, profile_path, read_profile
from twohands.types import PinholeCamera

CAMERA = PinholeCamera(700.0, 701.0, 488.5, 262.0, 960, 540, (0.1, -0.2, 0.0, 0.001))


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return tmp_path


def keep(name: str, content: bytes) -> Path:
    path = profile_path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def test_they_lie_in_the_config_folder(home: Path, monkeypatch):
    assert profile_path("desk") == home / "twohands" / "profiles" / "desk.json"
    monkeypatch.setenv("XDG_CONFIG_HOME", "relative")  # the standard says to ignore it then
    monkeypatch.setenv("HOME", str(home / "me"))
    assert profile_path("desk") == home / "me" / ".config" / "twohands" / "profiles" / "desk.json"


@pytest.mark.parametrize("name", ["", "../desk", "a/b", ".hidden", "x" * 65, "desk\n"])
def test_names_lead_nowhere_else(name: str):
    with pytest.raises(InputError, match="a name of letters"):
        profile_path(name)


@pytest.mark.parametrize(
    "profile",
    [
        Profile(CAMERA, "board", 0.112, "distance"),
        Profile(CAMERA, "board"),
        Profile(hand_length_m=0.1, scale_source="board"),
        Profile(),
    ],
)
def test_what_is_read_is_what_was_kept(profile: Profile):
    keep("desk", profile_bytes(profile))
    assert read_profile("desk") == profile


def test_a_profile_that_is_not_there_is_named_with_the_remedy():
    with pytest.raises(InputError, match=r"no profile 'desk' \(.*desk.json\); make one: twohands calibrate"):
        read_profile("desk")


@pytest.mark.parametrize(
    "change",
    [
        {"version": 2},
        {"more": 1},
        {"hand_length_m": -0.1},
        {"hand_length_m": "long"},
        {"scale_source": None},
        {"scale_source": "guessed"},
        {"camera": None},
        {"camera": {"fx": 1}},
        {"camera": []},
        {"camera": {"fx": -700, "fy": 700, "cx": 1, "cy": 1, "width": 9, "height": 9}},
    ],
)
def test_other_content_is_refused_with_the_file(change):
    record = json.loads(profile_bytes(Profile(CAMERA, "file", 0.112, "typed"))) | change
    path = keep("desk", json.dumps(record).encode())
    with pytest.raises(DataFormatError, match=str(path)):
        read_profile("desk")
