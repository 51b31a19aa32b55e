"""Names and topology of the hand skeleton: the only place that knows what joint index means what.

Joint order is that of OpenPose and MediaPipe: the wrist, then four joints per finger from base to tip.
Two-hand arrays have the axis order (LEFT, RIGHT): the person's own hands in an unmirrored image.
"""

from __future__ import annotations

from typing import Final

LEFT: Final = 0
RIGHT: Final = 1
SIDES: Final = ("left", "right")

FINGERS: Final = ("thumb", "index", "middle", "ring", "little")
JOINT_NAMES: Final = ("wrist", *(f"{finger}_{i}" for finger in FINGERS for i in range(1, 5)))
N_JOINTS: Final = 21

WRIST: Final = 0
ROOT: Final = 9
"""Root joint: the middle finger's knuckle (mMCP), origin of the canonical frame."""
INDEX_MCP: Final = 5
LITTLE_MCP: Final = 17
PALM: Final = (WRIST, INDEX_MCP, ROOT, 13, LITTLE_MCP)
"""Wrist and the four fingers' knuckles, which hardly move against each other."""
FINGERTIPS: Final = (4, 8, 12, 16, 20)

PARENTS: Final = (-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 0, 13, 14, 15, 0, 17, 18, 19)
"""Parent of every joint; -1 for the wrist."""
BONES: Final = tuple((parent, child) for child, parent in enumerate(PARENTS) if parent >= 0)
"""The 20 bones (parent, child) over which the bone-length loss and error run (paper Eq. 2)."""

KEY_BONES: Final = ((WRIST, ROOT), (LITTLE_MCP, ROOT))
"""Candidates for the key bone of the global projection: (secondary joint, root joint)."""

ELBOW: Final = 0
"""Index of the elbow in 22-joint arrays; such arrays are (elbow, 21 hand joints)."""

PART_NAMES: Final = ("arm", "palm", *FINGERS)
N_PART_LABELS: Final = 15
"""Label images: 0 is background, 1..7 are the left hand's PART_NAMES, 8..14 the right hand's."""


def part_label(side: int, part: int) -> int:
    """Label value of one part.

    Args:
        side: LEFT or RIGHT.
        part: index into PART_NAMES, 0..6.

    Returns:
        The label, 1..14.
    """
    return 1 + side * len(PART_NAMES) + part


# Other orders. Each map m holds, for every joint of ours, its index there: ours = theirs[..., m, :].
FROM_STB: Final = (0, 17, 18, 19, 20, 13, 14, 15, 16, 9, 10, 11, 12, 5, 6, 7, 8, 1, 2, 3, 4)
"""STB: palm centre (not wrist), then little..thumb, base to tip (docs/datasets.md)."""
FROM_RHD: Final = (0, 4, 3, 2, 1, 8, 7, 6, 5, 12, 11, 10, 9, 16, 15, 14, 13, 20, 19, 18, 17)
"""RHD/RHP: wrist, then thumb..little, each tip to base (docs/datasets.md)."""
FROM_INTERHAND: Final = (20, 3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12, 19, 18, 17, 16)
"""InterHand2.6M, one hand of 21: thumb..little, each tip to base, wrist last."""
