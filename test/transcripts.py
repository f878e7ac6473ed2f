# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Twenty runs of the star tracker, frame by frame: what goes into every stage and what it gives.

python test/transcripts.py [NAME ...] writes test/golden, a compressed archive of arrays for each
run. A change of the code that is to change nothing, as a port to another language, is compared
with them: stars, states and reasons are the same, figures are to a share of their own sigma.

Arrays of an archive, F frames, the C centroids, T tracks and I identified stars of all frames one
after the other:

    centroid (C, 11)     u, v px, flux DN, snr, sigma_px, covariance uu, uv, vv px^2, delay s,
                         exposure s, least and largest; centroids (F,) are those of each frame
    identified (I,)      HIP numbers of the centroids of frames with an identification, 0 unknown;
                         identifications (F,), -1 where the frame needed none
    track (T, 4)         HIP number, u, v px, track number from 0 on; tracks (F,)
    state, reason (F,)   text
    attitude (F, 32)     quaternion 4, covariance 9, rate 3, its covariance 9, protection 3,
                         acceleration after the frame 3, stars 1; NaN where there is none
"""

from collections.abc import Iterator
from pathlib import Path
import sys

import numpy as np
from startracker_evaluation.campaign.integrity import CONDITIONS, IMAGE_CONDITIONS, run_of
from startracker_evaluation.campaign.integrity_motion import MOTION_CONDITIONS, motion_frames
from startracker_ros.core.frame_result import FrameResult
from startracker_ros.tools.datasheet.image_runs import image_frames

FOLDER = Path(__file__).parent / 'golden'
FRAMES = 40
SEED, DARK_SEED = 10, 6
"""Of runs in which the fault comes within five times so many frames."""

LISTS = ('slews to 3 deg/s, gyro', 'slews, gyro in deg/s', '30 false, 20 % missing',
         'dark for 2 s at 0.3 deg/s, gyro', 'turned away at once', 'half of the image covered')
MOTIONS = ('list, sway 0.05 deg, 1 s, exposed 0.1 s', 'list, steps of 0.5 deg/s each second',
           'list, ramps of 0.5 deg/s^2, 4 s, rolling shutter', 'list, timestamp errors of 5 ms',
           'list, torques of 0.2 deg/s^2, 2 s, exposed 0.1 s',
           'list, three images in a row one frame late, 1 deg/s',
           'list, sway 0.2 deg, 2 s, exposed 0.1 s, 1280 x 960 px, 40 deg')
IMAGES = ('clean images', 'smear 5 deg/s, 20 ms', 'rolling shutter 1 deg/s',
          'torn frames 1 deg/s', 'start with 100 spots', 'kicks of 40 arcsec',
          'debris, 150 of 3 px')
NAMES = LISTS + MOTIONS + IMAGES


def frames_of(name: str) -> Iterator[FrameResult]:
    """Yield the frames of a run."""
    rng = np.random.default_rng(DARK_SEED if name.startswith('dark') else SEED)
    if name in LISTS:
        for index, (_, frame, _, _) in enumerate(run_of(CONDITIONS[name], rng)):
            if index < 5 * FRAMES:
                yield frame
    elif name in MOTIONS:
        for frame, _, _ in motion_frames(MOTION_CONDITIONS[name], rng, FRAMES):
            yield frame
    else:
        for index, (frame, _) in enumerate(image_frames(IMAGE_CONDITIONS[name], SEED)):
            yield frame
            if index + 1 == FRAMES:
                break


def transcript(name: str) -> dict[str, np.ndarray]:
    """Return the arrays of a run."""
    frames = list(frames_of(name))
    track = np.concatenate([np.column_stack([
        one.tracks.hip, one.tracks.uv, one.tracks.track_id]) for one in frames])
    # A tracker numbers on after a reset.
    track[:, 3] -= track[:, 3].min(initial=np.inf)
    return {
        'centroids': np.array([len(one.centroids) for one in frames], np.int32),
        'centroid': np.concatenate([_centroids(one) for one in frames]),
        'identifications': np.array([
            -1 if one.identification is None else len(one.identification.hip)
            for one in frames], np.int32),
        'identified': np.concatenate([np.empty(0, np.int32), *(
            one.identification.hip for one in frames if one.identification is not None)]),
        'tracks': np.array([len(one.tracks) for one in frames], np.int32),
        'track': track,
        'state': np.array([str(one.state) for one in frames]),
        'reason': np.array([one.reason for one in frames]),
        'attitude': np.array([_attitude(one) for one in frames])}


def _centroids(frame: FrameResult) -> np.ndarray:
    seen = frame.centroids
    exposure_s = np.broadcast_to(seen.exposure_s, (len(seen), 2))
    return np.column_stack([
        seen.uv, seen.flux, seen.snr, seen.sigma_px, seen.covariance[:, 0, 0],
        seen.covariance[:, 0, 1], seen.covariance[:, 1, 1], seen.delay_s, exposure_s])


def _attitude(frame: FrameResult) -> np.ndarray:
    one = frame.attitude
    return np.full(32, np.nan) if one is None else np.concatenate([
        one.quaternion, one.covariance_sensor.ravel(), one.rate_rad_s,
        one.rate_covariance.ravel(), one.protection_rad, one.acceleration_rad_s2, [one.stars]])


def path_of(name: str) -> Path:
    """Return the archive of a run."""
    letters = ''.join(letter if letter.isalnum() else '_' for letter in name)
    return FOLDER / f'{letters}.npz'


if __name__ == '__main__':
    FOLDER.mkdir(exist_ok=True)
    for wanted in sys.argv[1:] or NAMES:
        np.savez_compressed(path_of(wanted), **transcript(wanted))
        print(path_of(wanted), path_of(wanted).stat().st_size // 1000, 'kB')
