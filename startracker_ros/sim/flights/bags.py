# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Flights as bags, made side by side."""

from dataclasses import asdict
from datetime import datetime, UTC
import json
import math
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.progress import track
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.io.bags import cdr
from startracker_ros.io.bags.qos import QosProfile
from startracker_ros.io.bags.writer import BagWriter
from startracker_ros.io.output import output_folder, write_output
from startracker_ros.io.table import Result
from startracker_ros.io.workers import cluster, completed
from startracker_ros.sim.flights.frames import centroid_frames
from startracker_ros.sim.flights.options import FlightOptions
from startracker_ros.sim.flights.truth import Truth

HEADS = ('head_1', 'head_2')
INERTIAL = 'icrf'
TRUTH_FILE = 'truth.json'
_CHUNK_S = 60.0
_ODOMETRY_S = 10.0
_LATENCY_NS = 40_000_000
_Message = tuple[int, str, bytes]
"""Log time in ns, topic and bytes."""

_TOPICS = {'centroids': cdr.POINT_CLOUD, 'camera_info': cdr.CAMERA_INFO, 'imu': cdr.IMU,
           'odometry': cdr.ODOMETRY, 'truth/attitude': cdr.QUATERNION}


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
                stamp_ns, INERTIAL, INERTIAL, position_m, velocity_m_s, 25.0, 1e-4))
        add(stamp_ns, 'imu', cdr.gyro_imu(stamp_ns, frame_id, rates[index], sigma_rad_s))
        add(stamp_ns, 'truth/attitude',
            cdr.quaternion_stamped(stamp_ns, INERTIAL, quaternion[index]))
        add(stamp_ns, 'centroids', cdr.point_cloud(stamp_ns, frame_id, frames[index]),
            _LATENCY_NS)
    return messages
