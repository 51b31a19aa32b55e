"""The loop learns, resumes exactly, and keeps what it promises on disk."""

import csv
import dataclasses
import json
import signal

import pytest
import torch
from tests.builders import make_samples
from tests.training.tiny import NETWORKS, plain, tiny_run

from twohands.errors import CheckpointError, DataFormatError, InputError
from twohands.models.checkpoint import load_network, load_tensors, read_note, same_weights, save_network
from twohands.models.hand_seg_net import HandSegNetConfig
from twohands.models.pose_net_2d import PoseNet2D, PoseNet2DConfig
from twohands.models.presets import build_network
from twohands.training.batches import BatchDataset
from twohands.training.config import AugmentConfig, OptimConfig, TrainConfig, with_override
from twohands.training.pose_stages import heatmap_losses, judge_losses
from twohands.training.stage import normalised
from twohands.training.stages import build_stage
from twohands.training.state import build_optimizer
from twohands.training.trainer import STATE_FILE, train

SAMPLES = make_samples(6)
STAGES = ("hand_seg_net", "pose_net_2d", "pose_net_3d")


def pose_weights(folder, shape: PoseNet2DConfig = NETWORKS.pose_net_2d) -> list:
    """A fresh PoseNet2D on disk, for the stage that needs one."""
    torch.manual_seed(5)
    path = folder / "start" / "pose_net_2d.safetensors"
    save_network("pose_net_2d", PoseNet2D(shape), path)
    return [path]


def start_weights(stage: str, folder) -> list:
    return pose_weights(folder) if stage == "pose_net_3d" else []


def rows(folder) -> list[dict[str, str]]:
    with (folder / "log.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("stage", "iterations", "figure", "reached"),
    [
        ("hand_seg_net", 220, "miou", lambda value: value > 0.5),
        ("pose_net_2d", 60, "crop_px_mean", lambda value: value < 4),
        ("pose_net_3d", 80, "canonical_mean", lambda value: value < 0.3),
    ],
)
def test_two_pictures_are_learnt_by_heart(tmp_path, stage, iterations, figure, reached):
    config = plain(tiny_run(stage, iterations=iterations, validate_every=1000))
    result = train(config, SAMPLES[:2], SAMPLES[:2], tmp_path / "run", weights=start_weights(stage, tmp_path))
    assert result.iterations == iterations
    assert reached(result.figures[figure]), result.figures
    untrained = train(
        dataclasses.replace(config, iterations=1, optim=dataclasses.replace(config.optim, learning_rate=0.0)),
        SAMPLES[:2], SAMPLES[:2], tmp_path / "none", weights=start_weights(stage, tmp_path),
    )  # fmt: skip
    assert not reached(untrained.figures[figure]), "the check could not fail"


@pytest.mark.parametrize("stage", STAGES)
def test_interrupted_and_resumed_equals_undisturbed(tmp_path, stage):
    config = tiny_run(stage, iterations=7, validate_every=3, log_every=1)
    weights = start_weights(stage, tmp_path)
    whole = train(config, SAMPLES, SAMPLES[:2], tmp_path / "whole", weights=weights)
    train(config, SAMPLES, SAMPLES[:2], tmp_path / "parts", weights=weights, stop_after=4)
    parts = train(config, SAMPLES, SAMPLES[:2], tmp_path / "parts", resume=True)
    assert parts.iterations == whole.iterations == 7
    for name in whole.checkpoints:
        assert same_weights(load_network(name, whole.checkpoints[name]), load_network(name, parts.checkpoints[name]))
    assert whole.figures == parts.figures
    columns = ("iteration", "split", "metric", "value")
    train_rows = [
        [tuple(row[c] for c in columns) for row in rows(tmp_path / run) if row["split"] == "train"]
        for run in ("whole", "parts")
    ]
    assert train_rows[0] == train_rows[1]


@pytest.mark.parametrize(("optimizer", "kept"), [("adamw", {"exp_avg_sq"}), ("muon", {"momentum", "exp_avg_sq"})])
def test_what_an_optimizer_remembers_is_kept(tmp_path, optimizer, kept):
    """And in the memory layout that decides how it is rounded."""
    config = tiny_run("hand_seg_net", iterations=5, validate_every=100)
    config = dataclasses.replace(config, optim=dataclasses.replace(config.optim, optimizer=optimizer))
    whole = train(config, SAMPLES, [], tmp_path / "whole")
    train(config, SAMPLES, [], tmp_path / "parts", stop_after=3)
    names = {name.rsplit(".", 1)[1] for name in load_tensors(tmp_path / "parts" / "state.safetensors")[0]}
    assert kept <= names
    other = dataclasses.replace(config, optim=dataclasses.replace(config.optim, optimizer="sgd"))
    with pytest.raises(InputError, match=f"a run with {optimizer}, not sgd"):
        train(other, SAMPLES, [], tmp_path / "parts", resume=True)
    parts = train(config, SAMPLES, [], tmp_path / "parts", resume=True)
    files = [run.checkpoints["hand_seg_net"] for run in (whole, parts)]
    assert same_weights(*(load_network("hand_seg_net", file) for file in files))


def test_resume_needs_the_optimizer_state(tmp_path):
    """The comparison above notices a lost optimizer state: restarting from weights alone ends elsewhere."""
    config = tiny_run("hand_seg_net", iterations=4, validate_every=100)
    whole = train(config, SAMPLES, [], tmp_path / "whole")
    train(config, SAMPLES, [], tmp_path / "half", stop_after=2)
    again = train(config, SAMPLES, [], tmp_path / "again", weights=[tmp_path / "half" / "hand_seg_net.safetensors"])
    networks = [load_network("hand_seg_net", run.checkpoints["hand_seg_net"]) for run in (whole, again)]
    assert not same_weights(*networks)


def test_a_signal_ends_the_run_after_the_step_and_it_can_go_on(tmp_path):
    class Interrupting(list):
        def __getitem__(self, index):
            if isinstance(index, int) and self.armed:
                signal.raise_signal(signal.SIGTERM)  # to this thread: os.kill may reach a sleeping one too late
            return super().__getitem__(index)

    config = tiny_run("hand_seg_net", iterations=3)
    source = Interrupting(SAMPLES)
    source.armed = True
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        train(config, source, [], tmp_path / "run")
    assert signal.getsignal(signal.SIGTERM) is before
    source.armed = False
    assert train(config, source, [], tmp_path / "run", resume=True).iterations == 3


@pytest.mark.parametrize("workers", [0, 1])
def test_a_picture_that_cannot_be_used_is_named_after_the_state_was_saved(tmp_path, workers):
    """Named case: a worker's traceback came out instead, and the steps since the last save were lost."""

    class Damaged(list):
        def __getitem__(self, index):
            if self.broken and index == 3:
                raise DataFormatError("picture 3 is damaged")
            return super().__getitem__(index)

    config = tiny_run("hand_seg_net", iterations=len(SAMPLES), batch_images=1)
    config = dataclasses.replace(config, data=dataclasses.replace(config.data, workers=workers))
    source = Damaged(SAMPLES)
    source.broken = True
    steps = [BatchDataset(source, config).picks(step)[0][1] for step in range(len(SAMPLES))]
    with pytest.raises(DataFormatError, match=r"^picture 3 is damaged$"):
        train(config, source, [], tmp_path / "run")
    _, metadata = load_tensors(tmp_path / "run" / STATE_FILE)
    assert json.loads(metadata["state"])["iteration"] == steps.index(3)
    source.broken = False
    assert train(config, source, [], tmp_path / "run", resume=True).iterations == len(SAMPLES)


@pytest.mark.parametrize("name", ["seed", "threads", "data.seed", "data.workers", "data.validation"])
def test_negative_numbers_are_refused(name):
    with pytest.raises(InputError, match=f"{name} must not be negative, got -1"):
        with_override(tiny_run("hand_seg_net"), f"{name}=-1")


def test_a_used_folder_and_a_missing_run_are_refused(tmp_path):
    config = tiny_run("hand_seg_net", iterations=1)
    with pytest.raises(InputError, match="no training run to resume"):
        train(config, SAMPLES, [], tmp_path / "run", resume=True)
    train(config, SAMPLES, [], tmp_path / "run")
    with pytest.raises(InputError, match="already holds a training run"):
        train(config, SAMPLES, [], tmp_path / "run")


def test_resuming_with_other_networks_is_refused(tmp_path):
    train(tiny_run("hand_seg_net", iterations=1), SAMPLES, [], tmp_path / "run")
    with pytest.raises(CheckpointError, match="other networks"):
        train(tiny_run("pose_net_2d", iterations=2), SAMPLES, [], tmp_path / "run", resume=True)


def test_resuming_with_what_a_run_did_not_keep_is_refused(tmp_path):
    """Named cases: an error inside the first step, and a message about other networks."""
    along = tiny_run("pose_net_3d", iterations=2)
    train(along, SAMPLES, [], tmp_path / "along", weights=pose_weights(tmp_path), stop_after=1)
    with pytest.raises(InputError, match=r"trained PoseNet2D along: optim\.along_rate cannot be 0"):
        train(with_override(along, "optim.along_rate=0"), SAMPLES, [], tmp_path / "along", resume=True)
    assert train(along, SAMPLES, [], tmp_path / "along", resume=True).iterations == 2
    plain_run = with_override(tiny_run("hand_seg_net", iterations=2), "optim.ema=0")
    train(plain_run, SAMPLES, [], tmp_path / "plain", stop_after=1)
    with pytest.raises(InputError, match="a run without averaged weights"):
        train(with_override(plain_run, "optim.ema=0.9"), SAMPLES, [], tmp_path / "plain", resume=True)
    assert train(plain_run, SAMPLES, [], tmp_path / "plain", resume=True).iterations == 2


def test_log_config_and_note(tmp_path):
    lines: list[str] = []
    config = tiny_run("pose_net_2d", iterations=4, log_every=2, validate_every=2, seed=3)
    result = train(config, SAMPLES, SAMPLES[:2], tmp_path / "run", report=lines.append)
    logged = rows(tmp_path / "run")
    assert [int(row["iteration"]) for row in logged if row["metric"] == "loss"] == [2, 4]
    assert [int(row["iteration"]) for row in logged if row["metric"] == "image_px_mean"] == [0, 2, 4]
    assert len(lines) == 7
    speeds = {row["metric"]: float(row["value"]) for row in logged if row["split"] == "speed"}
    assert speeds.keys() == {"stream_per_s", "step_per_s"} and min(speeds.values()) > 0
    parts = {
        row["metric"]: float(row["value"]) for row in logged if row["iteration"] == "2" and row["split"] == "train"
    }
    assert parts["loss"] == pytest.approx(parts["heatmap"] + parts["soft_argmax"] + parts["judge"], rel=1e-4)
    note = read_note(result.checkpoints["pose_net_2d"])
    assert (note["recipe"], note["seed"], note["iterations"]) == ("ours", 3, 4)
    assert note["crop"]["kind"] == "perspective"
    assert not [file for file in (tmp_path / "run").iterdir() if "partial" in file.name]


def test_minutes_end_a_run_and_count_over_resumes(tmp_path):
    config = tiny_run("hand_seg_net", iterations=10_000, max_minutes=1 / 60, validate_every=100_000)
    first = train(config, SAMPLES, [], tmp_path / "run")
    assert 0 < first.iterations < 10_000
    assert first.minutes >= 1 / 60
    again = train(config, SAMPLES, [], tmp_path / "run", resume=True)
    assert again.iterations == first.iterations


def test_the_paper_keeps_pose_net_2d_fixed_and_ours_does_not(tmp_path):
    weights = pose_weights(tmp_path)
    start = load_network("pose_net_2d", weights[0])
    for rate, fixed in ((0.0, True), (0.3, False)):
        config = tiny_run("pose_net_3d", iterations=2)
        config = dataclasses.replace(config, optim=dataclasses.replace(config.optim, along_rate=rate, ema=0.0))
        stage = build_stage(config, weights)
        stage.train()
        optimizer = build_optimizer(stage, config.optim)
        from twohands.training.batches import BatchDataset

        sum(stage(BatchDataset(SAMPLES, config)[0], 0).values()).backward()
        optimizer.step()
        assert same_weights(stage.net_2d, start) == fixed
        result = train(config, SAMPLES, [], tmp_path / f"run{rate}", weights=weights)
        assert ("pose_net_2d" in result.checkpoints) != fixed


def test_gradients_reach_pose_net_2d_through_the_maps(tmp_path):
    from twohands.training.batches import BatchDataset

    config = tiny_run("pose_net_3d", iterations=1)
    config = dataclasses.replace(config, loss=dataclasses.replace(config.loss, heatmap_along=0.0))
    stage = build_stage(config, pose_weights(tmp_path)).train()
    losses = stage(BatchDataset(SAMPLES, config)[0], 0)
    assert set(losses) == {"joint", "bone", "projection", "place"}
    for name in ("joint", "place"):
        stage.zero_grad()
        losses[name].backward(retain_graph=True)
        assert max(float(p.grad.abs().max()) for p in stage.net_2d.net.parameters()) > 0


@pytest.mark.parametrize("variant", ["encoder-decoder", "efficientnet-lite0"])
@pytest.mark.parametrize("along", [0.0, 1.0])
def test_everything_that_learns_gets_a_gradient(along, variant, tmp_path):
    """Named case: several processes waited for those of a judge without a loss, and ended in an error."""
    config = with_override(tiny_run("pose_net_3d", iterations=1), f"loss.heatmap_along={along}")
    shape = dataclasses.replace(config.networks.pose_net_2d, variant=variant)
    config = dataclasses.replace(config, networks=dataclasses.replace(config.networks, pose_net_2d=shape))
    start = pose_weights(tmp_path, shape)
    stage = build_stage(config, start).train()
    sum(stage(BatchDataset(SAMPLES, config)[0], 0).values()).backward()
    learning = {name for name, parameter in stage.named_parameters() if parameter.requires_grad}
    assert learning == {name for name, parameter in stage.named_parameters() if parameter.grad is not None}
    assert any("judge" in name for name in learning) == (along > 0)
    result = train(config, SAMPLES, [], tmp_path / "run", weights=start)
    assert result.iterations == 1


def test_frozen_statistics_stay_while_all_weights_learn(tmp_path):
    """And a run that was stopped goes on as if it had not been."""
    first = tiny_run("pose_net_3d", iterations=2)
    start = train(first, SAMPLES, (), tmp_path / "start", weights=pose_weights(tmp_path)).checkpoints
    config = with_override(dataclasses.replace(first, iterations=4), "optim.frozen_norm=true")
    whole = train(config, SAMPLES, (), tmp_path / "whole", weights=list(start.values()))
    train(config, SAMPLES, (), tmp_path / "parts", weights=list(start.values()), stop_after=2)
    parts = train(config, SAMPLES, (), tmp_path / "parts", resume=True)
    for name, path in whole.checkpoints.items():
        learnt = load_network(name, path)
        assert same_weights(learnt, load_network(name, parts.checkpoints[name]))
        before = load_network(name, start[name]).state_dict()
        for key, values in learnt.state_dict().items():
            kept = key.endswith(("running_mean", "running_var", "num_batches_tracked"))
            assert torch.equal(values, before[key]) == kept, key


def test_frozen_statistics_come_from_weights(tmp_path):
    config = with_override(tiny_run("pose_net_3d"), "optim.frozen_norm=true")
    with pytest.raises(InputError, match="pose_net_3d has no statistics to keep"):
        train(config, SAMPLES, (), tmp_path / "run", weights=pose_weights(tmp_path))


def test_pose_net_3d_needs_pose_net_2d(tmp_path):
    with pytest.raises(InputError, match="needs the weights of a trained pose_net_2d"):
        build_stage(tiny_run("pose_net_3d"))
    with pytest.raises(CheckpointError, match="holds weights of 'pose_net_2d', but 'hand_seg_net'"):
        build_stage(tiny_run("hand_seg_net"), pose_weights(tmp_path))


def test_hand_seg_net_can_go_on_with_pictures_of_another_size(tmp_path):
    config = tiny_run("hand_seg_net")
    shape = config.networks.hand_seg_net
    torch.manual_seed(3)
    old = build_network("hand_seg_net", dataclasses.replace(shape, width_px=shape.width_px + 32))
    save_network("hand_seg_net", old, tmp_path / "old.safetensors")
    stage = build_stage(config, [tmp_path / "old.safetensors"])
    assert stage.networks()["hand_seg_net"].config == shape
    for name, value in old.state_dict().items():
        assert torch.equal(stage.net.state_dict()[name], value)


def test_weights_from_crops_of_another_size_go_on_learning(tmp_path):
    config = tiny_run("pose_net_2d")
    network = build_network("pose_net_2d", config.networks.pose_net_2d)
    save_network("pose_net_2d", network, tmp_path / "small.safetensors")
    larger = with_override(config, "networks.pose_net_2d.crop_size=160")
    stage = build_stage(larger, [tmp_path / "small.safetensors"])
    assert stage.net.config.map_size == 40
    found = stage.net.state_dict()
    assert all(torch.equal(found[name], value) for name, value in network.state_dict().items())


def test_weights_without_a_judge_can_be_taught_to_judge(tmp_path):
    """The weights shipped until November 2026 had none."""
    config = tiny_run("pose_net_2d")
    shape = dataclasses.replace(config.networks.pose_net_2d, judge=False)
    torch.manual_seed(3)
    old = build_network("pose_net_2d", shape)
    save_network("pose_net_2d", old, tmp_path / "old.safetensors")
    stage = build_stage(config, [tmp_path / "old.safetensors"])
    for name, value in old.state_dict().items():
        assert torch.equal(stage.net.state_dict()[name], value)
    assert stage.net.judge is not None
    with pytest.raises(InputError, match="has the shape"):
        networks = dataclasses.replace(config.networks, pose_net_2d=dataclasses.replace(shape, width=0.5))
        build_stage(dataclasses.replace(config, networks=networks), [tmp_path / "old.safetensors"])


def test_a_hand_seg_net_without_context_goes_on_with_the_same_answers(tmp_path):
    config = tiny_run("hand_seg_net")
    shape = HandSegNetConfig("efficientnet-lite0", height=64, width_px=96)
    torch.manual_seed(3)
    old = build_network("hand_seg_net", shape).eval()
    save_network("hand_seg_net", old, tmp_path / "old.safetensors")
    networks = dataclasses.replace(config.networks, hand_seg_net=dataclasses.replace(shape, context=2))
    stage = build_stage(dataclasses.replace(config, networks=networks), [tmp_path / "old.safetensors"]).eval()
    assert len(stage.net.state_dict()) > len(old.state_dict())
    picture = torch.rand(1, 3, 64, 96) - 0.5
    for ours, theirs in zip(stage.net(picture), old(picture), strict=True):
        torch.testing.assert_close(ours, theirs)
    with pytest.raises(InputError, match="cannot have 2 blocks of context"):
        dataclasses.replace(config.networks.hand_seg_net, context=2)


def test_weights_without_cues_go_on_with_the_same_answers(tmp_path):
    """The weights shipped until November 2026 had none."""
    config = tiny_run("pose_net_3d")
    shapes = config.networks
    torch.manual_seed(3)
    for name in ("pose_net_2d", "pose_net_3d"):
        old = build_network(name, dataclasses.replace(getattr(shapes, name), cues=0))
        save_network(name, old, tmp_path / f"{name}.safetensors")
    stage = build_stage(config, [tmp_path / "pose_net_2d.safetensors", tmp_path / "pose_net_3d.safetensors"]).eval()
    old_2d = load_network("pose_net_2d", tmp_path / "pose_net_2d.safetensors")
    old_3d = load_network("pose_net_3d", tmp_path / "pose_net_3d.safetensors")
    crops = torch.rand(2, 3, 128, 128) - 0.5
    maps, old_maps = (net.heatmaps(net(crops)) for net in (stage.net_2d, old_2d))
    torch.testing.assert_close(maps[:, :21], old_maps)
    torch.testing.assert_close(stage.net_3d(maps), old_3d(old_maps))


def test_both_pose_networks_have_the_same_cues(tmp_path):
    config = with_override(tiny_run("pose_net_3d"), "networks.pose_net_2d.cues=4")
    with pytest.raises(InputError, match="gives 4 cues, but pose_net_3d takes 3"):
        build_stage(config, pose_weights(tmp_path))


def test_cues_are_learnt_and_a_tenth_of_the_hands_does_without(tmp_path):
    config = tiny_run("pose_net_3d", batch_images=6)
    stage = build_stage(config, pose_weights(tmp_path)).train()
    seen: list[torch.Tensor] = []
    stage.net_3d.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].detach()))
    lots = []
    for step in range(12):
        batch = BatchDataset(SAMPLES, config)[step]
        sum(stage(batch, step).values()).backward()
        lots.append(batch["lot"][batch["hand"] > 0])
    silent = torch.cat([(maps[:, 21:] == 0).flatten(1).all(dim=1) for maps in seen])
    assert torch.equal(silent, torch.cat(lots) >= 0.9) and 0 < silent.float().mean() < 0.3
    assert stage.net_3d.features[0][0].weight.grad[:, 21:].abs().max() > 0


@pytest.mark.parametrize("name", ["pose_net_2d", "pose_net_3d"])
def test_only_hands_are_looked_at_closely_and_every_crop_is_judged(name, tmp_path):
    """Mirrored crops have no joints: maps are computed for the others alone, with the same losses in the end."""
    config = tiny_run(name, batch_images=6)
    config = dataclasses.replace(config, augment=AugmentConfig(mirrored=0.5))
    stage = build_stage(config, pose_weights(tmp_path)[: 1 if name == "pose_net_2d" else 2]).eval()
    net = stage.networks()["pose_net_2d"]
    batch = BatchDataset(SAMPLES, config)[0]
    hands = batch["hand"] > 0
    assert 0 < hands.sum() < len(hands)
    decoded, judged = [], []
    net.net.head.register_forward_pre_hook(lambda _, inputs: decoded.append(len(inputs[0])))
    net.judge.register_forward_hook(lambda _, __, output: judged.append(len(output)))
    parts = stage(batch, 0)
    assert decoded == [hands.sum()] and judged == [len(hands)]
    outputs, logits = net.judged(normalised(batch["image"]))
    whole = heatmap_losses(net, outputs, batch, config) | judge_losses(logits, batch, config)
    for part, value in whole.items():
        torch.testing.assert_close(parts[part], value)
    nobody = batch | {"hand": torch.zeros_like(batch["hand"]), "weight": torch.zeros_like(batch["weight"])}
    nothing = stage(nobody | {"canonical_weight": torch.zeros_like(batch["canonical_weight"])}, 0)
    assert nothing["heatmap"] == 0 and nothing["judge"] > 0 and all(value.isfinite() for value in nothing.values())


def test_ideal_maps_replace_half_of_the_hands_at_first(tmp_path):
    config = dataclasses.replace(tiny_run("pose_net_3d"), truth_maps=5, batch_images=6)
    lots = torch.cat([BatchDataset(SAMPLES, config)[step]["lot"] for step in range(40)])
    assert 0.4 < (lots < 0.5).float().mean() < 0.6
    stage = build_stage(config, pose_weights(tmp_path)).train()
    batch = BatchDataset(SAMPLES, config)[0]
    seen: list[torch.Tensor] = []
    stage.net_3d.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0].detach()))
    for iteration in (4, 5):
        stage(batch, iteration)
    hands = batch["hand"] > 0
    ideal = stage._ideal_maps({key: values[hands] for key, values in batch.items()})
    same = [torch.isclose(maps, ideal).flatten(1).all(dim=1) for maps in seen]
    assert torch.equal(same[0], batch["lot"][hands] < 0.5) and not same[1].any()


def test_optimizers_of_the_recipes():
    stage = build_stage(tiny_run("hand_seg_net"))
    adam = build_optimizer(stage, OptimConfig(weight_decay=5e-4))
    assert type(adam) is torch.optim.Adam
    assert [group["weight_decay"] for group in adam.param_groups] == [5e-4]
    assert adam.param_groups[0]["betas"] == (0.9, 0.999)
    adamw = build_optimizer(stage, OptimConfig("adamw", weight_decay=0.01))
    assert type(adamw) is torch.optim.AdamW
    assert [group["weight_decay"] for group in adamw.param_groups] == [0.01, 0.0]
    assert all(p.ndim == 1 for p in adamw.param_groups[1]["params"])
    muon = build_optimizer(stage, OptimConfig("muon", weight_decay=0.01))
    hidden = [group for group in muon.param_groups if group.get("muon")]
    assert len(hidden) == 1 and all(min(p.shape[:2]) >= 32 for p in hidden[0]["params"])
    assert sum(len(group["params"]) for group in muon.param_groups) == len(list(stage.parameters()))
    assert [group["weight_decay"] for group in muon.param_groups] == [0.01, 0.01, 0.0]
    assert all(p.ndim == 1 for p in muon.param_groups[2]["params"])
    sgd = build_optimizer(stage, OptimConfig("sgd"))
    assert sgd.param_groups[0]["momentum"] == 0


def test_a_loss_that_is_not_finite_stops_the_run(tmp_path):
    config = tiny_run("hand_seg_net", iterations=20)
    config = dataclasses.replace(config, optim=OptimConfig("sgd", learning_rate=1e30))
    with pytest.raises(InputError, match="not finite at iteration"):
        train(config, SAMPLES, [], tmp_path / "run")


def test_config_survives_json():
    for stage in STAGES:
        config = tiny_run(stage, seed=9)
        assert TrainConfig.from_dict(config.to_dict()) == config
