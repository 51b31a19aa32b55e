"""What a camera adds to a picture: white balance, exposure, defocus, motion blur, noise, compression."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

REFERENCE_WIDTH = 480
"""Lengths in pixels are meant at this picture width."""


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """One camera's faults; `IDEAL` has none.

    Attributes:
        gain: (3,) exposure and white balance, factors of linear light.
        defocus_px: standard deviation of the blur, at `REFERENCE_WIDTH`.
        shake_px: (2,) how far the picture moves during the exposure, at `REFERENCE_WIDTH`.
        read_noise, shot_noise: standard deviation of the noise in black, and what full light adds to it, of 255.
        jpeg_quality: 1..100, or None for no compression.
        shrink: factor of the size at which the sensor took the picture that is then enlarged, 0..1.
        sharpening: strength of the halos that the camera draws along edges, 0 none.
        contrast: exponent of the tone curve about the middle, 1 none.
    """

    gain: np.ndarray
    defocus_px: float
    shake_px: np.ndarray
    read_noise: float
    shot_noise: float
    jpeg_quality: int | None
    shrink: float = 1.0
    sharpening: float = 0.0
    contrast: float = 1.0


IDEAL = Sensor(np.ones(3), 0.0, np.zeros(2), 0.0, 0.0, None)


def sample_sensor(strength: float, rng: np.random.Generator) -> Sensor:
    """A random camera: most are good, some out of focus, shaken, noisy or tightly compressed.

    Args:
        strength: 0 (ideal) to 1 (webcams and phones by day and night).
        rng: the only source of randomness.
    """
    if strength == 0:
        return IDEAL
    warmth = rng.normal(0, 0.10)
    gain = np.exp(strength * (rng.normal(0, 0.22) + np.array([warmth, 0.0, -warmth]) + rng.normal(0, 0.03, 3)))
    defocus = strength * abs(rng.normal(0, 0.9)) if rng.random() < 0.4 else 0.0
    shake = strength * (rng.random() < 0.25) * rng.exponential(3.0)
    angle = rng.uniform(0, np.pi)
    night = rng.beta(0.8, 3.0)
    quality = int(rng.uniform(100 - 65 * strength, 98)) if rng.random() < 0.5 else None
    direction = np.array([np.cos(angle), np.sin(angle)])
    return Sensor(gain, defocus, shake * direction, strength * 6 * night, strength * 10 * night, quality)


def sample_webcam(strength: float, rng: np.random.Generator) -> Sensor:
    """A random camera of the kind that sees people in rooms: webcams and telephones by lamplight, in video calls.

    Args:
        strength: 0 (ideal) to 1.
        rng: the only source of randomness.
    """
    if strength == 0:
        return IDEAL
    sensor = sample_sensor(strength, rng)
    gain, night = sensor.gain, 0.0
    if rng.random() < 0.25:  # lamplight: dark, warm and noisy
        night = rng.uniform(0.3, 1.0)
        warm = rng.uniform(-0.02, 0.22) * night
        gain = gain * np.exp(strength * (np.array([warm, 0.0, -1.4 * warm]) - rng.uniform(0.2, 1.3) * night))
    elif rng.random() < 0.12:  # a window behind, or exposed for a dark room
        gain = gain * np.exp(strength * rng.uniform(0.2, 0.7))
    return Sensor(
        gain,
        sensor.defocus_px,
        sensor.shake_px if rng.random() < 0.5 else np.zeros(2),
        sensor.read_noise + strength * 5 * night,
        sensor.shot_noise + strength * 7 * night,
        int(rng.uniform(100 - 75 * strength, 95)) if rng.random() < 0.7 else None,
        1 - strength * rng.uniform(0.1, 0.62) if rng.random() < 0.35 else 1.0,
        strength * rng.uniform(0.3, 1.6) if rng.random() < 0.35 else 0.0,
        float(np.exp(strength * rng.normal(0, 0.16))),
    )


def expose(image: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """The picture as this camera takes it.

    Args:
        image: (H, W, 3) uint8 RGB.
        sensor: the camera.
        rng: draws the noise.

    Returns:
        (H, W, 3) uint8 RGB; `image` itself for an ideal camera. Shapes stay where they are: shake is centred.
    """
    if sensor is IDEAL:
        return image
    size = image.shape[1], image.shape[0]
    scale = size[0] / REFERENCE_WIDTH
    linear = np.clip((np.arange(256)[:, None] / 255) ** 2.2 * sensor.gain, 0, 1)
    shown = linear ** (1 / 2.2)
    if sensor.contrast != 1.0:  # steeper or flatter about the middle, black and white stay
        high, low = shown**sensor.contrast, (1 - shown) ** sensor.contrast
        shown = high / (high + low)
    table = np.rint(255 * shown).astype(np.uint8)
    image = np.asarray(cv2.LUT(image, np.ascontiguousarray(table[None])))
    if sensor.shrink < 1.0:
        image = np.asarray(cv2.resize(image, None, fx=sensor.shrink, fy=sensor.shrink, interpolation=cv2.INTER_AREA))
    if sensor.defocus_px * scale > 0.2:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), sensor.defocus_px * scale))
    if np.hypot(*sensor.shake_px) * scale > 1:
        image = np.asarray(cv2.filter2D(image, -1, streak(sensor.shake_px * scale), borderType=cv2.BORDER_REPLICATE))
    if sensor.read_noise or sensor.shot_noise:
        level = sensor.read_noise + sensor.shot_noise * np.sqrt(np.arange(256, dtype=np.float32) / 255)
        noisy = rng.standard_normal(image.shape, dtype=np.float32)  # changed in place: new arrays take as long to fill
        noisy *= cv2.LUT(image, level.astype(np.float32))
        noisy += image
        noisy += np.float32(0.5)
        image = np.clip(noisy, 0, 255, out=noisy).astype(np.uint8)
    if sensor.sharpening:
        soft = cv2.GaussianBlur(image, (0, 0), 1.2 * scale * sensor.shrink + 0.3)
        image = np.asarray(cv2.addWeighted(image, 1 + sensor.sharpening, soft, -sensor.sharpening, 0))
    if sensor.jpeg_quality is not None:
        bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, sensor.jpeg_quality])
        image = cv2.cvtColor(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB)
    return image if sensor.shrink == 1.0 else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR))


def streak(shift: np.ndarray) -> np.ndarray:
    """(n, n) float32 kernel of a straight, even move by `shift` (2,) pixels, centred; sums to 1."""
    size = 2 * int(np.ceil(np.abs(shift).max() / 2)) + 1
    kernel = np.zeros((size, size), np.float32)
    steps = np.linspace(-0.5, 0.5, 8 * size)[:, None] * shift + size // 2
    low = np.floor(steps).astype(int)
    part = steps - low
    for du in (0, 1):
        for dv in (0, 1):
            weight = np.where(du, part[:, 0], 1 - part[:, 0]) * np.where(dv, part[:, 1], 1 - part[:, 1])
            np.add.at(kernel, (np.minimum(low[:, 1] + dv, size - 1), np.minimum(low[:, 0] + du, size - 1)), weight)
    return kernel / kernel.sum()
