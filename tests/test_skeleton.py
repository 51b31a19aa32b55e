"""Laws of the skeleton, and the other joint orders spelled out by name."""

import pytest

from twohands import skeleton as sk


def test_names():
    assert len(sk.JOINT_NAMES) == sk.N_JOINTS == 21 == len(set(sk.JOINT_NAMES))
    assert sk.JOINT_NAMES[sk.WRIST] == "wrist"
    assert sk.JOINT_NAMES[sk.ROOT] == "middle_1"
    assert sk.JOINT_NAMES[sk.LITTLE_MCP] == "little_1"
    assert [sk.JOINT_NAMES[tip] for tip in sk.FINGERTIPS] == [f"{finger}_4" for finger in sk.FINGERS]
    assert sk.JOINT_NAMES[1:9] == (
        "thumb_1",
        "thumb_2",
        "thumb_3",
        "thumb_4",
        "index_1",
        "index_2",
        "index_3",
        "index_4",
    )


def test_parents_form_five_chains_from_the_wrist():
    assert sk.PARENTS[sk.WRIST] == -1
    for tip in sk.FINGERTIPS:
        chain = [tip]
        while chain[-1] != sk.WRIST:
            chain.append(sk.PARENTS[chain[-1]])
        assert chain == [tip, tip - 1, tip - 2, tip - 3, sk.WRIST]


def test_bones():
    """The 20 of paper Eq. 2: 0-1, 1-2, ..; 0-5, ..; 0-9, ..; 0-13, ..; 0-17, .."""
    assert len(sk.BONES) == len(set(sk.BONES)) == 20
    assert {bone for bone in sk.BONES if 0 in bone} == {(0, 1), (0, 5), (0, 9), (0, 13), (0, 17)}
    assert all(parent == child - 1 or parent == 0 for parent, child in sk.BONES)
    assert sk.KEY_BONES == ((0, 9), (17, 9))


@pytest.mark.parametrize("name", ["FROM_STB", "FROM_RHD", "FROM_INTERHAND"])
def test_maps_are_permutations(name):
    assert sorted(getattr(sk, name)) == list(range(21))


def finger(name, order):
    return [f"{name}_{i}" for i in order]


UP, DOWN = (1, 2, 3, 4), (4, 3, 2, 1)
"""Base to tip, tip to base."""


@pytest.mark.parametrize(
    ("name", "theirs"),
    [
        ("FROM_STB", ["wrist", *(j for f in reversed(sk.FINGERS) for j in finger(f, UP))]),
        ("FROM_RHD", ["wrist", *(j for f in sk.FINGERS for j in finger(f, DOWN))]),
        ("FROM_INTERHAND", [*(j for f in sk.FINGERS for j in finger(f, DOWN)), "wrist"]),
    ],
)
def test_maps_by_name(name, theirs):
    """ours = theirs[m], with their order written in words (docs/datasets.md)."""
    assert tuple(theirs[i] for i in getattr(sk, name)) == sk.JOINT_NAMES


def test_part_labels():
    """1..7 the left hand, 8..14 the right, in the order arm, palm, thumb .. little (docs/dataset-format.md)."""
    labels = [sk.part_label(side, part) for side in (sk.LEFT, sk.RIGHT) for part in range(len(sk.PART_NAMES))]
    assert labels == list(range(1, sk.N_PART_LABELS))
    assert sk.part_label(sk.LEFT, sk.PART_NAMES.index("arm")) == 1
    assert sk.part_label(sk.RIGHT, sk.PART_NAMES.index("little")) == 14
    assert sk.SIDES[sk.LEFT] == "left" and sk.SIDES[sk.RIGHT] == "right"
