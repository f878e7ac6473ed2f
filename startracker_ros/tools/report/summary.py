# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A recorded run in figures, each with its bound or its goal, and as a picture."""

from pathlib import Path

import numpy as np
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.io.recordings.recording import Recording
from startracker_ros.tools.figures.correctness import count_wrong
from startracker_ros.tools.figures.rows import DemoRow, goal_text, within
from startracker_ros.tools.report.chart import draw_errors, draw_field, picture

_LATENCY_GOALS_MS = {50: 6.0, 95: 10.0}
"""Those of `bench pipeline` for a process each."""


def summarise(recording: Recording, frames: int | None = None) -> list[DemoRow]:
    """Return the figures of a recording of so many frames, by default those of its images."""
    images, wanted = len(recording.image_ns), frames
    rows = [DemoRow('images', images, 'frames', *(
        ('> 0', images > 0) if wanted is None else (f'= {wanted}', images == wanted)))]
    lost = len(np.setdiff1d(recording.image_ns, recording.centroids_ns))
    expected = _expected_frames(recording.image_ns) if wanted is None else wanted
    dropped = expected - images + lost
    rows.append(DemoRow('frames dropped', dropped, 'frames', exactly=0))
    rows.append(_bag_row(recording, expected))
    stamps, error, sigma = recording.errors()
    share = 100 * len(recording.attitude_ns) / max(1, images)
    rows.append(DemoRow('frames with attitude', share, '%', '> 0', share > 0,
                        goal_text(*within(share, least=95))))
    rows += _rows_without_attitude(recording)
    if not len(stamps):
        return rows
    for name, axes, each in (('cross-boresight', slice(0, 2), 'rms each axis'),
                             ('roll', slice(2, 3), 'rms')):
        for kind, values in (('error', error), ('sigma', sigma)):
            rms = float(np.sqrt(np.mean(values[:, axes] ** 2)))
            rows.append(DemoRow(f'{name} {kind}, {each}', rms, 'arcsec'))
    wrong, gross = count_wrong(error * ARCSEC, sigma * ARCSEC)
    start_s = (recording.attitude_ns[0] - recording.image_ns[0]) / 1e9
    latency_ms = recording.latency_ms()
    return [
        *rows, DemoRow('wrong attitudes', wrong, 'frames', exactly=0),
        DemoRow('gross attitudes', gross, 'frames', exactly=0),
        *_protection_rows(recording),
        DemoRow('first image to first attitude', start_s, 's'),
        *(DemoRow.with_goal(f'image sent to attitude received, p{percent}',
                            float(np.percentile(latency_ms, percent)), 'ms', goal)
          for percent, goal in _LATENCY_GOALS_MS.items())]


def _protection_rows(recording: Recording) -> list[DemoRow]:
    """Return how many frames exceed their protection level, none where none was published."""
    known, beyond = recording.beyond_protection()
    return [DemoRow('errors beyond the protection level', beyond, 'frames', exactly=0)
            ] if known else []


def _rows_without_attitude(recording: Recording) -> list[DemoRow]:
    """Return how many frames after the first attitude have none, with and without a reason."""
    frame_ns = recording.frame_ns()
    missing_ns = np.setdiff1d(
        frame_ns[frame_ns > recording.attitude_ns.min(initial=2 ** 63 - 1)],
        recording.attitude_ns)
    explained = sum(bool(recording.reason_at(stamp_ns)) for stamp_ns in np.intersect1d(
        missing_ns, recording.without_attitude_ns))
    silent = len(missing_ns) - explained
    return [DemoRow('later frames without attitude, reason given', explained, 'frames'),
            DemoRow('later frames without attitude, no reason', silent, 'frames', exactly=0)]


def _bag_row(recording: Recording, frames: int) -> DemoRow:
    """Return how many frames the bag does not hold with their truth."""
    missing = frames - len(np.intersect1d(recording.image_ns, recording.truth_ns))
    return DemoRow('frames missing in the bag', missing, 'frames', '= 0, readable',
                   missing == 0 and recording.complete and not recording.problems)


def _expected_frames(image_ns: np.ndarray) -> int:
    """Return how many frames the span of the stamps holds at their usual distance."""
    if len(image_ns) < 3:
        return len(image_ns)
    return round((image_ns[-1] - image_ns[0]) / np.median(np.diff(image_ns))) + 1


def draw_run(path: Path, recording: Recording, image: np.ndarray, uv: np.ndarray,
             hip: np.ndarray, title: str) -> None:
    """Write a PNG: image (H, W) with tracks at uv (N, 2), labelled with hip (N,)."""
    stamps, error, sigma = recording.errors()
    time_s = (stamps - recording.image_ns[0]) / 1e9 if len(stamps) else stamps
    with picture(path, 5.6, 165, title=title) as figure:
        grid = figure.add_gridspec(3, 2, width_ratios=(1.25, 1))
        draw_field(figure.add_subplot(grid[:, 0]), image, uv, hip,
                   f'{np.count_nonzero(hip)} stars identified, '
                   f'{np.count_nonzero(hip == 0)} not yet')
        axes = draw_errors([grid[row, 1] for row in range(3)], time_s, error, sigma,
                           ('x, cross', 'y, cross', 'z, roll'), 'arcsec',
                           'attitude error against truth')
        axes[-1].set_xlabel('time since the first image [s]')
