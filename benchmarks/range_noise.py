"""How noise in the 2D and 3D joints reaches the range: the paper's key bone against all joints and the fit.

    python -m benchmarks.range_noise

Random hands over the whole image of the paper's camera (480x270), distance 25 to 60 cm, key bone 10 cm. Noise is
Gaussian: `px` per axis on the 2D joints, `canonical` per axis on the canonical pose (unit: hand length).
"""

import numpy as np
from tests.builders import CENTRED_CAMERA, random_hands

from twohands.geometry.canonical import canonical_from_camera
from twohands.geometry.projection import project_global
from twohands.skeleton import ROOT

NOISE = ((1.0, 0.0), (2.0, 0.0), (0.0, 0.03), (1.0, 0.03), (2.0, 0.05))
METHODS = ("keybone", "all-joints", "fitted")
HANDS = 40_000
HAND_LENGTH_M = 0.10


def main() -> None:
    rng = np.random.default_rng(0)
    joints_m, joints_px, length = random_hands(HANDS, CENTRED_CAMERA, rng)
    joints_m = joints_m * (HAND_LENGTH_M / length)[:, None, None]  # scaling the world keeps the picture
    radius = np.linalg.norm(joints_m[:, ROOT], axis=-1)
    kept = (radius > 0.25) & (radius < 0.60)
    joints_m, joints_px, radius = joints_m[kept], joints_px[kept], radius[kept]
    canonical = canonical_from_camera(joints_m).joints
    print(f"{kept.sum()} hands; error of the range in cm; a refused hand counts as a miss")
    print("| px | canonical | method | median | p90 | within 7 cm | refused |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for px, unit in NOISE:
        noisy_px = joints_px + px * rng.standard_normal(joints_px.shape)
        noise = unit * rng.standard_normal(canonical.shape)
        noise[:, ROOT] = 0
        for method in METHODS:
            pose = project_global(canonical + noise, noisy_px, CENTRED_CAMERA, HAND_LENGTH_M, method=method)
            error = np.where(pose.valid, 100 * np.abs(pose.radius_m - radius), np.inf)
            median, p90 = np.percentile(error, [50, 90], method="lower")
            row = f"{median:.2f} | {p90:.1f} | {(error <= 7).mean():.3f} | {(~pose.valid).mean():.4f}"
            print(f"| {px} | {unit} | {method} | {row} |")


if __name__ == "__main__":
    main()
