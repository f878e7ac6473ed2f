# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Measurements of targets that move with constant velocity: apart, crossing, in close pairs."""

from dataclasses import dataclass

import numpy as np
from startracker_ros.core.track.motion_models import constant_velocity

SIDE_PX = 1024
FRAMES = 40
DT_S = 0.1
SIGMA_PX = 0.15
ACCELERATION_PX_S2 = 0.2
DETECTION_PROBABILITY = 0.95
SPEED_PX_S = 8.0
CLOSE_PX = 0.6
SCENES = ('apart', 'crossing', 'close')

_START_VARIANCE = np.array([SIGMA_PX ** 2, 1.0, SIGMA_PX ** 2, 1.0])


@dataclass(frozen=True)
class Targets:
    """
    One run: truth (F + 1, N, 4) as in motion_models, from the start on.

    state (N, 4) and covariance (N, 4, 4) are the initial estimate of a filter; frames
    holds the centroids (M, 2) of each frame after it, in random order.
    """

    truth: np.ndarray
    state: np.ndarray
    covariance: np.ndarray
    frames: list[np.ndarray]


def moving_targets(kind: str, tracks: int, clutter: int, rng: np.random.Generator) -> Targets:
    """
    Return a run of one of the SCENES.

    Pairs that cross pass within a pixel at half time, at angles of 10 to 150 deg; close pairs
    begin CLOSE_PX apart side by side. All accelerate at random.
    """
    middle = _pairs(kind, (tracks + 1) // 2, rng)[:tracks]
    half = 0 if kind == 'close' else FRAMES // 2
    transition, _ = constant_velocity(DT_S, (ACCELERATION_PX_S2, ACCELERATION_PX_S2))
    back = np.linalg.inv(transition)
    truth = np.empty((FRAMES + 1, tracks, 4))
    truth[half] = middle
    # An acceleration along u changes u and u_rate, one along v the other two.
    acceleration = rng.normal(0, ACCELERATION_PX_S2, (FRAMES, tracks, 2))
    change = np.einsum('fna,ai->fni', acceleration, np.array(
        [[DT_S ** 2 / 2, DT_S, 0, 0], [0, 0, DT_S ** 2 / 2, DT_S]]))
    for frame in range(half, FRAMES):
        truth[frame + 1] = truth[frame] @ transition.T + change[frame]
    for frame in range(half, 0, -1):
        truth[frame - 1] = (truth[frame] - change[frame - 1]) @ back.T
    return Targets(
        truth, truth[0] + rng.normal(0, np.sqrt(_START_VARIANCE), (tracks, 4)),
        np.tile(np.diag(_START_VARIANCE), (tracks, 1, 1)),
        [_detections(truth[frame, :, ::2], clutter, rng) for frame in range(1, FRAMES + 1)])


def _pairs(kind: str, pairs: int, rng: np.random.Generator) -> np.ndarray:
    """Return states (2 P, 4) of pairs, one after another."""
    position = rng.uniform(0, SIDE_PX, (pairs, 1, 2)).repeat(2, axis=1)
    heading = rng.uniform(0, 2 * np.pi, (pairs, 1)).repeat(2, axis=1)
    aside = rng.uniform(0, 2 * np.pi, pairs)
    aside = np.stack([np.cos(aside), np.sin(aside)], -1)
    if kind == 'apart':
        position = rng.uniform(0, SIDE_PX, (pairs, 2, 2))
        heading = rng.uniform(0, 2 * np.pi, (pairs, 2))
    elif kind == 'crossing':
        heading[:, 1] += np.radians(rng.uniform(10, 150, pairs))
        position[:, 1] += rng.uniform(0, 1, (pairs, 1)) * aside
    else:
        position[:, 1] += CLOSE_PX * aside
    state = np.empty((pairs, 2, 4))
    state[..., ::2] = position
    state[..., 1] = SPEED_PX_S * np.cos(heading)
    state[..., 3] = SPEED_PX_S * np.sin(heading)
    return state.reshape(-1, 4)


def _detections(uv: np.ndarray, clutter: int, rng: np.random.Generator) -> np.ndarray:
    """Return the noisy positions of detected targets and the clutter, in random order."""
    seen = uv[rng.random(len(uv)) < DETECTION_PROBABILITY]
    return rng.permutation(np.concatenate([
        seen + rng.normal(0, SIGMA_PX, seen.shape), rng.uniform(0, SIDE_PX, (clutter, 2))]))
