"""Labelled pictures of drawn hands, and their mirror images."""

import dataclasses

import numpy as np
from tests.builders import make_sample

from twohands.skeleton import LEFT, part_label
from twohands.types import HandSample


def sample(seed: int = 0, **options) -> HandSample:
    """A drawn picture; options as `make_sample`."""
    return make_sample(np.random.default_rng(seed), **options)


def with_arm(original: HandSample) -> HandSample:
    """The picture with what is behind its hands in its left third labelled as the left arm."""
    labels = original.labels.copy()
    left = labels[:, : labels.shape[1] // 3]
    left[left == 0] = part_label(LEFT, 0)
    return dataclasses.replace(original, labels=labels)


def mirrored(original: HandSample) -> HandSample:
    """The picture in a mirror: columns reversed, left and right hands swapped."""
    width = original.image.shape[1]
    labels = original.labels[:, ::-1]
    swapped = np.where(labels == 0, 0, np.where(labels > 7, labels - 7, labels + 7)).astype(np.uint8)
    return dataclasses.replace(
        original,
        image=np.ascontiguousarray(original.image[:, ::-1]),
        labels=np.ascontiguousarray(swapped),
        joints_px=original.joints_px[::-1] * [-1, 1] + [width, 0],
        joints_m=original.joints_m[::-1] * [-1, 1, 1],
        present=original.present[::-1],
        valid=original.valid[::-1],
    )
