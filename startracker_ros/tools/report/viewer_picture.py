# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
What a 3D viewer shows of a bag: python -m startracker_ros.tools.report.viewer_picture BAG [PNG].

Drawn by matplotlib out of the messages that the viewer configurations in config/ name, in the
same places: a picture of what to expect, not a screenshot.
"""

from pathlib import Path
import sys
from typing import Any

import numpy as np
from startracker_ros.core.maths.rotation import matrix_from_quaternion, rotate
from startracker_ros.core.stages.annotate import RETICLE_TICKS_PX, stretch
from startracker_ros.io.bags.layouts import INERTIAL_FRAME_ID, SENSOR_FRAME_ID
from startracker_ros.io.recordings.frames import read_frame
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.io.recordings.recording import Recording
from startracker_ros.tools.report.chart import picture

_DARK = '#05070d'


def draw_viewer(bag: Path, output: Path) -> None:
    """Write a PNG of the middle of a bag; BagError or ValueError when it has not all topics."""
    recording = load_recording(bag)
    common = np.intersect1d(np.intersect1d(recording.image_ns, recording.attitude_ns),
                            recording.tracks.stamp_ns)
    if not len(common):
        raise ValueError(f'{bag} has no frame with image, tracks and attitude')
    stamp_ns = int(common[len(common) // 2])
    image = read_frame(bag, recording, int(np.searchsorted(recording.image_ns, stamp_ns)))
    if image is None:
        raise ValueError(f'{bag} has no image of {stamp_ns} ns')
    with picture(output, 6, 112, facecolor='#e8eaee') as figure:
        grid = figure.add_gridspec(4, 3, width_ratios=(1, 1, 0.9))
        _draw_image(figure.add_subplot(grid[:3, 0]), image, recording, stamp_ns)
        _draw_sky(figure.add_subplot(grid[:3, 1], projection='3d'), recording, stamp_ns)
        _draw_states(figure.add_subplot(grid[3, :2]), recording)
        for row, (title, names, stamps, values) in enumerate(_plots(recording)):
            axes = figure.add_subplot(grid[row, 2])
            axes.set_title(title, loc='left')
            for name, column in zip(names, values):
                axes.plot((stamps - recording.image_ns[0]) / 1e9, column, label=name, linewidth=1)
            axes.axvline((stamp_ns - recording.image_ns[0]) / 1e9, color='gray', linewidth=0.8)
            axes.legend(fontsize=9, loc='upper right', ncols=4, handlelength=1)


def _draw_image(axes: Any, image: np.ndarray, recording: Recording, stamp_ns: int) -> None:
    frame = int(np.flatnonzero(recording.centroids.stamp_ns == stamp_ns)[0])
    rows = recording.centroids.of_frame(frame)
    axes.imshow(stretch(image), cmap='gray')
    ends = np.stack([rows['u'], rows['v']], -1)[:, None] + RETICLE_TICKS_PX
    for pair in ends.reshape(-1, 2, 2):
        axes.plot(*pair.T, color='#ffbe3c', linewidth=1)
    axes.set_title('image_raw and image_markers', loc='left')
    axes.set_axis_off()


def _draw_sky(axes: Any, recording: Recording, stamp_ns: int) -> None:
    quaternion = recording.quaternion[np.flatnonzero(recording.attitude_ns == stamp_ns)[0]]
    frame = int(np.flatnonzero(recording.tracks.stamp_ns == stamp_ns)[0])
    rows = recording.tracks.of_frame(frame)
    stars = rotate(quaternion, np.stack([rows[name] for name in 'xyz'], -1))
    axes.set_facecolor(_DARK)
    axes.set_axis_off()
    axes.scatter(*stars.T, c=rows['magnitude'], cmap='turbo', vmin=0, vmax=8, s=9)
    for matrix, length, label in ((np.eye(3), 0.4, INERTIAL_FRAME_ID), (
            matrix_from_quaternion(quaternion), 0.4, SENSOR_FRAME_ID)):
        for column, colour in enumerate(('#ff5555', '#55ff55', '#5599ff')):
            axes.plot(*np.stack([np.zeros(3), length * matrix[:, column]], -1), color=colour)
        axes.text(*(length * matrix[:, 2]), f'{label}\n', color='white',
                  ha='center', va='bottom')
    boresight = matrix_from_quaternion(quaternion)[:, 2]
    around = 0.5 * boresight[:, None] + [-0.36, 0.36]
    axes.set(xlim=around[0], ylim=around[1], zlim=around[2])
    axes.view_init(elev=25, azim=float(np.degrees(np.arctan2(boresight[1], boresight[0])) - 75))
    axes.set_title('tracks, in their place on the sky', loc='left')


def _draw_states(axes: Any, recording: Recording) -> None:
    time_s = (recording.state_frame_ns() - recording.image_ns[0]) / 1e9
    names = ('LOST', 'ACQUIRING', 'TRACKING')
    axes.step(time_s, [names.index(state) for state in recording.state], where='post')
    axes.set_yticks(range(len(names)), names)
    axes.set_title('tracker_state', loc='left')


def _plots(recording: Recording) -> list[tuple[str, tuple[str, ...], np.ndarray, np.ndarray]]:
    stamps = recording.attitude_ns
    matrix = matrix_from_quaternion(recording.quaternion)
    about_icrf = matrix @ recording.covariance_sensor @ np.swapaxes(matrix, 1, 2)
    return [
        ('attitude, q_icrf_from_sensor', tuple('xyzw'), stamps, recording.quaternion.T),
        ('body rate [rad/s]', tuple('xyz'), stamps, recording.rate_rad_s.T),
        ('attitude variance [rad^2]', tuple('xyz'), stamps,
         np.diagonal(about_icrf, axis1=1, axis2=2).T),
        ('stars', ('centroids', 'tracks'), recording.tracks.stamp_ns, np.stack([
            np.interp(recording.tracks.stamp_ns, recording.centroids.stamp_ns,
                      recording.centroids.count()), recording.tracks.count()]))]


if __name__ == '__main__':
    draw_viewer(Path(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else 'viewer.png'))
