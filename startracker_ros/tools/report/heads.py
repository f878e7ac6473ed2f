# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Several heads of a body out of a bag: which count, and their mounts against the truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, multiply, rotation_vector_from_quaternion)
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.bags.reader import read_messages, read_topics
from startracker_ros.io.recordings.loading import HEADS_TOPIC, is_fusion
from startracker_ros.io.recordings.recording import full_name
from startracker_ros.tools.report.panels import Panel, Panels

USED = 'used'


@dataclass(frozen=True)
class MountSeries:
    """
    A mount as estimated, by time.

    quaternion (K, 4) q_body_from_sensor at stamp_ns (K,) with covariance (K, 3, 3) rad^2 about
    body axes; truth (K, 4), NaN where the bag has none.
    """

    stamp_ns: np.ndarray
    quaternion: np.ndarray
    covariance: np.ndarray
    truth: np.ndarray

    def change_arcsec(self) -> np.ndarray:
        """Return the rotations (K, 3) about body axes from the first mount to each."""
        return _rotations_arcsec(self.quaternion, self.quaternion[:1])

    def error_arcsec(self) -> np.ndarray:
        """Return the rotations (K, 3) about body axes from the truth, NaN where it is unknown."""
        return _rotations_arcsec(self.quaternion, self.truth)

    def sigma_arcsec(self) -> np.ndarray:
        """Return 1 sigma (K, 3) about body axes."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)) / ARCSEC


@dataclass(frozen=True)
class HeadsRecording:
    """
    The heads of a fusion.

    conditions by head from changed_ns (C,) on, as the topic heads has them; mounts are those that
    are estimated: without that of the reference.
    """

    changed_ns: np.ndarray
    conditions: dict[str, tuple[str, ...]]
    mounts: dict[str, MountSeries]

    def in_use(self, stamp_ns: np.ndarray) -> dict[str, np.ndarray]:
        """Return whether each head counts at stamps (N,)."""
        # The condition before the first message is unknown: index -1.
        index = np.searchsorted(self.changed_ns, stamp_ns, 'right') - 1
        return {name: np.array([*(condition == USED for condition in conditions), False])[index]
                for name, conditions in self.conditions.items()}


def load_heads(bag: Path, namespace: str = '', *, tolerant: bool = False
               ) -> HeadsRecording | None:
    """
    Return the heads of the fusion in a namespace, None where the bag has no such topics.

    BagError when the bag cannot be read.
    """
    topics = read_topics(bag, tolerant=tolerant)
    if not is_fusion(topics, namespace):
        return None
    changed_ns: list[int] = []
    found: list[dict[str, str]] = []
    for record in read_messages(bag, topics=(full_name(namespace, HEADS_TOPIC),),
                                tolerant=tolerant):
        message = record.decoded()
        changed_ns.append(ns_from_stamp(message.header.stamp))
        found.append({status.hardware_id: status.message for status in message.status})
    names = list(dict.fromkeys(name for one in found for name in one))
    body = _attitudes(bag, full_name(namespace, 'truth/attitude'), tolerant)
    mounts = {}
    for name in names:
        series = _mounts(bag, full_name(namespace, f'{name}/mount'), body, _attitudes(
            bag, full_name(namespace, f'{name}/truth/attitude'), tolerant), tolerant)
        # The covariance of the reference is zero: its mount defines the body.
        if len(series.stamp_ns) and series.covariance.any():
            mounts[name] = series
    return HeadsRecording(np.array(changed_ns, np.int64), {
        name: tuple(one.get(name, '') for one in found) for name in names}, mounts)


def _attitudes(bag: Path, topic: str, tolerant: bool) -> dict[int, np.ndarray]:
    """Return the quaternions (4,) of a topic by stamp."""
    found = {}
    for record in read_messages(bag, topics=(topic,), tolerant=tolerant):
        message = record.decoded()
        found[ns_from_stamp(message.header.stamp)] = _quaternion(message.quaternion)
    return found


def _mounts(bag: Path, topic: str, body: dict[int, np.ndarray], head: dict[int, np.ndarray],
            tolerant: bool) -> MountSeries:
    """Return the mounts of a topic; the truth is that of body and head at the same stamp."""
    stamps, quaternions, covariances, truths = [], [], [], []
    for record in read_messages(bag, topics=(topic,), tolerant=tolerant):
        message = record.decoded()
        stamp_ns = ns_from_stamp(message.header.stamp)
        stamps.append(stamp_ns)
        quaternions.append(_quaternion(message.pose.pose.orientation))
        covariances.append(np.reshape(message.pose.covariance, (6, 6))[3:, 3:])
        truths.append(multiply(conjugate(body[stamp_ns]), head[stamp_ns])
                      if stamp_ns in body and stamp_ns in head else np.full(4, np.nan))
    return MountSeries(np.array(stamps, np.int64), np.reshape(quaternions, (-1, 4)),
                       np.reshape(covariances, (-1, 3, 3)), np.reshape(truths, (-1, 4)))


def _quaternion(message: object) -> np.ndarray:
    return np.array([getattr(message, name) for name in 'xyzw'])


def _rotations_arcsec(q: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the rotations (K, 3) about the axes of the frame that both (K, 4) lead to."""
    return rotation_vector_from_quaternion(multiply(q, conjugate(other))) / ARCSEC


def head_states(panels: Panels, heads: HeadsRecording) -> list[dict[str, Any]]:
    """Return name and intervals of the conditions of each head."""
    return [{'name': name, 'states': panels.intervals(heads.changed_ns, conditions)}
            for name, conditions in heads.conditions.items()]


def mount_panels(panels: Panels, heads: HeadsRecording) -> list[Panel]:
    """
    Return panels of each estimated mount about body x, y, z, with 3 sigma.

    Drawn is the error where the bag has the truth of body and head, elsewhere the change since the
    first mount, between its 3 sigma bounds.
    """
    found = []
    for number, (name, series) in enumerate(heads.mounts.items()):
        error, three = series.error_arcsec(), 3 * series.sigma_arcsec()
        known, change = np.isfinite(error).any(), series.change_arcsec()
        for axis, letter in enumerate('xyz'):
            curves = ([('3 sigma', 'band', three), ('error', 'dots', error)] if known else
                      [('change', 'line', change), ('+3 sigma', 'line', change + three),
                       ('\u22123 sigma', 'line', change - three)])
            found.append({
                'id': f'mount-{number}-{letter}', 'title': f'mount of {name}, body {letter}',
                'unit': 'arcsec', 'series': [panels.series(
                    label, kind, series.stamp_ns, values[:, axis], 4)
                    for label, kind, values in curves]})
    return found
