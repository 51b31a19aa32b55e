"""The parts of `scripts/burst_training.py`, and a short run of it."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from scripts.burst_training import Pool, covered, half_mirrored, mirrored, relit, smaller

from twohands.inference.weights import preset_folder
from twohands.models.checkpoint import load_network, read_note

ROOT = Path(__file__).parents[2]


def pictures(number: int = 4) -> dict[str, torch.Tensor]:
    """Of 8x12 pixels, the left hand in the first two columns, no right one."""
    classes = torch.zeros(number, 8, 12, dtype=torch.uint8)
    classes[:, :, :2] = 1
    generator = torch.Generator().manual_seed(0)
    return {
        "image": torch.randint(256, (number, 8, 12, 3), dtype=torch.uint8, generator=generator),
        "classes": classes,
        "boxes_px": torch.tensor([[[0.0, 1, 2, 7], [0, 0, 0, 0]]]).repeat(number, 1, 1),
        "present": torch.tensor([[True, False]]).repeat(number, 1),
    }


def test_a_full_pool_forgets_its_oldest_examples():
    pool = Pool(5, "cpu")
    for first in (0, 3, 6):
        pool.add({"image": torch.arange(first, first + 3)})
    assert len(pool) == 5
    assert sorted(pool.fields["image"].tolist()) == [4, 5, 6, 7, 8]
    assert set(pool.draw(200)["image"].tolist()) == {4, 5, 6, 7, 8}


def test_a_mirrored_left_hand_is_a_right_one():
    found = mirrored(pictures())
    assert (found["classes"][:, :, -2:] == 2).all() and (found["classes"][:, :, :-2] == 0).all()
    assert found["present"].tolist() == [[False, True]] * 4
    assert found["boxes_px"][0].tolist() == [[0, 0, 0, 0], [10, 1, 12, 7]]


def test_mirrored_twice_is_as_before():
    before = pictures()
    after = mirrored(mirrored(before))
    assert all(torch.equal(values, after[name]) for name, values in before.items())


def test_half_of_the_pictures_are_mirrored():
    assert half_mirrored(pictures(6))["present"][:, 0].tolist() == [True] * 3 + [False] * 3


def test_smaller_crops_are_seen_along_the_same_rays():
    generator = torch.Generator().manual_seed(0)
    batch = {
        "image": torch.zeros(2, 160, 160, 3, dtype=torch.uint8),
        "joints_px": 160 * torch.rand(2, 21, 2, generator=generator),
        "rays_from_crop": torch.rand(2, 3, 3, generator=generator),
    }
    batch["image"][:, :80] = 200
    found = smaller(batch, 128)

    def rays(of: dict[str, torch.Tensor]) -> torch.Tensor:
        points = torch.cat([of["joints_px"], torch.ones(2, 21, 1)], dim=-1)
        return points @ of["rays_from_crop"].mT

    torch.testing.assert_close(rays(found), rays(batch))
    assert found["image"].shape == (2, 128, 128, 3)
    assert (found["image"][:, :63] == 200).all() and (found["image"][:, 65:] == 0).all()


def test_other_light_keeps_black_dark_and_changes_every_picture_in_its_own_way():
    torch.manual_seed(0)
    image = torch.full((64, 4, 4, 3), 128, dtype=torch.uint8)
    image[:, 0] = 0
    found = relit(image).float()
    assert found[:, 0].max() < 25
    levels = found[:, 1:].mean(dim=(1, 2, 3))
    assert 5 < levels.std() < 40 and abs(levels.mean() - 128) < 15


def test_a_share_of_the_crops_is_partly_covered_by_another():
    torch.manual_seed(0)
    image = torch.full((400, 32, 32, 3), 200, dtype=torch.uint8)
    changed = (covered(image, 0.25, 0.4) != image).any(dim=3).float().mean(dim=(1, 2))
    assert 0.15 < (changed > 0).float().mean() < 0.35
    assert changed.max() < 0.25
    assert torch.equal(covered(image, 0.0, 0.4), image)


@pytest.mark.slow
def test_a_short_run_writes_weights_that_have_moved(tmp_path):
    frames = [sys.executable, "-m", "twohands", "generate", "frames", "--count", "20", "--seed", "3"]
    subprocess.run([*frames, "--out", "frames"], cwd=tmp_path, check=True, capture_output=True)
    weights = preset_folder("fast").parent
    options = "--data frames --out burst --minutes 1 --workers 1 --batch 8 --pools 100 50 --first 20 --held-out 1"
    script = [sys.executable, str(ROOT / "scripts" / "burst_training.py"), str(weights), *options.split()]
    run = subprocess.run(script, cwd=tmp_path, check=False, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    for preset, names in (("fast", ("hand_seg_net", "pose_net_2d", "pose_net_3d")), ("accurate", ("pose_net_2d",))):
        for name in names:
            path = tmp_path / "burst" / preset / f"{name}.safetensors"
            before, after = load_network(name, weights / preset / f"{name}.onnx"), load_network(name, path)
            assert after.config == before.config
            moved = [(a - b).abs().max() for a, b in zip(after.parameters(), before.parameters(), strict=True)]
            assert 0 < max(moved) < 0.1
            note = read_note(path)
            assert note["iterations"] > 0 and "/" not in note["data"]
    again = refused(script, tmp_path)
    assert "burst" in again and "not empty" in again
    script[script.index("burst")] = "other"
    script[script.index("frames")] = "nowhere"
    assert "nowhere" in refused(script, tmp_path)
    assert not (tmp_path / "other").exists()


def refused(script: list[str], folder: Path) -> str:
    """The one line with which a run ends that cannot begin."""
    run = subprocess.run(script, cwd=folder, check=False, capture_output=True, text=True)
    assert run.returncode == 2
    assert run.stderr.startswith("error: ") and run.stderr.count("\n") == 1
    return run.stderr
