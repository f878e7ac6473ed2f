# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Flights as bags, made side by side."""

from dataclasses import asdict
from datetime import datetime, UTC
import json
import math
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from rich.progress import track
from startracker_ros.core.astro.aberration import apparent_directions, state_near_earth
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.catalog.onboard import onboard_catalog, OnboardCatalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.maths.rotation import matrix_from_quaternion
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.layouts import CENTROID_DTYPE, INERTIAL_FRAME_ID
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.writer import BagWriter
from startracker_ros.io.output import output_folder, write_output
from startracker_ros.io.table import Result
from startracker_ros.io.workers import cluster, completed
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.sim.flights.truth import Truth

HEADS = ('head_1', 'head_2')
TRUTH_FILE = 'truth.json'
_CHUNK_S = 60.0
_ODOMETRY_S = 10.0
_LATENCY_NS = 40_000_000
_Message = tuple[int, str, bytes]
"""Log time in ns, topic and bytes."""

_TOPICS = {'centroids': cdr.POINT_CLOUD, 'camera_info': cdr.CAMERA_INFO, 'imu': cdr.IMU,
           'odometry': cdr.ODOMETRY, 'truth/attitude': cdr.QUATERNION}

_FLUX = 1e6


def simulate_flight(folder: Path, options: FlightOptions, seed: int, *, workers: int,
                    scheduler: str = '') -> Result:
    """
    Write the bags of a flight and its truth.json; a row for each bag.

    Bags that are there are kept. OSError where a folder cannot be written.
    """
    count = math.ceil(options.days * 24 / options.bag_hours - 1e-9)
    write_output(output_folder(folder) / TRUTH_FILE, json.dumps({
        'seed': seed, **asdict(options), 'steps': _steps(options)}, indent=1))
    tasks = [(folder, options, seed, number) for number in range(count)]
    rows: list[dict[str, object]] = [{} for _ in tasks]
    with cluster(min(workers, count), scheduler) as client:
        for number, row in track(completed(client, write_bag, tasks), 'simulate', total=count,
                                 transient=True):
            if isinstance(row, Exception):
                raise row
            rows[number] = row
    return Result('simulate', rows, {'seed': seed, 'truth': str(folder / TRUTH_FILE)})


def _steps(options: FlightOptions) -> list[dict[str, object]]:
    """Return what steps: kind, head, size and unit, UTC."""
    found = []
    for kind, head, size, unit, day in (
            ('mount', HEADS[1], options.mount_step_arcsec, 'arcsec', options.mount_step_day),
            ('focal length', HEADS[0], options.focal_step_percent, '%', options.focal_step_day)):
        if size:
            found.append({'kind': kind, 'head': head, 'size': size, 'unit': unit,
                          'utc_s': options.start_utc_s + day * 86400})
    return found


def write_bag(folder: Path, options: FlightOptions, seed: int, number: int) -> dict[str, object]:
    """Write one bag of a flight, unless it is there; return its row."""
    truth = Truth(options, seed)
    interval_s = 1 / options.rate_hz
    first = math.ceil(number * options.bag_hours * 3600 * options.rate_hz - 1e-6)
    last = math.ceil(min((number + 1) * options.bag_hours, options.days * 24)
                     * 3600 * options.rate_hz - 1e-6)
    begin = datetime.fromtimestamp(options.start_utc_s + first * interval_s, UTC)
    path = folder / f'flight_{begin:%Y-%m-%dT%H%M%S}'
    row = {'bag': path.name, 'frames': (last - first) * options.heads}
    if (path / 'metadata.yaml').exists():
        return row
    with TemporaryDirectory(prefix='.', dir=folder) as partial:
        with BagWriter(Path(partial, path.name), flush_ns=0) as writer:
            _write(writer, truth, np.arange(first, last) * interval_s, interval_s,
                   [np.random.default_rng([seed, number, head]) for head in range(options.heads)])
        Path(partial, path.name).rename(path)
    return row


def _write(writer: BagWriter, truth: Truth, time_s: np.ndarray, interval_s: float,
           rngs: list[np.random.Generator]) -> None:
    """Write the messages of times (F,) to a bag."""
    for head in range(truth.options.heads):
        for topic, type_name in _TOPICS.items():
            writer.add_topic(f'/{HEADS[head]}/{topic}', type_name, (QosProfile(),))
    year = epoch_year_from_stamp(int(truth.stamps_ns(time_s[len(time_s) // 2:][:1])[0]))
    onboard = onboard_catalog(load_catalog(), truth.camera, year, truth.options.magnitude_limit)
    size = max(2, round(_CHUNK_S / interval_s))
    for begin in range(0, len(time_s), size):
        chunk = time_s[begin:begin + size]
        messages: list[_Message] = []
        for head, rng in enumerate(rngs):
            messages += _head_messages(truth, head, chunk, interval_s, rng, centroid_frames(
                truth, onboard, head, chunk, rng))
        for log_ns, topic, data in sorted(messages, key=lambda message: message[0]):
            writer.write(topic, data, log_ns, log_ns)


def _head_messages(truth: Truth, head: int, time_s: np.ndarray, interval_s: float,
                   rng: np.random.Generator, frames: list[np.ndarray]
                   ) -> list[_Message]:
    """Return the messages of a head."""
    name, frame_id = HEADS[head], f'{HEADS[head]}_optical_frame'
    stamps_ns = truth.stamps_ns(time_s).tolist()
    quaternion = truth.attitude(head, time_s)
    sigma_rad_s = np.radians(truth.options.gyro_noise_deg_sqrt_h / 60) / np.sqrt(interval_s)
    rates = (truth.rate_rad_s(head, time_s, interval_s) + truth.gyro_bias_rad_s(head, time_s)
             + sigma_rad_s * rng.standard_normal((len(time_s), 3)))
    messages: list[_Message] = []

    def add(stamp_ns: int, topic: str, data: bytes, delay_ns: int = 0) -> None:
        messages.append((stamp_ns + delay_ns, f'/{name}/{topic}', data))
    add(stamps_ns[0], 'camera_info', cdr.camera_info(stamps_ns[0], frame_id, truth.camera))
    last_s = -np.inf
    for index, stamp_ns in enumerate(stamps_ns):
        if time_s[index] - last_s >= _ODOMETRY_S - 1e-6:
            last_s = time_s[index]
            position_m, velocity_m_s = truth.orbit.at(last_s)
            add(stamp_ns, 'odometry', cdr.odometry(
                stamp_ns, INERTIAL_FRAME_ID, INERTIAL_FRAME_ID, position_m, velocity_m_s, 25.0,
                1e-4))
        add(stamp_ns, 'imu', cdr.gyro_imu(stamp_ns, frame_id, rates[index], sigma_rad_s))
        add(stamp_ns, 'truth/attitude',
            cdr.quaternion_stamped(stamp_ns, INERTIAL_FRAME_ID, quaternion[index]))
        add(stamp_ns, 'centroids', cdr.point_cloud(stamp_ns, frame_id, frames[index]),
            _LATENCY_NS)
    return messages


def centroid_frames(truth: Truth, onboard: OnboardCatalog, head: int, time_s: np.ndarray,
                    rng: np.random.Generator) -> list[np.ndarray]:
    """
    Return the rows of `centroids` of each frame at times (F,) in s, a minute or so, ascending.

    Stars are where an observer on the orbit sees them: within a minute the aberration is linear
    to 0.003 arcsec.
    """
    options, camera = truth.options, truth.camera
    quaternion = truth.attitude(head, time_s)
    matrix = matrix_from_quaternion(quaternion)
    middle = matrix[len(matrix) // 2, :, 2]
    travel = np.arccos(np.clip((matrix[:, :, 2] @ middle).min(), -1, 1))
    star = onboard.within(middle, camera.corner_angle_rad + travel + 1e-3)
    ends = [_apparent(truth, onboard.direction[star], at) for at in (time_s[0], time_s[-1])]
    part = (time_s - time_s[0]) / max(time_s[-1] - time_s[0], 1e-9)
    direction = ends[0] + part[:, None, None] * (ends[1] - ends[0])
    centre = np.array([camera.cx, camera.cy])
    uv = camera.project(np.einsum('fji,fmj->fmi', matrix, direction))
    uv = centre + (uv - centre) * truth.focal_ratio(head, time_s)[:, None, None]
    magnitude = onboard.magnitude[star]
    parts = [_seen(truth, uv, np.broadcast_to(magnitude, uv.shape[:2]), rng)]
    objects = truth.objects(head).near(time_s[0], time_s[-1])
    hot_uv = truth.hot_pixels(head)
    # The SNR, 1 / sigma_px, falls as 10^(-0.2 magnitude).
    for uv, brightness in (
            (camera.project(np.einsum('fji,fmj->fmi', matrix, objects.at(time_s))),
             options.magnitude_limit - 5 * np.log10(options.object_snr * options.sigma_px)),
            (np.broadcast_to(hot_uv, (len(time_s), *hot_uv.shape)), options.magnitude_limit)):
        parts.append(_seen(truth, uv, np.full(uv.shape[:2], brightness), rng))
    false = rng.poisson(options.false, len(time_s))
    parts.append(_Spots(
        np.repeat(np.arange(len(time_s)), false),
        rng.uniform(0, options.width_px - 1, (false.sum(), 2)),
        rng.uniform(options.magnitude_limit - 2, options.magnitude_limit, false.sum()),
        np.full(false.sum(), options.sigma_px)))
    frame, uv, magnitude, sigma_px = map(np.concatenate, zip(*parts))
    order = np.lexsort((magnitude, frame))
    rows = _rows(truth, uv[order], magnitude[order], sigma_px[order])
    return np.split(rows, np.cumsum(np.bincount(frame, minlength=len(time_s)))[:-1])


class _Spots(NamedTuple):
    """Spots (N,): number of the frame, uv (N, 2), magnitude and sigma_px."""

    frame: np.ndarray
    uv: np.ndarray
    magnitude: np.ndarray
    sigma_px: np.ndarray


def _seen(truth: Truth, uv: np.ndarray, magnitude: np.ndarray, rng: np.random.Generator
          ) -> _Spots:
    """Return what is seen at pixels (F, M, 2), of magnitude (F, M): most of it, with errors."""
    with np.errstate(invalid='ignore'):
        seen = truth.camera.contains(uv) & (rng.random(uv.shape[:2]) >= truth.options.missing)
    sigma_px = truth.options.centroid_sigma_px(magnitude[seen])
    return _Spots(
        np.nonzero(seen)[0], uv[seen] + rng.standard_normal((len(sigma_px), 2))
        * sigma_px[:, None], magnitude[seen] + rng.normal(0, 0.05, len(sigma_px)), sigma_px)


def _apparent(truth: Truth, direction: np.ndarray, time_s: float) -> np.ndarray:
    """Return where an observer on the orbit sees directions (N, 3) at a time."""
    year = epoch_year_from_stamp(int(truth.stamps_ns(np.array([time_s]))[0]))
    return apparent_directions(direction, state_near_earth(year, truth.orbit.at(time_s)[1]))


def _rows(truth: Truth, uv: np.ndarray, magnitude: np.ndarray, sigma_px: np.ndarray
          ) -> np.ndarray:
    rows = np.zeros(len(uv), CENTROID_DTYPE)
    for name, column in zip('xyz', truth.camera.unproject(uv).T):
        rows[name] = column
    rows['u'], rows['v'] = uv.T
    rows['flux'] = _FLUX * 10 ** (-0.4 * magnitude)
    rows['snr'], rows['sigma_px'] = 1 / sigma_px, sigma_px
    rows['cov_uu'] = rows['cov_vv'] = sigma_px ** 2
    return rows
