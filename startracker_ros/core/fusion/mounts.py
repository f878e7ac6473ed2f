# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Mounts of the heads on the body, with the law by which they bend, and their file.

A mount is q_body_from_sensor: v_body = R(q) v_sensor. The true one is exp([m]x) R(q) with the
misalignment m(t) = sum_k phi_k(t) c_k about body axes: phi is 1, the temperature of the head
above its reference, and cosine and sine of the orbit, as far as estimated. The phase of the
orbit counts from stamp 0, so that it lasts over a restart.
"""

from dataclasses import dataclass
import math
from pathlib import Path

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.core.options import option, Options
from startracker_ros.core.yaml_text import read_yaml
import yaml

_NORM_TOLERANCE = 1e-3


class MountError(ValueError):
    """A mounts file that cannot be used; the text says what and where."""


@dataclass(frozen=True)
class MountOptions(Options):
    """How mounts may differ from their file, and how they change."""

    mount_sigma_arcsec: float = option(
        10.0, 'mounts without a covariance in mounts_file are known to this, 1 sigma per axis: '
        'what a head may differ from the others without being wrong',
        unit='arcsec', low=0.0, high=36000.0)
    mount_walk_arcsec_sqrt_h: float = option(
        0.5, 'random walk of a mount, each axis: what no law explains',
        unit='arcsec/sqrt(h)', low=0.0, high=1000.0)
    mount_temperature_arcsec_k: float = option(
        0.0, 'how much a mount may bend with the temperature of its head, 1 sigma of each axis; '
        '0: nothing is estimated of it', unit='arcsec/K', low=0.0, high=1000.0)
    mount_orbit_arcsec: float = option(
        0.0, 'how much a mount may bend with the period of the orbit, 1 sigma of cosine and of '
        'sine; 0: nothing is estimated of it', unit='arcsec', low=0.0, high=1000.0)
    orbit_period_s: float = option(
        5700.0, 'period of the orbit for mount_orbit_arcsec', unit='s', low=60.0, high=1e7)


@dataclass(frozen=True)
class Mount:
    """
    The mount of one head.

    quaternion (4,) is q_body_from_sensor. covariance (3, 3) rad^2 is that of its misalignment
    about body axes, None where it is unknown. The head's stamps are time_offset_s late, which is
    subtracted. law (3, 3) holds what was estimated about body axes: rad/K, rad of cosine, rad of
    sine. law_covariance (12, 12) is that of misalignment and law. temperature_c is where the first
    of the law is zero, NaN where it is unknown.
    """

    quaternion: np.ndarray
    covariance: np.ndarray | None = None
    time_offset_s: float = 0.0
    law: np.ndarray | None = None
    law_covariance: np.ndarray | None = None
    temperature_c: float = math.nan


_KNOWN = {'covariance_rad2': 'has_covariance', 'law': 'has_law',
          'law_covariance': 'has_law_covariance'}
"""Fields of a MOUNT that may be unknown, and those that tell."""


def native_mount(mount: Mount) -> np.ndarray:
    """Return a MOUNT."""
    made = np.zeros((), native.MOUNT)
    made['quaternion'], made['time_offset_s'], made['temperature_c'] = (
        mount.quaternion, mount.time_offset_s, mount.temperature_c)
    for name, value in zip(_KNOWN, (mount.covariance, mount.law, mount.law_covariance)):
        if value is not None:
            made[name], made[_KNOWN[name]] = value, 1
    return made


def mount_of(mount: np.ndarray) -> Mount:
    """Return the mount of a MOUNT."""
    covariance, law, law_covariance = (
        mount[name].copy() if mount[known] else None for name, known in _KNOWN.items())
    return Mount(mount['quaternion'].copy(), covariance, float(mount['time_offset_s']), law,
                 law_covariance, float(mount['temperature_c']))


def load_mounts(path: str | Path, heads: tuple[str, ...]) -> dict[str, Mount]:
    """Return the mounts of the named heads; MountError names what is wrong in the file."""
    try:
        document = read_yaml(path)
        entries = document.get('heads') if isinstance(document, dict) else None
        if not isinstance(entries, dict):
            raise MountError('no heads: with a mount for each head')
        missing = [head for head in heads if head not in entries]
        if missing:
            raise MountError(f'no mount of {missing[0]}; it has {", ".join(map(str, entries))}')
        return {head: _mount(head, entries[head]) for head in heads}
    except OSError as error:
        raise MountError(f'mounts file {path}: {error.strerror}') from error
    except ValueError as error:
        raise MountError(f'mounts file {path}: {error}') from error


def _mount(head: str, entry: object) -> Mount:
    """Return the mount of one head of the document."""
    if not isinstance(entry, dict):
        raise MountError(f'{head} is not a mapping with a quaternion')
    quaternion = _numbers(head, entry, 'quaternion', (4,))
    if quaternion is None:
        raise MountError(f'{head} has no quaternion')
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > _NORM_TOLERANCE:
        raise MountError(f'quaternion of {head} is of norm {norm:.4f}, a rotation has norm 1')
    offset = _numbers(head, entry, 'time_offset_s', ())
    temperature = _numbers(head, entry, 'temperature_c', ())
    covariance = _numbers(head, entry, 'covariance_arcsec2', (3, 3))
    law = _numbers(head, entry, 'law_arcsec', (3, 3))
    law_covariance = _numbers(head, entry, 'law_covariance_arcsec2', (12, 12))
    for name, matrix in (('covariance_arcsec2', covariance),
                         ('law_covariance_arcsec2', law_covariance)):
        if matrix is not None and not _is_covariance(matrix):
            raise MountError(f'{name} of {head} is not a covariance')
    return Mount(quaternion / norm, None if covariance is None else covariance * ARCSEC ** 2,
                 0.0 if offset is None else float(offset),
                 None if law is None else law * ARCSEC,
                 None if law_covariance is None else law_covariance * ARCSEC ** 2,
                 math.nan if temperature is None else float(temperature))


def _is_covariance(matrix: np.ndarray) -> bool:
    """Return whether a symmetric matrix has no negative eigenvalue but by rounding."""
    eigenvalues = np.linalg.eigvalsh(matrix)
    return bool(np.allclose(matrix, matrix.T) and eigenvalues[0] >= -1e-9 * eigenvalues[-1])


def _numbers(head: str, entry: dict, name: str, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return an element of an entry as an array, None where it is missing."""
    if entry.get(name) is None:
        return None
    try:
        values = np.array(entry[name], float)
        values = values.reshape(shape)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if not np.isfinite(values).all():
        count = math.prod(shape)
        raise MountError(f'{name} of {head} must be {count} finite number{"s" * (count > 1)}')
    return values


def save_mounts(mounts: dict[str, Mount], path: str | Path) -> None:
    """Write mounts; OSError where that fails. The old file lasts until the new one is whole."""
    document = {'heads': {head: _entry(mount) for head, mount in mounts.items()}}
    target = Path(path)
    partial = target.with_name(target.name + '.part')
    partial.write_text(yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
    partial.replace(target)


def _entry(mount: Mount) -> dict[str, object]:
    """Return the entry of one head of the document."""
    entry: dict[str, object] = {
        'quaternion': mount.quaternion.tolist(), 'time_offset_s': mount.time_offset_s}
    for name, matrix, unit in (
            ('covariance_arcsec2', mount.covariance, ARCSEC ** 2),
            ('law_arcsec', mount.law, ARCSEC),
            ('law_covariance_arcsec2', mount.law_covariance, ARCSEC ** 2)):
        if matrix is not None:
            entry[name] = (matrix / unit).ravel().tolist()
    if math.isfinite(mount.temperature_c):
        entry['temperature_c'] = mount.temperature_c
    return entry
