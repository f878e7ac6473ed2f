"""A recorded run in figures, each with the bound that it must hold."""

import numpy as np
from startracker_ros.figures.correctness import over_bound
from startracker_ros.figures.rows import Row
from startracker_ros.maths.rotation import ARCSEC
from startracker_ros.report.recording import Recording


def summarise(recording: Recording) -> list[Row]:
    """Return the figures of a recording."""
    frames = len(recording.image_ns)
    stamps, error, sigma = recording.errors()
    rows = [Row('images', frames, 'frames', '> 0', frames > 0)]
    lost = len(np.setdiff1d(recording.image_ns, recording.centroids_ns))
    expected = _expected_frames(recording.image_ns)
    dropped = expected - frames + lost
    rows.append(Row('frames dropped', dropped, 'frames', '= 0', dropped == 0))
    if not len(stamps):
        return [*rows, Row('frames with attitude', 0.0, '%', '>= 95', False)]
    share = 100 * len(recording.attitude_ns) / frames
    rows.append(Row('frames with attitude', share, '%', '>= 95', share >= 95))
    for name, axes, each in (('cross-boresight', slice(0, 2), 'rms each axis'),
                             ('roll', slice(2, 3), 'rms')):
        for kind, values in (('error', error), ('sigma', sigma)):
            rms = float(np.sqrt(np.mean(values[:, axes] ** 2)))
            rows.append(Row(f'{name} {kind}, {each}', rms, 'arcsec'))
    wrong = int(np.count_nonzero(over_bound(error * ARCSEC, sigma * ARCSEC) > 1))
    start_s = (recording.attitude_ns[0] - recording.image_ns[0]) / 1e9
    latency_ms = recording.latency_ms()
    return [
        *rows, Row('wrong attitudes', wrong, 'frames', '= 0', wrong == 0),
        Row('first image to first attitude', start_s, 's'),
        *(Row(f'image sent to attitude received, p{percent}',
              float(np.percentile(latency_ms, percent)), 'ms') for percent in (50, 95))]


def _expected_frames(image_ns: np.ndarray) -> int:
    """Return how many frames the span of the stamps holds at their usual distance."""
    if len(image_ns) < 3:
        return len(image_ns)
    return round((image_ns[-1] - image_ns[0]) / np.median(np.diff(image_ns))) + 1
