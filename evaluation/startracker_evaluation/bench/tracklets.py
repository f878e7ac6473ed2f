# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Moving objects found in simulated flights among false centroids and hot pixels."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from startracker_evaluation.bench.reprocess import flight_bag, processed
from startracker_ros.core.maths.rotation import ARCSEC, matrix_from_quaternion, unit_from_radec
from startracker_ros.io.table import Result
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.sim.flights.truth import Truth
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.reprocess.leftovers import TRACKLET_DTYPE
from startracker_ros.tools.reprocess.plan import SegmentOptions
from startracker_ros.tools.reprocess.tables import read_table
from startracker_ros.tools.reprocess.tracklets import tracklet_rows

FOUND, FALSE_PER_1000 = 0.95, 1.0
LEAST_SEEN = 8
"""Frames that have an object: five in a row are needed, and each is missed now and then."""

_SAME_PX = 3.0


def run_tracklet_bench(*, trials: int, seed: int) -> Result:
    """Follow trials frames of one head at 1 Hz in which objects of SNR 7 move."""
    hours = trials / 3600
    options = FlightOptions(days=hours / 24, bag_hours=hours, heads=1, objects_hour=200.0,
                            object_snr=7.0, hot_pixels=5)
    with TemporaryDirectory() as name:
        folder = Path(name)
        processed(flight_bag(folder / 'flight', options, seed), folder / 'out',
                  segment_s=SegmentOptions().segment_s)
        table = tracklet_rows(read_table(folder / 'out' / 'tables', 'tracklets', 'head_1',
                                         list(TRACKLET_DTYPE.names or ())))
        hot = read_table(folder / 'out' / 'tables', 'hot_pixels', 'head_1', ['stamp_ns', 'u', 'v'])
    return _result(Truth(options, seed), trials, seed, table, hot)


def _result(truth: Truth, trials: int, seed: int, table: np.ndarray,
            hot: dict[str, np.ndarray]) -> Result:
    time_s = table['stamp_ns'] * 1e-9 - truth.options.start_utc_s
    direction = unit_from_radec(np.radians(table['ra_deg']), np.radians(table['dec_deg']))
    objects, camera = truth.objects(0), truth.camera
    seen = _frames_seen(truth, trials)
    covered, false, nees = np.zeros(len(seen), bool), 0, list[float]()
    for tracklet in np.unique(table['tracklet']):
        rows = table['tracklet'] == tracklet
        # Chords are angles here, and their squares are not lost in a rounded cosine.
        apart = np.linalg.norm(objects.at(time_s[rows]) - direction[rows][:, None], axis=-1)
        same = np.median(apart, axis=0) < _SAME_PX * camera.pixel_rad
        if not same.any():
            false += 1
            continue
        covered |= same
        variance = (table['cov_ee_arcsec2'][rows] + table['cov_nn_arcsec2'][rows]).astype(float)
        nees += list((apart[:, same.argmax()] / ARCSEC) ** 2 / (variance / 2))
    wanted = seen >= LEAST_SEEN
    share = float(covered[wanted].mean())
    hot_truth = {tuple(pixel) for pixel in truth.hot_pixels(0).astype(int).tolist()}
    hot_found = set(zip(hot['u'].tolist(), hot['v'].tolist()))
    return Result('bench tracklets', [
        Row(f'objects of SNR 7 in {LEAST_SEEN} frames or more', int(wanted.sum()), 'objects'),
        Row('found', share, '1', least=FOUND),
        Row('false tracklets', 1000 * false / trials, '/1000 frames', most=FALSE_PER_1000),
        Row('tracklets for each object found',
            (len(np.unique(table['tracklet'])) - false) / max(1, int(covered.sum())), '1'),
        Row('NEES of a direction, 2 when true', float(np.mean(nees)) if nees else np.nan, '1'),
        Row('hot pixels in the map, of all', len(hot_truth & hot_found) / len(hot_truth), '1'),
        Row('other pixels in the map', len(hot_found - hot_truth), 'pixels')], {
        'recording': f'{trials} frames of one head at 1 Hz, 0.5 false centroids in each, 5 hot '
                     'pixels; rates against the stars 0.01 to 0.5 deg/s', 'seed': seed,
        'machine': machine()})


def _frames_seen(truth: Truth, trials: int) -> np.ndarray:
    """Return in how many frames (N,) each object is in the image."""
    objects, count = truth.objects(0), []
    for number in range(len(objects.time_s)):
        one = type(objects)(*(column[number:number + 1] for column in objects))
        time_s = np.arange(max(0.0, np.ceil(one.time_s[0] - 120)),
                           min(trials, one.time_s[0] + 120))
        sensor = np.einsum('fji,fj->fi', matrix_from_quaternion(truth.attitude(0, time_s)),
                           one.at(time_s)[:, 0])
        count.append(np.count_nonzero(truth.camera.contains(truth.camera.project(sensor))))
    return np.array(count)
