"""Turn trained checkpoints into a weights folder that track can use."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from twohands.cli.output import check_output_folder
from twohands.errors import InputError


@dataclass(frozen=True)
class ExportArgs:
    """Arguments of `twohands export`."""

    hand_seg_net: Path
    """Checkpoint of HandSegNet (hand_seg_net.safetensors of its run)."""
    pose_net_2d: Path
    """Checkpoint of PoseNet2D; if it was trained along with PoseNet3D, the one in that run."""
    pose_net_3d: Path
    """Checkpoint of PoseNet3D."""
    out: Path
    """Folder to write: three ONNX files and card.json."""
    name: str | None = None
    """Name of the preset; default the folder's name."""
    int8: bool = False
    """Run the two large networks in 8 bits: how large their activations get is measured on generated pictures."""
    overwrite: bool = False
    """Write into a folder that already holds something."""


def run(args: ExportArgs) -> int:
    """Export and print what was written."""
    from twohands.export.onnx import export_preset

    name = args.name if args.name is not None else args.out.resolve().name
    if not name:
        raise InputError("the preset needs a name: --name NAME")
    check_output_folder(args.out, overwrite=args.overwrite)
    checkpoints = {
        "hand_seg_net": args.hand_seg_net,
        "pose_net_2d": args.pose_net_2d,
        "pose_net_3d": args.pose_net_3d,
    }
    export_preset(checkpoints, args.out, name=name)
    if args.int8:
        from twohands.export.calibration import add_int8, generated_pictures

        add_int8(args.out, generated_pictures())
    for file in sorted(args.out.iterdir()):
        print(f"{file}  {file.stat().st_size / 1e6:.2f} MB")
    return 0
