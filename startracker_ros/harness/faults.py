"""What can go wrong around a star tracker: each fault done to real processes, and undone."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
import resource
import signal
import time

import numpy as np

from startracker_ros.bag.reader import read_messages
from startracker_ros.camera.model import Camera
from startracker_ros.executables import STAGES
from startracker_ros.harness.flight import CAMERA, Flight, Frame, in_white
from startracker_ros.harness.processes import RigError

_CONSUMED = ('image_raw:sensor_msgs/msg/Image', 'centroids:sensor_msgs/msg/PointCloud2',
             'tracks:sensor_msgs/msg/PointCloud2', 'attitude:geometry_msgs/msg/QuaternionStamped',
             'attitude_cov:geometry_msgs/msg/PoseWithCovarianceStamped')
_STALE = 'no diagnostics for'
"""What an aggregator of diagnostics would say of a node from which none come."""
_STALE_S = 2.0
_PROCESS_BOUND_S = 10.0
_ALL_BOUND_S = 20.0
_FRAMES_BOUND_S = 2.0


@dataclass(frozen=True)
class Times:
    """How long the long faults last, in s, and how many orders of starting are tried."""

    blind_s: float = 30.0
    stopped_s: float = 25.0
    dead_s: float = 3.0
    frames_s: float = 10.0
    orders: int = 6


@dataclass(frozen=True)
class Expected:
    """
    How a fault should end.

    Recovery is measured from undone_s, of which undone says what it was; one of the
    diagnostics (node, words) must be heard; recovered, where attitudes do not tell it, returns
    when all was well again; problem is what else was found amiss, whatever the machine's speed;
    gap_s is the longest time without an attitude where the fault should not interrupt them.
    """

    undone: str
    undone_s: float
    diagnostics: tuple[tuple[str, str], ...]
    bound_s: float = _FRAMES_BOUND_S
    recovered: Callable[[float], float | None] | None = None
    problem: str = ''
    gap_s: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """
    What came of a fault.

    recovery_s is None without a recovery; said is the expected diagnostic, empty where none is
    expected and None where it did not come.
    """

    expected: Expected
    recovery_s: float | None
    longest_gap_s: float
    attitudes: int
    wrong: int
    said: str | None

    @property
    def holds(self) -> bool:
        """Return whether the fault ended as it should, and soon enough."""
        return (self.recovery_s is not None and self.recovery_s <= self.expected.bound_s
                and self.expected.gap_s <= _FRAMES_BOUND_S and self.wrong == 0
                and not self.expected.problem and self.said is not None)


Fault = Callable[[Flight, Times, np.random.Generator], Expected]


# --- processes ---

def _killed(node: str) -> Fault:
    """Kill a stage and start it again; the node behind it hears nothing meanwhile."""
    told = {'sky_simulator': ('centroid_extractor', 'image_raw: nothing comes in'),
            'centroid_extractor': ('star_tracker', 'centroids: nothing comes in'),
            'star_identifier': ('star_identifier', _STALE),
            'star_tracker': ('attitude_estimator', 'tracks: nothing comes in'),
            'attitude_estimator': ('attitude_estimator', _STALE)}

    def kill(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
        flight.kill(node)
        flight.fly(times.dead_s)
        flight.start(node)
        return Expected(f'{node} started again', time.monotonic(), (told[node],),
                        _PROCESS_BOUND_S,
                        _saying(flight, node, 'resting') if node == 'star_identifier' else None)
    return kill


def _killed_simulator(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
    """As the others, with the images of a sky_simulator, whose motion then begins anew."""
    flight.sends_images = False
    flight.start('sky_simulator')
    since_s = time.monotonic()
    flight.wait_recovered(since_s, 2 * _PROCESS_BOUND_S)
    return _killed('sky_simulator')(flight, times, rng)


def _killed_recorder(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
    bag = flight.bag
    # What is older than a second outlives a recorder.
    flight.fly(times.dead_s)
    flight.kill('bag_recorder')
    flight.fly(times.dead_s)
    flight.start('bag_recorder')
    return Expected('bag_recorder started again', time.monotonic(),
                    (('bag_recorder', _STALE),), _PROCESS_BOUND_S,
                    _saying(flight, 'bag_recorder', 'recording'), _unreadable(bag))


def _saying(flight: Flight, node: str, words: str) -> Callable[[float], float | None]:
    """Return what tells when a node says something: that it works again."""
    def recovered(since_s: float) -> float | None:
        said = flight.heard(node, words, since_s)
        return None if said is None else said.received_s
    return recovered


def _unreadable(bag: Path) -> str:
    """Return what is wrong with a bag that was not closed: it must hold attitudes."""
    topics = [record.topic for record in read_messages(bag, tolerant=True)]
    return '' if '/attitude' in topics else f'{bag.name} holds no attitude'


def _full_disk(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
    """Let no file of the recorder grow any more; its shared memory has its size already."""
    bag, since_s = flight.bag, time.monotonic()
    flight.fly(times.dead_s)
    pid = flight.pid('bag_recorder')
    hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)[1]
    size = max(path.stat().st_size for path in bag.glob('*.mcap'))
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (size, hard))
    flight.fly(20.0, lambda: flight.heard('bag_recorder', 'ends here', since_s) is not None)
    problem = _unreadable(bag) or _without_attitudes(flight, time.monotonic())
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
    return Expected('room on the disk again', time.monotonic(),
                    (('bag_recorder', 'the recording ends here'),), _PROCESS_BOUND_S,
                    _saying(flight, 'bag_recorder', 'the recording goes on in'), problem,
                    flight.longest_gap_s(since_s, time.monotonic()))


def _without_attitudes(flight: Flight, since_s: float) -> str:
    """Return what is wrong where a fault that lasts stops the attitudes."""
    known = flight.wait_recovered(since_s, _ALL_BOUND_S) is not None
    return '' if known else 'no attitudes while the fault lasts'


def _restart_all(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
    """Kill every process but the source of the images at once, then start them all."""
    flight.kill(*STAGES, 'bag_recorder')
    flight.fly(times.dead_s)
    for node in (*STAGES, 'bag_recorder'):
        flight.start(node)
    # A second is enough to leave LOST: the condition after it may be told instead.
    return Expected('all started again', time.monotonic(),
                    (('star_tracker', 'LOST: waiting for an identified frame'),
                     ('star_tracker', 'ACQUIRING: first identification')),
                    _ALL_BOUND_S)


def _all_stopped(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
    """Stop all nodes, for longer than Fast DDS by default waits for a sign of life."""
    flight.signal(signal.SIGSTOP, *STAGES)
    flight.fly(times.stopped_s)
    flight.signal(signal.SIGCONT, *STAGES)
    return Expected('nodes run again', time.monotonic(),
                    tuple((node, 'busy or stopped for') for node in STAGES), _PROCESS_BOUND_S)


def _started_in_order(number: int) -> Fault:
    """Start all nodes anew, first from the attitude to the images, then in random orders."""
    def start(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
        nodes = [*reversed(STAGES), 'sky_simulator']
        orders = np.random.default_rng(flight.seed)
        for _ in range(number):
            nodes = [str(name) for name in orders.permutation(nodes)]
        flight.sends_images = False
        flight.kill(*STAGES)
        for node in nodes:
            flight.start(node)
            flight.fly(rng.uniform(0.0, 1.0))
        return Expected('last of ' + ', '.join(node.partition('_')[2] for node in nodes),
                        time.monotonic(), (), _ALL_BOUND_S)
    return start


def _frozen(node: str) -> Fault:
    """Stop a node for one second."""
    def freeze(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
        flight.signal(signal.SIGSTOP, node)
        flight.fly(1.0)
        flight.signal(signal.SIGCONT, node)
        return Expected(f'{node} runs again', time.monotonic(), ((node, 'busy or stopped for'),))
    return freeze


def _slow_consumer(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
    """Listen to everything and take nothing; then even stop listening without leaving."""
    consumer = flight.run_module('startracker_ros.harness.slow_consumer', *_CONSUMED)
    since_s = time.monotonic()
    try:
        flight.fly(times.frames_s)
        consumer.send_signal(signal.SIGSTOP)
        stopped_s = time.monotonic()
        flight.fly(times.frames_s)
        problem = _without_attitudes(flight, stopped_s)
    finally:
        consumer.kill()
        consumer.wait()
    return Expected('the consumer is gone', time.monotonic(), (), problem=problem,
                    gap_s=flight.longest_gap_s(since_s, time.monotonic()))


# --- images ---

def _disturbed(disturb: Callable[[np.random.Generator], Callable[[Frame], list[Frame]]],
               node: str, words: str, seconds: Callable[[Times], float]) -> Fault:
    """Change what the camera sends for a while."""
    def fault(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
        before = flight.disturb
        flight.disturb = disturb(rng)
        flight.fly(seconds(times))
        flight.disturb = before
        return Expected('images as they should be', time.monotonic(), ((node, words),))
    return fault


def _reordering(rng: np.random.Generator) -> Callable[[Frame], list[Frame]]:
    """Return what swaps a third of the frames with the next one."""
    held: list[Frame] = []

    def disturb(frame: Frame) -> list[Frame]:
        if held:
            return [frame, held.pop()]
        if rng.random() < 0.33:
            held.append(frame)
            return []
        return [frame]
    return disturb


# --- clock and camera ---

def _clock(ahead_s: float, node: str, words: str) -> Fault:
    """Let the clock of the camera jump; a few ns keep the stamps apart from earlier ones."""
    def jump(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
        flight.clock_ns += round(ahead_s * 1e9) + int(rng.integers(1, 1000))
        return Expected('the jump', time.monotonic(), ((node, words),),
                        _FRAMES_BOUND_S + max(0.0, -ahead_s if ahead_s > -1 else 0.0))
    return jump


def _clock_unset(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
    """Stamps of 1970, as before a clock is set, and then right ones."""
    now_ns = flight.stamp_ns
    flight.clock_ns -= now_ns
    since_s = time.monotonic()
    problem = _without_attitudes(flight, since_s)
    flight.clock_ns += now_ns + 1
    return Expected('the clock is set', time.monotonic(),
                    (('centroid_extractor', 'time went ahead by'),),
                    problem=problem)


def _camera(camera: Camera) -> Fault:
    """Swap the camera between two frames."""
    def swap(flight: Flight, times: Times, rng: np.random.Generator) -> Expected:
        flight.see_with(camera)
        return Expected('the swap', time.monotonic(), (('star_tracker', 'another camera'),))
    return swap


FAULTS: dict[str, Fault] = {
    **{f'{node} killed': _killed(node) for node in STAGES},
    'sky_simulator killed': _killed_simulator,
    'bag_recorder killed': _killed_recorder,
    'all nodes killed': _restart_all,
    **{f'{node} stopped 1 s': _frozen(node) for node in STAGES},
    'all nodes stopped': _all_stopped,
    'images dropped, 30 %': _disturbed(
        lambda rng: lambda frame: [frame] if rng.random() > 0.3 else [],
        'centroid_extractor', 'image_raw: frames are missing', lambda times: times.frames_s),
    'images sent twice': _disturbed(
        lambda rng: lambda frame: [frame, frame],
        'centroid_extractor', 'image_raw: frame out of order', lambda times: times.frames_s),
    'images reordered': _disturbed(
        _reordering, 'centroid_extractor', 'image_raw: frame out of order',
        lambda times: times.frames_s),
    'no images for 1 s': _disturbed(
        lambda rng: lambda frame: [],
        'centroid_extractor', 'image_raw: frames are missing', lambda times: 1.0),
    'sensor blinded': _disturbed(
        lambda rng: lambda frame: [in_white(frame)],
        'centroid_extractor', 'all pixels are', lambda times: times.blind_s),
    'clock back 10 s': _clock(-10.0, 'centroid_extractor', 'time went back by'),
    'clock back 0.5 s': _clock(-0.5, 'centroid_extractor', 'frame out of order'),
    'clock ahead 3 s': _clock(3.0, 'centroid_extractor', 'time went ahead by'),
    'clock ahead 1 h': _clock(3600.0, 'centroid_extractor', 'time went ahead by'),
    'clock at 1970, then set': _clock_unset,
    'other camera, 640 x 480 px, 16 deg': _camera(Camera.from_fov(640, 480, 16.0)),
    'other lens, 12 to 12.2 deg': _camera(Camera.from_fov(512, 512, 12.2)),
    'consumer asleep, then stopped': _slow_consumer,
    'disk of the recorder full': _full_disk,
}


def faults(times: Times) -> dict[str, Fault]:
    """Return all faults by name."""
    return {**FAULTS, **{f'started in order {number + 1}': _started_in_order(number)
                         for number in range(times.orders)}}


def inject(flight: Flight, name: str, times: Times, *, patience_s: float = 30.0) -> Outcome:
    """Do one fault to a flight that is well, and wait at most patience_s for the recovery."""
    _make_well(flight, patience_s)
    rng = np.random.default_rng([flight.seed, *name.encode()])
    begin_s = time.monotonic()
    expected = faults(times)[name](flight, times, rng)
    recovered = expected.recovered or flight.recovered_s
    flight.fly(patience_s, lambda: recovered(expected.undone_s) is not None)
    when_s = recovered(expected.undone_s)
    flight.fly(patience_s, lambda: _heard(flight, expected, begin_s) is not None)
    end_s = time.monotonic()
    said = _heard(flight, expected, begin_s)
    attitudes, wrong = flight.judge(begin_s, end_s)
    _undo(flight)
    return Outcome(expected, None if when_s is None else when_s - expected.undone_s,
                   flight.longest_gap_s(begin_s, end_s), attitudes, wrong, said)


def row_of(name: str, outcome: Outcome) -> dict[str, object]:
    """Return the row of a fault in the table of the campaign."""
    expected = outcome.expected
    problem = expected.problem or (
        f'no attitude for {expected.gap_s:.1f} s' if expected.gap_s > _FRAMES_BOUND_S else '')
    return {'fault': name, 'recovery_from': expected.undone, 'recovery_s': outcome.recovery_s,
            'bound_s': expected.bound_s, 'longest_gap_s': outcome.longest_gap_s,
            'attitudes': outcome.attitudes, 'wrong': outcome.wrong,
            'told': problem or outcome.said or None, 'holds': outcome.holds}


def _heard(flight: Flight, expected: Expected, begin_s: float) -> str | None:
    """Return the expected diagnostic, empty where none is expected, None while not heard."""
    if not expected.diagnostics:
        return ''
    for node, words in expected.diagnostics:
        said, stale_s = flight.heard(node, words, begin_s), flight.stale_s(node, begin_s)
        if said is not None:
            return f'{node}: {said.message}'
        if words == _STALE and stale_s > _STALE_S:
            return f'{node}: {_STALE} {stale_s:.1f} s'
    return None


def _undo(flight: Flight) -> None:
    """Return to the harness's own images, clock and camera."""
    if not flight.sends_images:
        flight.kill('sky_simulator')
        flight.sends_images = True
    flight.clock_ns = 0
    flight.see_with(CAMERA)


def _make_well(flight: Flight, patience_s: float) -> None:
    """Wait until all runs well."""
    for node in (*STAGES, 'bag_recorder'):
        if not flight.runs(node):
            flight.start(node)
    since_s = time.monotonic()
    # The first time ever the nodes compile their kernels.
    if (flight.wait_recovered(since_s, 8 * patience_s) is None or not flight.fly(
            patience_s, lambda: flight.heard(
                'bag_recorder', 'recording', flight.started_s['bag_recorder']) is not None)):
        raise RigError(f'the nodes do not work: see {flight.folder}')
