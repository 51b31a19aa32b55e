"""Laws of gestures, on the average body and a trunk made of points."""

from dataclasses import replace

import numpy as np
import pytest

from twohands.skeleton import LEFT, RIGHT
from twohands.synth.scene import arm_goals, gestures, pair_gestures
from twohands.synth.scene.arm_goals import ArmGoal
from twohands.synth.scene.body import ARM_BONES, load_asset
from twohands.synth.scene.gestures import Stage
from twohands.synth.scene.outline import Outline
from twohands.synth.scene.pose import ANGLE_LIMITS, ArmAnatomy, rotation_about, unit

BODY = load_asset().body()
STILL = np.eye(3, 4)
ONE_HAND = [
    *(gestures.hanging, gestures.on_table, gestures.writing, gestures.shown, gestures.open_palm, gestures.signing),
    *(gestures.talking, gestures.pointing, gestures.thumb_up, gestures.at_face, gestures.at_ear, gestures.on_chest),
    *(gestures.holding, gestures.holding_flat, gestures.reading_phone, gestures.reaching_down, gestures.behind_back),
]
BOTH_HANDS = [
    *(pair_gestures.praying, pair_gestures.clapping, pair_gestures.clasped, pair_gestures.steepled),
    *(pair_gestures.stacked, pair_gestures.framing, pair_gestures.folded, pair_gestures.both_at_face),
    pair_gestures.holding_between,
]


def trunk() -> Outline:
    """A box: 30 cm wide, from the chin down, 22 cm deep."""
    x, y, z = np.meshgrid(np.arange(-0.15, 0.151, 0.01), np.arange(0.2, 0.9, 0.01), [-0.22, 0.0])
    return Outline.of(np.stack([x, y, z], -1).reshape(-1, 3), 0.0)


def stage(side: int) -> Stage:
    anatomy, mirror = ArmAnatomy(BODY, side), np.array([-1.0 if side == LEFT else 1.0, 1, 1])
    camera = np.array([0.0, 0.1, 0.9])
    return Stage(side, anatomy.shoulder * mirror, anatomy.max_reach, trunk(), np.eye(3), camera, False, 0.44)


@pytest.mark.parametrize("gesture", ONE_HAND, ids=lambda gesture: gesture.__name__)
def test_most_people_can_make_every_gesture(gesture):
    fits = []
    for seed in range(12):
        goal = gesture(stage(RIGHT), np.random.default_rng(seed))
        fits.append(arm_goals.solved(ArmAnatomy(BODY, RIGHT), goal, STILL).fits.any())
    assert np.mean(fits) > 0.6


@pytest.mark.parametrize("gesture", [gestures.shown, gestures.open_palm], ids=lambda gesture: gesture.__name__)
def test_short_arms_show_hands_too(gesture):
    """Frames of people with seed 90006 ended at a person whose arms were shorter than the nearest place."""
    short = replace(stage(RIGHT), reach_m=0.28)
    for seed in range(12):
        assert np.isfinite(gesture(short, np.random.default_rng(seed)).place).all()


@pytest.mark.parametrize("pair", BOTH_HANDS, ids=lambda pair: pair.__name__)
def test_both_hands_make_every_gesture_together(pair):
    fits = []
    for seed in range(12):
        goals = pair(stage(LEFT), stage(RIGHT), np.random.default_rng(seed)).goals
        arms = []
        for side, goal in enumerate(goals):
            m = np.array([-1.0 if side == LEFT else 1.0, 1, 1])
            goal = ArmGoal(
                goal.place * m, goal.along * m, goal.palm * m, goal.elbow * m, goal.angles, goal.at, goal.slack
            )
            arms.append(arm_goals.solved(ArmAnatomy(BODY, side), goal, STILL).fits)
        fits.append((arms[0] & arms[1]).any())
    assert np.mean(fits) > 0.6


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_a_solved_arm_puts_the_hand_where_and_as_it_was_asked(side):
    """Where the wrist's limits allow the orientation, the point is in place and the hand lies as asked."""
    anatomy, n = ArmAnatomy(BODY, side), arm_goals.CANDIDATES
    goal = gestures.talking(stage(side), np.random.default_rng(3))
    m = np.array([-1.0 if side == LEFT else 1.0, 1, 1])
    goal = ArmGoal(goal.place * m, goal.along * m, goal.palm * m, goal.elbow * m, goal.angles, goal.at, slack=0.02)
    shoulder = np.c_[rotation_about(np.array([0.0, 0, 1]), 0.1), [0.01, -0.02, 0.0]]
    arms = arm_goals.solved(anatomy, goal, shoulder)
    assert 0 < arms.fits.sum() <= n
    places = np.einsum("j,nja->na", goal.at, arms.joints)
    assert np.abs(places - goal.place)[arms.fits].max() < 0.006
    along = unit(arms.joints[:, 1 + 9] - arms.joints[:, 1])
    assert (along * goal.along).sum(-1)[arms.fits].min() > np.cos(0.03)


def test_wrists_stay_within_their_limits():
    """The forearm's turn is shared out; together both parts are within the range of `ANGLE_LIMITS`."""
    anatomy = ArmAnatomy(BODY, RIGHT)
    goal = gestures.signing(stage(RIGHT), np.random.default_rng(0))
    rotations = arm_goals.solved(anatomy, goal, STILL).rotations
    half = rotations[:, ARM_BONES.index("lowerarm02")]
    turn = np.arccos(np.clip((np.trace(half, axis1=1, axis2=2) - 1) / 2, -1, 1)) / arm_goals.SHARE_OF_TWIST
    widest = np.abs(ANGLE_LIMITS[0] - anatomy.pronation_rest).max()
    assert turn.max() <= widest + 1e-6


def test_an_outline_knows_in_and_out():
    """5 cm into the box from the front, from the side and beside it; the grid is 2 cm wide."""
    depth = trunk().depth(np.array([[0.0, 0.5, -0.05], [0.1, 0.5, -0.11], [0.3, 0.5, -0.1], [0.0, 0.5, 0.1]]))
    assert 0.03 < depth[0] < 0.07 and 0.02 < depth[1] < 0.08
    assert depth[2] < 0 and depth[3] < -0.05


def test_hands_in_the_lap_enter_thighs():
    thighs = np.array([[[-0.1, 0.7, 0], [-0.1, 0.7, 0.4]], [[0.1, 0.7, 0], [0.1, 0.7, 0.4]]])
    nowhere = np.full((72, 36), -np.inf)
    outline = Outline(nowhere, -nowhere, nowhere, thighs, 0.08)
    np.testing.assert_allclose(outline.depth(np.array([[0.1, 0.65, 0.2], [0.1, 0.5, 0.2]])), [0.03, -0.12])
