"""`scripts/sweep_decision.py`: every number alone, and networks that see each thing once."""

import numpy as np
from scripts.fit_handedness import COLUMNS
from scripts.sweep_decision import TRIED, Remembering, page, settings_of
from tests.oracles import Oracle, drawn_hands, make_card, restaged

from twohands.inference.decision import DecisionConfig


def test_every_setting_changes_one_number():
    settings = list(settings_of(DecisionConfig(candidate_threshold=0.06)))
    assert settings[0][2] == {} and len(settings) == 1 + sum(map(len, TRIED.values())) - 1
    for name, value, changes in settings[1:]:
        assert changes == {name: value} and (name, value) != ("candidate_threshold", 0.06)


def test_networks_see_each_crop_once_and_errors_are_counted():
    """True hands, with mirror images never and always seen: both hands are right, the mirrored crops are two more."""
    sample = drawn_hands(3)
    oracle = Oracle(sample, make_card(hand_logit=True))
    seen = []

    def locate(crops):
        seen.extend(crops)
        return oracle.true_maps(crops), np.where([crop.side == crop.mirrored for crop in crops], 8.0, -8.0)

    estimator = restaged(oracle.estimator, locate=locate, lift=lambda keypoints: oracle.canonical[keypoints.sides])
    decider = Remembering(estimator)
    rows = decider.errors(sample, [{}, {"mirror_below_logit": -99.0}, {"mirror_below_logit": 99.0}, {}])
    np.testing.assert_array_equal(rows, [[1, 2, 2, 0, 0, 0]] * 4)
    assert oracle.calls.count("hand_seg_net") == 1
    assert len(seen) == len({(crop.side, crop.image.tobytes()) for crop in seen}) == 4


def test_the_page_has_a_line_for_every_setting():
    settings = list(settings_of(DecisionConfig()))
    rows = np.arange(len(settings) * len(COLUMNS)).reshape(-1, len(COLUMNS))
    lines = page("fast@0", settings, rows).splitlines()
    assert "Weights fast@0. 0 pictures with 1 hands." in lines
    assert lines[-len(settings)] == "| as shipped |  | 2 | 3 | 4 | 5 |"
    assert lines[-1].startswith("| same_place_iou | 0.7 | ")
