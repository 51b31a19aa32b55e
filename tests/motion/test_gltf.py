"""glTF files, read back by hand, by Khronos' validator and by three.js: the clip's joints, to 1e-4 m."""

import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
from tests.motion.moving import CAMERA, moving_hands

pytest.importorskip("pygltflib")

from twohands.errors import InputError
from twohands.geometry.quaternions import rotations
from twohands.motion.clip import UPRIGHT_FROM_CAMERA
from twohands.motion.fit import fit_motion
from twohands.motion.gltf import gltf_file
from twohands.skeleton import JOINT_NAMES, SIDES

TOLERANCE_M = 1e-4
NODE = Path(__file__).parent / "node"
needs_node = pytest.mark.skipif(
    shutil.which("node") is None or not (NODE / "node_modules/three").is_dir(),
    reason="needs node, and `npm ci` in tests/motion/node",
)


def clip_with_gaps():
    """The right hand is away for a while; the left one comes late, leaves, and comes again."""
    valid = np.ones((40, 2), bool)
    valid[:5, 0] = valid[20:25, 0] = valid[12:30, 1] = False
    motion = moving_hands(40, valid=valid, times=100 + np.cumsum(np.tile([0.03, 0.04], 20)))
    motion.joints_m[:] += np.random.default_rng(0).normal(0, 0.002, motion.joints_m.shape)
    return motion


def files(tmp_path, motion):
    fitted = fit_motion(motion)
    paths = [tmp_path / "hands.glb", tmp_path / "hands.gltf"]
    for path in paths:
        path.write_bytes(gltf_file(motion, fitted, binary=path.suffix == ".glb"))
    return paths


def chunks(content: bytes) -> tuple[dict, bytes]:
    """JSON and numbers of a .glb file."""
    assert content[:4] == b"glTF" and struct.unpack_from("<II", content, 4) == (2, len(content))
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def array(document: dict, data: bytes, number: int) -> np.ndarray:
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
    kind = {5126: "<f4", 5123: "<u2", 5121: "u1"}[accessor["componentType"]]
    found = np.frombuffer(data, kind, accessor["count"] * width, view["byteOffset"])
    return found.reshape(accessor["count"], width).astype(float)


def played(document: dict, data: bytes, top: str) -> tuple[dict[str, np.ndarray], set[tuple[float, ...]]]:
    """Places (N, 3) of all nodes below one, by name, at the animation's times; and those times."""
    (animation,) = document["animations"]
    tracks = {
        (channel["target"]["node"], channel["target"]["path"]): animation["samplers"][channel["sampler"]]
        for channel in animation["channels"]
    }
    nodes = document["nodes"]
    places, times = {}, set()
    waiting = [(number, 0.0, np.eye(3)) for node in nodes if node["name"] == top for number in node["children"]]
    while waiting:
        number, above, turned = waiting.pop()
        place, rotation = tracks[number, "translation"], tracks.get((number, "rotation"))
        times.add(tuple(array(document, data, place["input"])[:, 0]))
        own = np.eye(3) if rotation is None else rotations(array(document, data, rotation["output"]))
        world = above + np.einsum("...ab,...b->...a", turned, array(document, data, place["output"]))
        places[nodes[number]["name"]] = world
        waiting += [(child, world, turned @ own) for child in nodes[number].get("children", ())]
    return places, times


def test_every_joint_is_where_the_clip_has_it(tmp_path):
    """Forward kinematics of the file's own numbers, at its own times."""
    motion = clip_with_gaps()
    document, data = chunks(files(tmp_path, motion)[0].read_bytes())
    for side, word in enumerate(SIDES):
        rows = np.flatnonzero(motion.valid[:, side])
        places, times = played(document, data, f"{word}_hand")
        (seconds,) = times
        np.testing.assert_allclose(seconds, motion.time_s[rows] - motion.time_s[0], atol=1e-6)
        found = np.stack([places[f"{word}_{name}"] for name in JOINT_NAMES], axis=1)
        np.testing.assert_allclose(found, motion.joints_m[rows, side] @ UPRIGHT_FROM_CAMERA.T, atol=1e-6)


def test_hands_are_seen_exactly_while_they_are_valid(tmp_path):
    motion = clip_with_gaps()
    document, data = chunks(files(tmp_path, motion)[0].read_bytes())
    (animation,) = document["animations"]
    scales = [channel for channel in animation["channels"] if channel["target"]["path"] == "scale"]
    assert len(scales) == 2
    for side, (channel, rows, values) in enumerate(
        zip(scales, ([0, 5, 20, 25], [0, 12, 30]), ([0, 1, 0, 1], [1, 0, 1]), strict=True)
    ):
        sampler = animation["samplers"][channel["sampler"]]
        assert sampler["interpolation"] == "STEP", side
        times = array(document, data, sampler["input"])[:, 0]
        np.testing.assert_allclose(times, motion.time_s[rows] - motion.time_s[0], atol=1e-6)
        np.testing.assert_array_equal(array(document, data, sampler["output"]), np.repeat(values, 3).reshape(-1, 3))


def test_one_hand_alone_and_one_frame(tmp_path):
    document, _ = chunks(files(tmp_path, moving_hands(1, valid=np.array([[False, True]])))[0].read_bytes())
    names = {node["name"] for node in document["nodes"]}
    assert "right_wrist" in names and not any(name.startswith("left") for name in names)


def test_both_forms_say_the_same(tmp_path):
    binary, text = (path.read_bytes() for path in files(tmp_path, clip_with_gaps()))
    inside, plain = chunks(binary)[0], json.loads(text)
    assert plain["buffers"][0].pop("uri").startswith("data:application/octet-stream;base64,")
    assert inside == plain


def test_times_that_32_bits_cannot_tell_apart(tmp_path):
    motion = moving_hands(3, times=np.array([0.0, 1e6, 1e6 + 0.01]))
    with pytest.raises(InputError, match="too close in time for glTF"):
        files(tmp_path, motion)


def node(*words) -> object:
    done = subprocess.run(["node", *map(str, words)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@needs_node
def test_the_validator_finds_nothing(tmp_path):
    motions = [clip_with_gaps(), moving_hands(1), moving_hands(5, valid=np.array([[True, False]] * 5))]
    made = []
    for number, motion in enumerate(motions):
        (folder := tmp_path / str(number)).mkdir()
        made += files(folder, motion)
    for report in node(NODE / "validate.mjs", *made):
        issues = report["issues"]
        assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]
        assert report["info"]["animationCount"] == 1


@needs_node
def test_the_validator_can_find_something(tmp_path):
    path = files(tmp_path, moving_hands(2))[1]
    path.write_text(path.read_text().replace('"VEC4"', '"VEC2"', 1))
    (report,) = node(NODE / "validate.mjs", path)
    assert report["issues"]["numErrors"] > 0


@needs_node
@pytest.mark.parametrize("form", [0, 1], ids=["glb", "gltf"])
def test_three_js_shows_the_clip_s_joints(tmp_path, form):
    motion = clip_with_gaps()
    path = files(tmp_path, motion)[form]
    seconds = np.float32(motion.time_s - motion.time_s[0])  # as the file has them
    shown = node(NODE / "joints.mjs", path, json.dumps(seconds.tolist()))
    assert shown["duration"] == pytest.approx(seconds[-1], abs=1e-5)
    assert shown["fov"] == pytest.approx(np.degrees(2 * np.arctan(240 / CAMERA.fy)))
    upright = motion.joints_m @ UPRIGHT_FROM_CAMERA.T
    for frame, hands in enumerate(shown["frames"]):
        for side, word in enumerate(SIDES):
            assert (hands[side] is not None) == motion.valid[frame, side], (frame, word)
            if hands[side] is not None:
                found = [hands[side][f"{word}_{name}"] for name in JOINT_NAMES]
                np.testing.assert_allclose(found, upright[frame, side], atol=TOLERANCE_M)


@needs_node
def test_three_js_bends_the_mesh_as_the_joints_are(tmp_path):
    """The first 6 corners are those of an octahedron of 5 mm about the wrist, the last 6 the bar of the last bone."""
    motion = clip_with_gaps()
    path = files(tmp_path, motion)[0]
    shown = node(
        NODE / "joints.mjs", path, json.dumps([float(np.float32(motion.time_s[8] - motion.time_s[0]))]), "skin"
    )
    left = motion.joints_m[8, 0] @ UPRIGHT_FROM_CAMERA.T
    corners = np.array(shown["frames"][0][0])
    np.testing.assert_allclose(corners[:6].mean(axis=0), left[0], atol=TOLERANCE_M)
    np.testing.assert_allclose(np.linalg.norm(corners[:6] - left[0], axis=1), 0.005, atol=TOLERANCE_M)
    np.testing.assert_allclose(corners[-6:-3].mean(axis=0), left[19], atol=TOLERANCE_M)
    np.testing.assert_allclose(corners[-3:].mean(axis=0), left[20], atol=TOLERANCE_M)
