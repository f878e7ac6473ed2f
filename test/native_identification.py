# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Lists of stars of all kinds, and a record of what the identification finds in them.

python test/native_identification.py writes the record with the code of this checkout. The stars
of test/native/identification.npz are those that the identification in Python found.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.identify.pyramid import PyramidIdentifier
from startracker_ros.core.maths.rotation import random_attitude

RECORD = Path(__file__).parent / 'native' / 'identification.npz'
EPOCH_YEAR = 2026.4
OPTIONS = IdentificationOptions(time_limit_s=2.0)
LISTS = 8
"""Of each camera and kind."""

CAMERAS = {
    '12 deg': Camera.from_fov(1024, 1024, 12.0),
    '40 deg': Camera.from_fov(1280, 960, 40.0),
    'fisheye': Camera(1000, 1000, 300.0, 300.0, 499.5, 499.5, (0.0,) * 4, 'equidistant'),
    '20 deg, distorted': Camera(1024, 1024, 2900.0, 2900.0, 511.5, 511.5,
                                (-0.1, 0.02, 1e-4, -1e-4, 0.0))}


class Kind(NamedTuple):
    """False spots, share of the stars that is missing, the brightest that are left."""

    false: int = 0
    missing: float = 0.0
    brightest: int = 1000
    mirrored: bool = False


KINDS = {
    'clean': Kind(), '30 false': Kind(30), '100 false': Kind(100), 'missing': Kind(0, 0.3),
    'false and missing': Kind(60, 0.3), 'no sky': Kind(30, 0.0, 0),
    'mirrored': Kind(mirrored=True),
    '5 stars': Kind(brightest=5), '6 stars and 4 false': Kind(4, brightest=6)}


class Listed(NamedTuple):
    """Centroids in random order, the numbers (N,) of their stars and the attitude (4,)."""

    camera: str
    kind: str
    centroids: Centroids
    hip: np.ndarray
    quaternion: np.ndarray


def random_list(identifier: PyramidIdentifier, kind: Kind, rng: np.random.Generator
                ) -> tuple[Centroids, np.ndarray, np.ndarray]:
    """Return centroids, numbers and attitude of a random field of six stars or more."""
    camera, sigma_px = identifier.camera, rng.uniform(0.05, 0.4)
    while True:
        q = random_attitude(rng)
        seen, hip = star_list(identifier.onboard, camera, q, sigma_px, rng)
        if len(seen) >= 6:
            break
    left = np.flatnonzero(rng.random(len(seen)) >= kind.missing)[:kind.brightest]
    fluxes = rng.choice(seen.flux, kind.false) * rng.uniform(0.9, 1.1, kind.false)
    spots = rng.uniform(-0.5, [camera.width - 0.5, camera.height - 0.5], (kind.false, 2))
    uv = np.concatenate([seen.uv[left], spots])
    if kind.mirrored:
        uv[:, 0] = camera.width - 1 - uv[:, 0]
    order = rng.permutation(len(uv))
    # As they are stored.
    uv, flux = (np.float32(array)[order].astype(float) for array in (
        uv, np.concatenate([seen.flux[left], fluxes])))
    numbers = np.concatenate([hip[left], np.zeros(kind.false, np.int32)])[order]
    count = len(uv)
    return Centroids(uv, flux, np.full(count, 50.0), np.full(
        count, float(np.float32(sigma_px)))), numbers, q


def identifiers() -> dict[str, PyramidIdentifier]:
    """Return that of each camera."""
    return {name: PyramidIdentifier(camera, EPOCH_YEAR, OPTIONS)
            for name, camera in CAMERAS.items()}


def write_record() -> None:
    """Write lists and results."""
    rng = np.random.default_rng(61)
    rows: list[tuple] = []
    columns: dict[str, list] = {name: [] for name in (
        'uv', 'flux', 'hip', 'found', 'residual_px')}
    for camera, identifier in identifiers().items():
        for kind, how in KINDS.items():
            for _ in range(LISTS):
                centroids, hip, q = random_list(identifier, how, rng)
                found = identifier.identify(centroids)
                attitude = found.attitude
                for name, array in (('uv', centroids.uv), ('flux', centroids.flux), ('hip', hip),
                                    ('found', found.hip), ('residual_px', found.residual_px)):
                    columns[name].append(array)
                sigma_px = float(centroids.sigma_px[0])
                rows.append((
                    camera, kind, len(centroids), sigma_px, found.status,
                    found.focal_ratio, np.log(max(found.false_alarm_probability, 1e-300)), *q,
                    *(np.full(4, np.nan) if attitude is None else attitude.quaternion),
                    *(np.full(3, np.nan) if attitude is None else
                      np.sqrt(np.diag(attitude.covariance_sensor)))))
    names = np.array([row[:2] for row in rows])
    np.savez_compressed(
        RECORD, names=names, count=[row[2] for row in rows],
        sigma_px=np.float32([row[3] for row in rows]), status=[row[4] for row in rows],
        figures=np.array([row[5:] for row in rows]),
        uv=np.float32(np.concatenate(columns['uv'])),
        flux=np.float32(np.concatenate(columns['flux'])),
        hip=np.int32(np.concatenate(columns['hip'])),
        found=np.int32(np.concatenate(columns['found'])),
        residual_px=np.float32(np.concatenate(columns['residual_px'])))


if __name__ == '__main__':
    write_record()
