"""Eight hundred damaged files, the same every time: no traceback, no hang, nothing left behind, one line each."""

import pytest
from tests.fuzz.mutations import KINDS, Workshop

COUNTS = {"camera": 80, "dataset": 50, "picture": 90, "prediction": 60, "weights": 20, "motion": 500}


@pytest.fixture(scope="module")
def shop(tmp_path_factory) -> Workshop:
    return Workshop(tmp_path_factory.mktemp("fuzz"))


def test_every_kind_has_its_share():
    assert COUNTS.keys() == KINDS.keys() and sum(COUNTS.values()) == 800


@pytest.mark.parametrize("kind", sorted(COUNTS))
def test_damaged_files_are_named_in_one_line(shop, kind):
    attempts = [shop.attempt(kind, seed) for seed in range(COUNTS[kind])]
    assert [attempt for attempt in attempts if attempt.problem is not None] == []


@pytest.mark.parametrize("kind", sorted(COUNTS))
def test_the_undamaged_files_are_taken(shop, kind, monkeypatch):
    """Or nothing would be tested but the first check of each reader."""
    monkeypatch.setattr("tests.fuzz.mutations.damaged_bytes", lambda data, rng: data)
    monkeypatch.setattr("tests.fuzz.mutations.damaged_text", lambda data, rng: data)
    for seed in range(8):
        attempt = shop.attempt(kind, seed)
        assert attempt.problem is None and any((shop.folder / "work" / "out").glob("*")), attempt


@pytest.mark.parametrize(
    ("kind", "seed"),
    [
        ("weights", 1648),
        ("camera", 4685),
        ("prediction", 10043),
        ("dataset", 3506),
        ("dataset", 10239),
        ("prediction", 10557),
        ("weights", 11909),
    ],
)
def test_what_longer_runs_found_stays_mended(shop, kind, seed):
    """1648: OpenVINO's own message about a damaged name was no text. 4685, 10043, 10239, 10557: numpy's warning came
    out, too. 11909: a network answered in another shape. 3506: a part of a PNG announced 4 GB."""
    assert shop.attempt(kind, seed).problem is None
