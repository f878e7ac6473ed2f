# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The faults around a star tracker: each function injects one, waits and undoes it."""

from collections.abc import Callable
from pathlib import Path
import resource
import signal
import time

import numpy as np
from startracker_evaluation.harness.fault_injection import (
    Expected, Fault, FRAMES_BOUND_S, STALE, Times)
from startracker_evaluation.harness.fault_rig import FaultRig, Frame, saturated
from startracker_ros.core.camera.model import Camera
from startracker_ros.io.bags.reader import read_messages
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.processes import module_command

_CONSUMED = ('image_raw:sensor_msgs/msg/Image', 'centroids:sensor_msgs/msg/PointCloud2',
             'tracks:sensor_msgs/msg/PointCloud2', 'attitude:geometry_msgs/msg/QuaternionStamped',
             'attitude_cov:geometry_msgs/msg/PoseWithCovarianceStamped')
_PROCESS_BOUND_S = 10.0
_ALL_BOUND_S = 20.0

_Filter = Callable[[Frame], list[Frame]]


# --- processes ---

def _kill(node: str, reporter: str, text: str, *, reported: str = '') -> Fault:
    """Kill a node and start it again; reported is the diagnostic that shows the recovery."""
    def fault(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
        rig.processes.kill(node)
        rig.run(times.dead_s)
        rig.start(node)
        return Expected(f'{node} started again', time.monotonic(), ((reporter, text),),
                        _PROCESS_BOUND_S, _reported(rig, node, reported) if reported else None)
    return fault


def _kill_simulator(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
    """Replace the images of the rig by those of a sky_simulator, then kill it."""
    rig.publishes_images = False
    rig.start('sky_simulator')
    rig.wait_recovered(time.monotonic(), 2 * _PROCESS_BOUND_S)
    return _kill('sky_simulator', 'centroid_extractor', 'image_raw: nothing comes in')(
        rig, times, rng)


def _kill_recorder(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
    """Kill the recorder and start it again; its bag has to be readable."""
    bag = rig.bag
    # The recorder writes what is older than a second.
    rig.run(times.dead_s)
    rig.processes.kill('bag_recorder')
    rig.run(times.dead_s)
    rig.start('bag_recorder')
    return Expected('bag_recorder started again', time.monotonic(), (('bag_recorder', STALE),),
                    _PROCESS_BOUND_S, _reported(rig, 'bag_recorder', 'recording'),
                    _bag_problem(bag))


def _kill_all(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
    """Kill all processes but the source of images and start them again."""
    nodes = (*STAGES, 'bag_recorder')
    rig.processes.kill(*nodes)
    rig.run(times.dead_s)
    for node in nodes:
        rig.start(node)
    # LOST may last less than the second between two diagnostics.
    return Expected('all started again', time.monotonic(),
                    (('star_tracker', 'LOST: waiting for an identified frame'),
                     ('star_tracker', 'ACQUIRING: first identification')),
                    _ALL_BOUND_S)


def _stop(node: str) -> Fault:
    """Stop a node for one second."""
    def fault(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
        rig.processes.signal(signal.SIGSTOP, node)
        rig.run(1.0)
        rig.processes.signal(signal.SIGCONT, node)
        return Expected(f'{node} runs again', time.monotonic(), ((node, 'busy or stopped for'),))
    return fault


def _stop_all(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
    """Stop all nodes for longer than the default lease of Fast DDS, 20 s."""
    rig.processes.signal(signal.SIGSTOP, *STAGES)
    rig.run(times.stopped_s)
    rig.processes.signal(signal.SIGCONT, *STAGES)
    return Expected('nodes run again', time.monotonic(),
                    tuple((node, 'busy or stopped for') for node in STAGES), _PROCESS_BOUND_S)


def _start_in_order(number: int) -> Fault:
    """Start all nodes with pauses: number 0 from the last stage on, others in random orders."""
    def fault(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
        nodes = [*reversed(STAGES), 'sky_simulator']
        orders = np.random.default_rng(rig.seed)
        for _ in range(number):
            nodes = [str(name) for name in orders.permutation(nodes)]
        rig.publishes_images = False
        rig.processes.kill(*STAGES)
        for node in nodes:
            rig.start(node)
            rig.run(rng.uniform(0.0, 1.0))
        return Expected('last of ' + ', '.join(node.partition('_')[2] for node in nodes),
                        time.monotonic(), (), _ALL_BOUND_S)
    return fault


def _slow_consumer(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
    """Run a subscriber of all topics that sleeps over each message, then stop it."""
    rig.processes.run('slow_consumer', module_command(
        'startracker_evaluation.harness.slow_consumer', _CONSUMED))
    since_s = time.monotonic()
    rig.run(times.frames_s)
    rig.processes.signal(signal.SIGSTOP, 'slow_consumer')
    stopped_s = time.monotonic()
    rig.run(times.frames_s)
    problem = _attitude_problem(rig, stopped_s)
    rig.processes.kill('slow_consumer')
    return Expected('the consumer is gone', time.monotonic(), (), problem=problem,
                    gap_s=rig.longest_gap_s(since_s, time.monotonic()))


def _fill_disk(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
    """Limit the files of the recorder to their sizes; its shared memory is allocated already."""
    bag, since_s = rig.bag, time.monotonic()
    rig.run(times.dead_s)
    pid = rig.processes.pid('bag_recorder')
    hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
    size = max(path.stat().st_size for path in bag.glob('*.mcap'))
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, hard))
    rig.run(20.0, lambda: rig.probe.find_diagnostic(
        'ends here', node='bag_recorder', since_s=since_s) is not None)
    problem = _bag_problem(bag) or _attitude_problem(rig, time.monotonic())
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
    return Expected('room on the disk again', time.monotonic(),
                    (('bag_recorder', 'the recording ends here'),), _PROCESS_BOUND_S,
                    _reported(rig, 'bag_recorder', 'the recording goes on in'), problem,
                    rig.longest_gap_s(since_s, time.monotonic()))


def _reported(rig: FaultRig, node: str, text: str) -> Callable[[float], float | None]:
    """Return a function of a time that returns when a node first published a text since."""
    def reported_s(since_s: float) -> float | None:
        found = rig.probe.find_diagnostic(text, node=node, since_s=since_s)
        return None if found is None else found.received_s
    return reported_s


def _bag_problem(bag: Path) -> str:
    """Return what is wrong with a bag that was not closed: it has to contain attitudes."""
    topics = [record.topic for record in read_messages(bag, tolerant=True)]
    return '' if '/attitude' in topics else f'{bag.name} holds no attitude'


def _attitude_problem(rig: FaultRig, since_s: float) -> str:
    """Return what is wrong where a fault that lasts stops the attitudes."""
    recovered = rig.wait_recovered(since_s, _ALL_BOUND_S) is not None
    return '' if recovered else 'no attitudes while the fault lasts'


# --- images ---

def _filter_frames(make_filter: Callable[[np.random.Generator], _Filter], text: str,
                   duration_s: Callable[[Times], float]) -> Fault:
    """Publish other frames than those of the camera for a time; the extractor reports a text."""
    def fault(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
        before = rig.frame_filter
        rig.frame_filter = make_filter(rng)
        rig.run(duration_s(times))
        rig.frame_filter = before
        return Expected('images as they should be', time.monotonic(),
                        (('centroid_extractor', text),))
    return fault


def _drop(rng: np.random.Generator) -> _Filter:
    """Drop 30 % of the frames."""
    return lambda frame: [frame] if rng.random() > 0.3 else []


def _swap(rng: np.random.Generator) -> _Filter:
    """Swap a third of the frames with the next one."""
    held: list[Frame] = []

    def swap(frame: Frame) -> list[Frame]:
        if held:
            return [frame, held.pop()]
        if rng.random() < 0.33:
            held.append(frame)
            return []
        return [frame]
    return swap


# --- clock and camera ---

def _shift_clock(ahead_s: float, text: str) -> Fault:
    """Shift the stamps, and by some ns more, so that none repeats; the extractor reports it."""
    # Frames are rejected until the stamps exceed those before a small jump back.
    bound_s = FRAMES_BOUND_S - (ahead_s if -1 < ahead_s < 0 else 0.0)

    def fault(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
        rig.clock_offset_ns += round(ahead_s * 1e9) + int(rng.integers(1, 1000))
        return Expected('the jump', time.monotonic(), (('centroid_extractor', text),), bound_s)
    return fault


def _unset_clock(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
    """Publish stamps of 1970, as before a clock is set, then right ones."""
    now_ns = rig.stamp_ns
    rig.clock_offset_ns -= now_ns
    problem = _attitude_problem(rig, time.monotonic())
    rig.clock_offset_ns += now_ns + 1
    return Expected('the clock is set', time.monotonic(),
                    (('centroid_extractor', 'time went ahead by'),), problem=problem)


def _change_camera(camera: Camera) -> Fault:
    """Change the camera between two frames."""
    def fault(rig: FaultRig, times: Times, rng: np.random.Generator) -> Expected:
        rig.set_camera(camera)
        return Expected('the swap', time.monotonic(), (('star_tracker', 'another camera'),))
    return fault


FAULTS: dict[str, Fault] = {
    'centroid_extractor killed': _kill(
        'centroid_extractor', 'star_tracker', 'centroids: nothing comes in'),
    'star_identifier killed': _kill(
        'star_identifier', 'star_identifier', STALE, reported='idle while'),
    'star_tracker killed': _kill(
        'star_tracker', 'attitude_estimator', 'tracks: nothing comes in'),
    'attitude_estimator killed': _kill('attitude_estimator', 'attitude_estimator', STALE),
    'sky_simulator killed': _kill_simulator,
    'bag_recorder killed': _kill_recorder,
    'all nodes killed': _kill_all,
    **{f'{node} stopped 1 s': _stop(node) for node in STAGES},
    'all nodes stopped': _stop_all,
    'images dropped, 30 %': _filter_frames(
        _drop, 'image_raw: frames are missing', lambda times: times.frames_s),
    'images sent twice': _filter_frames(
        lambda rng: lambda frame: [frame, frame],
        'image_raw: frame out of order', lambda times: times.frames_s),
    'images reordered': _filter_frames(
        _swap, 'image_raw: frame out of order', lambda times: times.frames_s),
    'no images for 1 s': _filter_frames(
        lambda rng: lambda frame: [], 'image_raw: frames are missing', lambda times: 1.0),
    'sensor blinded': _filter_frames(
        lambda rng: lambda frame: [saturated(frame)],
        'all pixels are', lambda times: times.blind_s),
    'clock back 10 s': _shift_clock(-10.0, 'time went back by'),
    'clock back 0.5 s': _shift_clock(-0.5, 'frame out of order'),
    'clock ahead 3 s': _shift_clock(3.0, 'time went ahead by'),
    'clock ahead 1 h': _shift_clock(3600.0, 'time went ahead by'),
    'clock at 1970, then set': _unset_clock,
    'other camera, 640 x 480 px, 16 deg': _change_camera(Camera.from_fov(640, 480, 16.0)),
    'other lens, 12 to 12.2 deg': _change_camera(Camera.from_fov(512, 512, 12.2)),
    'consumer asleep, then stopped': _slow_consumer,
    'disk of the recorder full': _fill_disk,
}


def faults(times: Times) -> dict[str, Fault]:
    """Return all faults by name."""
    return {**FAULTS, **{f'started in order {number + 1}': _start_in_order(number)
                         for number in range(times.orders)}}
