# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a recorded run says of a target that two observers located: arrays, figures, picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from startracker_ros.core.astro.orbit import orbit_frame
from startracker_ros.core.attitude.result import WRONG_SIGMAS
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.tools.figures.correctness import nees_of
from startracker_ros.tools.figures.rows import DemoRow
from startracker_ros.tools.report.chart import draw_errors, draw_field, picture


@dataclass(frozen=True)
class Sightings:
    """One star tracker's share: stamps (ns) of its images, attitudes and target centroids."""

    image_ns: np.ndarray
    attitude_ns: np.ndarray
    target_ns: np.ndarray


@dataclass(frozen=True)
class TargetRecording:
    """
    Positions of a target and the truth at the same stamps, sorted.

    stamp_ns (N,); position_m (N, 3) and covariance_m2 (N, 3, 3) as located, truth_m and
    truth_velocity_m_s (N, 3), on ICRF axes; sightings by namespace.
    """

    stamp_ns: np.ndarray
    position_m: np.ndarray
    covariance_m2: np.ndarray
    truth_m: np.ndarray
    truth_velocity_m_s: np.ndarray
    sightings: dict[str, Sightings]

    def errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the errors and their sigmas (N, 3) in m: along the orbit, across it, inwards."""
        axes = orbit_frame(self.truth_m, self.truth_velocity_m_s)
        turned = np.swapaxes(axes, 1, 2) @ self.covariance_m2 @ axes
        return (np.einsum('nij,ni->nj', axes, self.position_m - self.truth_m),
                np.sqrt(np.diagonal(turned, axis1=1, axis2=2)))

    def normalised(self) -> np.ndarray:
        """Return the squared errors (N,) in units of the covariance."""
        return nees_of(self.position_m - self.truth_m, self.covariance_m2)


def _xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def load_target(bag: Path, observers: tuple[str, str]) -> TargetRecording:
    """Read what both observers saw, where the target was located and where it was."""
    stamps: dict[str, list[int]] = {
        f'/{name}/{topic}': [] for name in observers
        for topic in ('truth/attitude', 'attitude_cov', 'target_centroid')}
    position, covariance, truth = {}, {}, {}
    truths = [f'/{name}/truth/target' for name in observers]
    for record in read_messages(bag, topics=('/target/position', *truths, *stamps)):
        message = record.decoded()
        stamp_ns = message.header.stamp.sec * 10 ** 9 + message.header.stamp.nanosec
        if record.topic == '/target/position':
            position[stamp_ns] = _xyz(message.pose.pose.position)
            covariance[stamp_ns] = np.reshape(message.pose.covariance, (6, 6))[:3, :3]
        elif record.topic in truths:
            truth[stamp_ns] = (_xyz(message.pose.pose.position),
                               _xyz(message.twist.twist.linear))
        elif not record.topic.endswith('target_centroid') or message.width:
            stamps[record.topic].append(stamp_ns)
    common = sorted(position.keys() & truth.keys())

    def array(values: list, *shape: int) -> np.ndarray:
        return np.array(values, float).reshape(-1, *shape)
    return TargetRecording(
        np.array(common, np.int64), array([position[stamp] for stamp in common], 3),
        array([covariance[stamp] for stamp in common], 3, 3),
        array([truth[stamp][0] for stamp in common], 3),
        array([truth[stamp][1] for stamp in common], 3),
        {name: Sightings(*(np.array(sorted(stamps[f'/{name}/{topic}']), np.int64) for topic in (
            'truth/attitude', 'attitude_cov', 'target_centroid'))) for name in observers})


def summarise_target(recording: TargetRecording, frames: int) -> list[DemoRow]:
    """Return the figures of a run with so many frames each."""
    rows = []
    for name, seen in recording.sightings.items():
        images = len(seen.image_ns)
        rows += [DemoRow(f'{name}: images', images, 'frames', exactly=frames),
                 _share_row(f'{name}: frames with attitude', seen.attitude_ns, seen.image_ns),
                 _share_row(f'{name}: frames with target', seen.target_ns, seen.image_ns)]
    image_ns = next(iter(recording.sightings.values())).image_ns
    rows.append(_share_row('frames with the target located', recording.stamp_ns, image_ns))
    if not len(recording.stamp_ns):
        return rows
    start_s = (recording.stamp_ns[0] - image_ns[0]) / 1e9
    error_m, sigma_m = (float(np.sqrt(np.mean(np.sum(values ** 2, axis=1))))
                        for values in recording.errors())
    squared = recording.normalised()
    wrong = int(np.count_nonzero(squared > WRONG_SIGMAS ** 2))
    return [
        *rows, DemoRow.with_goal('first image to first position', start_s, 's', 10.0),
        DemoRow('error of the position, rms', error_m, 'm'),
        DemoRow('sigma of the position, rms', sigma_m, 'm'),
        DemoRow('normalised error squared, mean of 3 expected', float(squared.mean()), '',
                '< 4', squared.mean() < 4),
        DemoRow('wrong positions', wrong, 'frames', exactly=0)]


def _share_row(case: str, stamps: np.ndarray, image_ns: np.ndarray) -> DemoRow:
    """Return the share of images with a result, from the first result on: acquisition is free."""
    since = image_ns >= stamps.min(initial=image_ns.max(initial=0))
    share = 100 * len(stamps) / max(1, int(np.count_nonzero(since)))
    return DemoRow(f'{case}, from the first on', share, '%', least=90)


def draw_target(path: Path, recording: TargetRecording, pictures: dict[str, tuple]) -> None:
    """Write a PNG; pictures holds image (H, W), uv (N, 2), hip (N,) and the target's uv (2,)."""
    error, sigma = recording.errors()
    time_s = (recording.stamp_ns - recording.stamp_ns[0]) / 1e9
    with picture(path, 9.5, 130) as figure:
        grid = figure.add_gridspec(4, 2, height_ratios=(3.2, 1, 1, 1))
        for column, (name, (image, uv, hip, target)) in enumerate(pictures.items()):
            field = figure.add_subplot(grid[0, column])
            draw_field(field, image, uv, hip, f'{name}: {len(uv)} tracked stars',
                       bare=target[None])
            field.plot(*target, 's', markersize=16, markerfacecolor='none', markeredgecolor='red')
            field.annotate('target', target, (12, 8), textcoords='offset points', color='red')
        axes = draw_errors([grid[row, :] for row in (1, 2, 3)], time_s, error, sigma,
                           ('along track', 'cross track', 'radial'), 'm',
                           'error of the located target against truth')
        axes[-1].set_xlabel('time since the first position [s]')
