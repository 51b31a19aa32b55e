"""Weights folders: cards, networks in the wrong place, and the compiled networks themselves."""

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.oracles import write_tiny_weights

from twohands.errors import CheckpointError
from twohands.inference.decision import DecisionConfig, PictureView, PlacementConfig, ViewConfig
from twohands.inference.engine import load_networks
from twohands.inference.estimator import HandEstimator
from twohands.inference.weights import (
    DEFAULT_PRESET,
    NETWORK_NAMES,
    WeightsCard,
    network_files,
    preset_folder,
    preset_names,
    read_card,
    second_folder,
    weights_id,
)
from twohands.types import PinholeCamera


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny")


@pytest.fixture
def copied(tiny, tmp_path):
    return shutil.copytree(tiny, tmp_path / "copy")


def test_the_card(tiny):
    card = read_card(tiny)
    assert (card.name, card.seg_input_size, card.crop_size, card.crop_kind) == ("tiny", (48, 80), 32, "square")
    assert preset_folder(tiny) == tiny and preset_folder(str(tiny)) == tiny


def test_the_shipped_presets_are_complete():
    names = preset_names()
    if not names:
        pytest.skip("no weights are shipped yet")
    assert DEFAULT_PRESET in names
    for name in names:
        card = read_card(preset_folder(name))
        assert card.name == name
        networks = load_networks(preset_folder(name), card)
        assert bool(card.second) == bool(card.decision.second), "its second networks are never asked, or not there"
        if networks.second is not None:
            second = second_folder(preset_folder(name), card)
            assert networks.second.card.name == second.name == card.second and card.second not in names
            files = [path.name for path in sorted(second.glob("*.onnx"))]
            assert files == ["hand_check.onnx", "pose_net_2d.onnx", "pose_net_3d.onnx"]
            assert networks.second.hand_check is not None
            assert {"check_short", "check_unseen"} <= set(card.decision.last), "HandCheck is there and has no say"


def test_a_folder_is_taken_before_a_shipped_preset_of_its_name(tiny, tmp_path, monkeypatch):
    """Named case: a folder called "fast" was never read, even where a path asked for it."""
    if DEFAULT_PRESET not in preset_names():
        pytest.skip("no weights are shipped yet")
    shipped = preset_folder(DEFAULT_PRESET)
    shutil.copytree(tiny, tmp_path / DEFAULT_PRESET)
    monkeypatch.chdir(tmp_path)
    assert preset_folder(Path(DEFAULT_PRESET)) == Path(DEFAULT_PRESET)
    assert preset_folder(f"./{DEFAULT_PRESET}").resolve() == tmp_path / DEFAULT_PRESET
    assert preset_folder(DEFAULT_PRESET) == shipped


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda card: card.pop("name"), "'name' is missing"),
        (lambda card: card["pose_net_2d"].pop("crop_size"), "'crop_size' is missing"),
        (lambda card: card.update(version=9), "version 2 expected, found 9"),
        (lambda card: card["pose_net_2d"].update(crop_kind="round"), "crop_kind must be one of"),
        (lambda card: card["pose_net_2d"].update(crop_margin=0), "crop_margin must be positive"),
        (lambda card: card["pose_net_2d"].update(crop_size=0), "crop_size must be 1 to"),
        (lambda card: card["pose_net_2d"].update(surround=16), "surround must leave some of the crop's 32 pixels"),
        (lambda card: card["pose_net_2d"].update(heatmap_decode="guess"), "heatmap_decode must be one of"),
        (lambda card: card["hand_seg_net"].update(input_size=[48]), "card: "),
        (lambda card: card["hand_seg_net"].update(input_size=[0, 80]), "height, width"),
        (lambda card: card["hand_seg_net"].update(input_size=[float("inf"), 80]), "card: "),
        (lambda card: card.update(hand_seg_net=3), "card: "),
        (lambda card: card.update(int8=["hand_seg_net"]), "card: "),
        (lambda card: card.update(int8={"hand_net": {}}), "int8 names unknown networks, hand_net"),
        (lambda card: card.update(int8={"hand_seg_net": {"relu": 0}}), "peaks larger than 0"),
        (lambda card: card["pose_net_2d"].update(cues=-1), "cues must not be negative"),
        (lambda card: card["views"].update(tta_score_range=[0.5]), "tta_score_range must be"),
        (lambda card: card["views"].update(tta_views=[{"size": [48, 80]}]), "multiples of 32"),
        (lambda card: card["views"].update(tta_views=[{"mirrored": True}]), "'size' is missing"),
        (lambda card: card["views"].update(tta_rolls_deg=15), "card: "),
        (lambda card: card["views"].update(tta_rolls_deg=[15, float("nan")]), "tta_rolls_deg must be angles"),
        (lambda card: card["views"].update(turns_deg=[float("inf")]), "turns_deg must be angles"),
        (lambda card: card["views"].update(search_below_score=5), "search_below_score must lie in 0..1"),
        (lambda card: card["views"].update(upright_within_deg=-1), "upright_within_deg must lie in 0..180"),
        (lambda card: card["placement"].update(range_errors=[0.04]), "range_errors must be"),
        (lambda card: card["placement"].update(range_errors=[0.04, 0]), "range_errors must be"),
        (lambda card: card["placement"].update(range_errors=0.04), "card: "),
        (lambda card: card["placement"].update(body_weights=[1, 2]), "body_weights must be 6 numbers"),
        (lambda card: card["placement"].update(body_spread=0), "body_spread must be above 0"),
        (lambda card: card["placement"].update(body_correlation=1), "body_correlation between"),
        (lambda card: card["placement"].update(range_sigma=[0.04, 1, 1]), "range_sigma must be"),
        (lambda card: card["placement"].update(range_sigma=[0, 1, 1, 1]), "range_sigma must be"),
        (lambda card: card["placement"].update(range_sigma=0.04), "card: "),
        (lambda card: card["placement"].update(ray_share="half"), "card: "),
        (lambda card: card["decision"].update(side_trust=float("nan")), "card: "),
        (lambda card: card["decision"].update(leniense=0.5), "decision names unknown settings, leniense"),
        (lambda card: card["decision"].update(first={"hands": 1}), "decision.first weighs unknown features, hands"),
        (lambda card: card["decision"].update(last={"hand": float("inf")}), "decision.last must hold finite weights"),
        (lambda card: card["decision"].update(last={"hand": "one"}), "card: "),
        (lambda card: card["decision"].update(first=[1.0]), "card: "),
        (lambda card: card.update(decision=0.5), "card: "),
        (lambda card: card["hand_seg_net"].update(network_input="x / 255"), "network_input must be"),
        (lambda card: card.update(networks={"hand_seg_net": "../elsewhere"}), "folders beside the card's"),
        (lambda card: card.update(networks={"hand_seg_net": ""}), "folders beside the card's"),
        (lambda card: card.update(second="../fast"), "second must name folders beside"),
        (lambda card: card.update(networks={"hand_net": "fast"}), "networks names unknown networks, hand_net"),
        (lambda card: card.update(networks="fast"), "card: "),
        (lambda card: card.update(hand_check={"crop_size": -1, "crop_margin": 1.4}), "hand_check needs a crop_size"),
        (lambda card: card.update(hand_check={"crop_size": 160, "crop_margin": 0}), "hand_check needs a crop_size"),
        (lambda card: card.update(hand_check={"crop_size": 160}), "key 'crop_margin' is missing"),
        (lambda card: card.update(hand_check={"crop_size": 160, "crop_margin": 1.4}), "hand_check.onnx is missing"),
    ],
)
def test_a_bad_card_is_refused(copied, change, message):
    card = json.loads((copied / "card.json").read_text()) | {"views": {}, "decision": {}, "placement": {}}
    change(card)
    (copied / "card.json").write_text(json.dumps(card))
    with pytest.raises(CheckpointError, match=message):
        read_card(copied)


def test_a_card_overrides_any_setting_and_the_record_names_all_of_them(copied):
    card = json.loads((copied / "card.json").read_text())
    decision = {"first": {"pose": 1, "hand": -2.5}, "last": {"first": 1}, "fit": {"seed": 1}, "side_trust": 1}
    card |= {"decision": decision, "placement": {"range_errors": [0.04, 0.1]}, "views": {"tta_views": []}}
    (copied / "card.json").write_text(json.dumps(card))
    found = read_card(copied)
    assert found.decision == DecisionConfig({"pose": 1.0, "hand": -2.5}, {"first": 1.0}, {"seed": 1}, side_trust=1.0)
    assert found.hand_logit is found.decides is False
    assert found.placement == PlacementConfig(range_errors=(0.04, 0.1))
    assert found.views == ViewConfig()
    settings = json.loads(json.dumps(found.settings(), allow_nan=False))
    assert WeightsCard.from_dict(card | settings) == found
    for section, kind in (("views", ViewConfig), ("decision", DecisionConfig), ("placement", PlacementConfig)):
        assert set(settings[section]) == {field.name for field in dataclasses.fields(kind)}


def test_a_card_of_version_1_says_the_same_in_other_words(copied):
    card = json.loads((copied / "card.json").read_text()) | {"version": 1}
    views = [{"size": [64, 96], "mirrored": True}]
    old, new = json.loads(json.dumps(card)), card | {"version": 2}
    assert WeightsCard.from_dict(old) == WeightsCard.from_dict(new)  # with none of the four
    old["hand_seg_net"] |= {"further_looks": views, "doubt": [0.1, 0.9]}
    old["pose_net_2d"]["rolls_deg"] = [5]
    old["range_errors"] = [0.04, 0.1]
    new["views"] = {"tta_views": views, "tta_score_range": [0.1, 0.9], "tta_rolls_deg": [5]}
    new["placement"] = {"range_errors": [0.04, 0.1]}
    assert WeightsCard.from_dict(old) == WeightsCard.from_dict(new)


def test_a_card_alone_runs_the_networks_of_the_preset_that_it_names(copied, monkeypatch):
    card = json.loads((copied / "card.json").read_text()) | {"name": "patient"}
    card["networks"] = dict.fromkeys(NETWORK_NAMES, copied.name)
    card["views"] = {
        "tta_views": [{"size": [64, 96]}, {"size": [32, 64], "mirrored": True}],
        "tta_score_range": [0, 1],
        "tta_rolls_deg": [15, -15],
    }
    alone = copied.parent / "patient"
    alone.mkdir()
    (alone / "card.json").write_text(json.dumps(card))
    found = read_card(alone)
    monkeypatch.chdir(alone)
    assert read_card(Path(".")) == found  # named case: the folder beside "." was looked for in it
    assert found.views.tta_views == (PictureView((64, 96)), PictureView((32, 64), mirrored=True))
    assert (found.views.tta_score_range, found.views.tta_rolls_deg) == ((0, 1), (15, -15))
    assert read_card(copied).views.tta_views == (PictureView((48, 80), mirrored=True),)
    assert weights_id(alone, found).partition("@")[2] == weights_id(copied, read_card(copied)).partition("@")[2]
    image, camera = np.zeros((48, 80, 3), np.uint8), PinholeCamera.from_fov(90.0, 80, 48)
    shipped, networks, seen = HandEstimator.from_preset(copied), load_networks(alone, found), []
    network = networks.pose_net_2d
    noted = dataclasses.replace(networks, pose_net_2d=lambda x: seen.append(x) or network(x))
    patient = HandEstimator(noted, found)
    for hand, again in zip(shipped.estimate(image, camera).hands, patient.estimate(image, camera).hands, strict=True):
        assert hand.present and again.present
        np.testing.assert_allclose(again.box_px, [*again.joints_px.min(axis=0), *again.joints_px.max(axis=0)])
    assert len(seen) >= 3
    (copied / "pose_net_2d.onnx").unlink()
    with pytest.raises(CheckpointError, match=r"copy: pose_net_2d\.onnx is missing"):
        read_card(alone)


def test_a_preset_with_networks_of_its_own_takes_the_others_of_another_one(copied):
    own = copied.parent / "half"
    own.mkdir()
    for name in ("pose_net_2d", "pose_net_3d"):
        (copied / f"{name}.onnx").rename(own / f"{name}.onnx")
    card = json.loads((copied / "card.json").read_text()) | {"networks": {"hand_seg_net": copied.name}}
    (own / "card.json").write_text(json.dumps(card))
    homes = {name: path.parent for name, path in network_files(own, read_card(own)).items()}
    assert homes == {"hand_seg_net": copied, "pose_net_2d": own, "pose_net_3d": own}


def test_the_pose_networks_of_a_second_preset_see_every_hand_as_well(copied, tmp_path):
    """Both of them, in crops of their own size; a preset without them is another one."""
    other = write_tiny_weights(tmp_path / "other", crop_size=64, map_size=16)
    card = json.loads((copied / "card.json").read_text())
    alone = weights_id(copied, read_card(copied))
    card |= {"second": "other", "decision": {"second": {"second": 1.0}}, "views": {"tta_rolls_deg": [15]}}
    (copied / "card.json").write_text(json.dumps(card))
    found = read_card(copied)
    assert weights_id(copied, found) != alone
    networks, seen, lifted = load_networks(copied, found), [], []
    second = networks.second
    assert second is not None and second.card == read_card(other)
    noted = dataclasses.replace(
        second,
        pose_net_2d=lambda x: seen.append(x.shape[2:]) or second.pose_net_2d(x),
        pose_net_3d=lambda maps: lifted.append(maps.shape[2:]) or second.pose_net_3d(maps),
    )
    estimator = HandEstimator(dataclasses.replace(networks, second=noted), found)
    assert estimator.settings() == found.settings() | {"second": second.card.settings()}
    pose = estimator.estimate(np.zeros((48, 80, 3), np.uint8), PinholeCamera.from_fov(90.0, 80, 48))
    assert pose.left.present and pose.right.present
    assert (seen, lifted) == ([(64, 64)] * 2, [(16, 16)] * 2)
    shutil.rmtree(other)
    with pytest.raises(CheckpointError, match="other"):
        read_card(copied)


def test_a_second_that_does_not_stand_beside_is_the_shipped_one_of_that_name(copied, tmp_path):
    """Named case: weights fine-tuned from shipped ones lost their second pose networks."""
    card = dataclasses.replace(read_card(copied), second=DEFAULT_PRESET)
    assert second_folder(copied, card) == preset_folder(DEFAULT_PRESET)
    (tmp_path / DEFAULT_PRESET).mkdir()
    assert second_folder(copied, card) == tmp_path / DEFAULT_PRESET


def test_missing_and_damaged_cards_are_refused(copied):
    with pytest.raises(CheckpointError, match="'nothing' not found"):
        preset_folder("nothing")
    (copied / "card.json").write_text("{")
    with pytest.raises(CheckpointError, match="not a readable card"):
        read_card(copied)
    (copied / "card.json").write_text("[]")
    with pytest.raises(CheckpointError, match="JSON object expected"):
        read_card(copied)


def test_a_missing_network_is_named(copied):
    (copied / "pose_net_3d.onnx").unlink()
    with pytest.raises(CheckpointError, match=r"pose_net_3d\.onnx is missing"):
        HandEstimator.from_preset(copied)


@pytest.mark.parametrize("content", [b"", b"not a network", b"\x08\x08"])
def test_a_damaged_network_is_refused(copied, content):
    (copied / "pose_net_2d.onnx").write_bytes(content)
    with pytest.raises(CheckpointError, match=r"pose_net_2d\.onnx"):
        load_networks(copied, read_card(copied))


ROLES = ("hand_seg_net", "pose_net_2d", "pose_net_3d")


@pytest.mark.parametrize(("role", "other"), [(a, b) for a in ROLES for b in ROLES if a != b])
def test_another_network_in_a_role_is_refused(copied, role, other):
    shutil.copy(copied / f"{other}.onnx", copied / f"{role}.onnx")
    with pytest.raises(CheckpointError, match="another network"):
        load_networks(copied, read_card(copied))


def test_compiled_networks_are_functions_of_batches(tiny):
    networks = load_networks(tiny, read_card(tiny))
    seg_logits, energy_logits = networks.hand_seg_net(np.zeros((1, 3, 48, 80), np.float32))
    assert seg_logits.shape == (1, 3, 48, 80) and energy_logits.shape == (1, 2, 48, 80)
    assert seg_logits[0, 1, 0, 0] == 1.0 and energy_logits[0, 0, 30, 20] == 4.0
    for count in (1, 2):
        heatmaps, hand_logits = networks.pose_net_2d(np.zeros((count, 3, 32, 32), np.float32))
        assert heatmaps.shape == (count, 21, 8, 8)
        np.testing.assert_array_equal(hand_logits, np.zeros(count))  # it does not judge
        assert networks.pose_net_3d(heatmaps).shape == (count, 21, 3)


def test_results_of_one_call_survive_the_next(tiny):
    """An engine may reuse its memory; what it returned must not change."""
    networks = load_networks(tiny, read_card(tiny))
    first, _ = networks.pose_net_2d(np.zeros((1, 3, 32, 32), np.float32))
    kept = first.copy()
    networks.pose_net_2d(np.full((1, 3, 32, 32), np.nan, np.float32))
    np.testing.assert_array_equal(first, kept)


def test_a_weights_folder_tracks(tiny):
    estimator = HandEstimator.from_preset(tiny)
    image = np.full((96, 160, 3), 90, np.uint8)
    pose = estimator.estimate(image, PinholeCamera.from_fov(60, 160, 96), 0.09)
    _, boxes = estimator.segment(image)
    np.testing.assert_allclose(boxes.boxes_px, [[20, 40, 60, 80], [100, 40, 140, 80]], atol=2)
    for hand in pose.hands:  # the result's box is that of its joints
        np.testing.assert_allclose(hand.box_px, [*hand.joints_px.min(axis=0), *hand.joints_px.max(axis=0)])
    assert pose.left.valid and pose.right.valid
    # One network answer for both: the right hand is the left one's mirror image.
    np.testing.assert_allclose(pose.right.canonical, pose.left.canonical * [-1, 1, 1], atol=1e-6)
    np.testing.assert_allclose(pose.right.joints_px, pose.left.joints_px * [-1, 1] + [160, 0], atol=1e-2)


def test_accurate_finds_the_hands_of_fast():
    """By the same networks and decisions; it only looks at them more often. Named case: with views of the whole picture
    and a decision of its own it lost hands of real people, and invented others."""
    fast, accurate = (read_card(preset_folder(name)) for name in ("fast", "accurate"))
    assert set(accurate.networks.values()) == {"fast"} and accurate.second == fast.second
    assert accurate.decision == fast.decision
    assert accurate.views == dataclasses.replace(fast.views, tta_rolls_deg=accurate.views.tta_rolls_deg)
    assert accurate.views.tta_rolls_deg and not fast.views.tta_rolls_deg
