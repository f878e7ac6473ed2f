"""A recorded run in figures, each with the bound that it must hold."""

import numpy as np
from startracker_ros.figures import WRONG_ARCSEC, WRONG_SIGMAS
from startracker_ros.report.recording import Recording


def summarise(recording: Recording) -> list[dict[str, object]]:
    """Return rows of case, ours, bound, unit, holds; bound is None where there is none."""
    frames = len(recording.image_ns)
    stamps, error, sigma = recording.errors()
    rows: list[dict[str, object]] = []

    def row(case: str, ours: float, unit: str, bound: str = '', holds: bool = True) -> None:
        rows.append({'case': case, 'ours': ours, 'unit': unit, 'bound': bound, 'holds': holds})

    row('images', frames, 'frames', '> 0', frames > 0)
    lost = len(np.setdiff1d(recording.image_ns, recording.centroids_ns))
    expected = _expected_frames(recording.image_ns)
    dropped = expected - frames + lost
    row('frames dropped', dropped, 'frames', '= 0', dropped == 0)
    if not len(stamps):
        row('frames with attitude', 0.0, '%', '>= 95', False)
        return rows
    share = 100 * len(recording.attitude_ns) / frames
    row('frames with attitude', share, '%', '>= 95', share >= 95)
    for name, axes, each in (('cross-boresight', slice(0, 2), 'rms each axis'),
                             ('roll', slice(2, 3), 'rms')):
        for kind, values in (('error', error), ('sigma', sigma)):
            row(f'{name} {kind}, {each}', float(np.sqrt(np.mean(values[:, axes] ** 2))), 'arcsec')
    wrong = np.any(np.abs(error) > WRONG_SIGMAS * sigma + WRONG_ARCSEC, axis=1).sum()
    row('wrong attitudes', int(wrong), 'frames', '= 0', wrong == 0)
    row('first image to first attitude', (recording.attitude_ns[0] - recording.image_ns[0]) / 1e9,
        's')
    latency_ms = recording.latency_ms()
    for name, percent in (('p50', 50), ('p95', 95)):
        row(f'image sent to attitude received, {name}', float(np.percentile(latency_ms, percent)),
            'ms')
    return rows


def _expected_frames(image_ns: np.ndarray) -> int:
    """Return how many frames the span of the stamps holds at their usual distance."""
    if len(image_ns) < 3:
        return len(image_ns)
    return round((image_ns[-1] - image_ns[0]) / np.median(np.diff(image_ns))) + 1
