# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Faults in the closed loop: control must not be lost, no wrong attitude be used."""

from collections.abc import Sequence
from dataclasses import dataclass
import time

import numpy as np
from startracker_evaluation.gnc.basilisk_messages import import_basilisk
from startracker_evaluation.gnc.camera import (
    FrameFault, ImageCamera, LoopCamera, SIGMA_PX, SOUND, StarListCamera)
from startracker_evaluation.gnc.history import FINE_RMS_ARCSEC, History, LOST_DEG, SETTLE_S
from startracker_evaluation.gnc.loop import ClosedLoop, Step
from startracker_evaluation.gnc.navigation import Navigation
from startracker_evaluation.gnc.plan import Phase, Plan, PlanOptions
from startracker_evaluation.gnc.spacecraft import (
    CONTROL_NS, SpacecraftOptions, TUMBLE_DEG_S, tumbling)
from startracker_ros.io.table import Result
from startracker_ros.tools.figures.correctness import WRONG_TEXT
from startracker_ros.tools.parallel import parallel_map

_STEP_S = CONTROL_NS * 1e-9
_BLOCK = 18_000
"""Frames that are kept at a time, an hour."""


@dataclass(frozen=True)
class LoopCondition:
    """
    Runs of one kind, each duration_s of simulated time long.

    share is the part of the trials that are run, at least one; images: rendered, otherwise star
    lists; blinded_s is how long the Sun shines in.
    """

    duration_s: float
    share: float = 1.0
    faults: bool = False
    images: bool = False
    blinded_s: float = 30.0


CONDITIONS = {
    'quiet, star lists': LoopCondition(400.0, share=0.2),
    'quiet, images': LoopCondition(400.0, share=0.02),
    'faults, star lists': LoopCondition(1200.0, faults=True),
    'faults, images': LoopCondition(400.0, share=0.02, faults=True),
    '24 hours, star lists': LoopCondition(86400.0, share=0.0, blinded_s=0.0),
}


@dataclass(frozen=True)
class RunResult:
    """
    What one run or one hour of it was like.

    rms_arcsec (3,) is that of fine pointing without faults of the plan, NaN without any.
    """

    frames: int
    fine: bool
    in_control: bool
    wrong: int
    gross: int
    used: int
    settle_s: float
    rms_arcsec: tuple[float, float, float]
    hold_s: float
    wall_s: float


@dataclass(frozen=True)
class ClosedLoopRow:
    """The runs of one condition; the figures are the worst of them, rms across the boresight."""

    condition: str
    runs: int
    fine_pointing: int
    in_control: int
    wrong_used: int
    gross_used: int
    settle_s: float
    fine_rms_x_arcsec: float
    fine_rms_y_arcsec: float
    longest_hold_s: float
    times_real_time: float
    bound: str
    holds: bool


class Faults:
    """
    Faults of the frames of a run, drawn once: fault(time_s) returns those of a frame.

    5 % of the frames are dropped, 2 % are torn, 1 % have a time tag that is 50 ms wrong; besides
    there are bursts of 1 to 3 s without frames, of 5 to 20 s of blinding and of 20 s of wrong
    time tags, two of each.
    """

    def __init__(self, duration_s: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self._dropped, self._blinded, self._late = (
            [(begin_s, begin_s + rng.uniform(*length_s), rng.choice([-0.05, 0.05]))
             for begin_s in rng.uniform(0, duration_s, 2)]
            for length_s in ((1.0, 3.0), (5.0, 20.0), (20.0, 20.0)))

    def fault(self, time_s: float) -> FrameFault:
        """Return what is wrong with the next frame."""
        rng = self._rng
        offset_s = _within(self._late, time_s)
        if rng.random() < 0.01:
            offset_s = rng.choice([-0.05, 0.05])
        return FrameFault(
            blinded=bool(_within(self._blinded, time_s)),
            dropped=bool(rng.random() < 0.05 or _within(self._dropped, time_s)),
            torn=bool(rng.random() < 0.02), offset_s=float(offset_s))


def _within(intervals: Sequence[tuple[float, float, float]], time_s: float) -> float:
    """Return the value of the interval that a time is in, 0 outside of all."""
    return next((value for begin, end, value in intervals if begin <= time_s < end), 0.0)


def make_loop(condition: LoopCondition, seed: int) -> ClosedLoop:
    """Return the loop of a run, tumbling at TUMBLE_DEG_S; with faults, of the spacecraft too."""
    rng = np.random.default_rng(seed)
    options, fault = SpacecraftOptions(), _sound
    if condition.faults:
        options = SpacecraftOptions(
            inertia_error=tuple(rng.uniform(-0.02, 0.02, 3)),
            coulomb_n_m=tuple(rng.uniform(0.0, 0.002, 4)),
            gyro_bias_rad_s=tuple(np.radians(rng.uniform(-30, 30, 3) / 3600)))
        fault = Faults(condition.duration_s, rng).fault
    spacecraft = tumbling(rng, options, seed=seed)
    camera: LoopCamera = (ImageCamera(seed=seed, frame_rate_hz=1 / _STEP_S) if condition.images
                          else StarListCamera(seed=seed))
    return ClosedLoop(spacecraft, camera, Navigation(np.array(options.inertia_kg_m2)),
                      Plan(PlanOptions(blinded_s=condition.blinded_s)), fault)


def _sound(time_s: float) -> FrameFault:
    return SOUND


def run(name: str, seed: int, hours: float = np.inf) -> list[RunResult]:
    """Return the results of one run, hour by hour; only so many hours of it."""
    condition = CONDITIONS[name]
    loop = make_loop(condition, seed)
    left = round(min(condition.duration_s, hours * 3600) / _STEP_S)
    results = []
    while left:
        begin_s, steps = time.perf_counter(), []
        for _ in range(min(left, _BLOCK)):
            steps.append(loop.step())
        left -= len(steps)
        results.append(_result(steps, loop.plan, time.perf_counter() - begin_s))
    return results


def _result(steps: list[Step], plan: Plan, wall_s: float) -> RunResult:
    history = History(steps, plan)
    x, y, z = history.fine_rms_arcsec
    return RunResult(
        len(steps), Phase.FINE in plan.begins_s, history.in_control, history.wrong, history.gross,
        int(history.used.sum()), history.settle_s, (float(x), float(y), float(z)),
        float(history.hold_s.max()), wall_s)


def row_of(name: str, runs: Sequence[list[RunResult]]) -> ClosedLoopRow:
    """Return the row of the runs of a condition."""
    condition, hours = CONDITIONS[name], [hour for run in runs for hour in run]
    fine = sum(run[-1].fine for run in runs)
    in_control = sum(all(hour.in_control for hour in run) for run in runs)
    wrong, gross = sum(hour.wrong for hour in hours), sum(hour.gross for hour in hours)
    settle_s = max(run[0].settle_s for run in runs)
    x, y, _ = np.nanmax([hour.rms_arcsec for hour in hours], axis=0, initial=0.0)
    bound = f'all reach fine pointing and stay within {LOST_DEG:g} deg; 0 wrong used'
    holds = fine == in_control == len(runs) and wrong == 0
    if not condition.faults:
        bound += f'; rms <= {FINE_RMS_ARCSEC:g} arcsec, settled in {SETTLE_S:g} s'
        holds = holds and max(x, y) <= FINE_RMS_ARCSEC and settle_s <= SETTLE_S
    return ClosedLoopRow(
        name, len(runs), fine, in_control, wrong, gross, settle_s, float(x), float(y),
        max(hour.hold_s for hour in hours),
        sum(hour.frames for hour in hours) * _STEP_S / sum(hour.wall_s for hour in hours),
        bound, bool(holds))


def run_closed_loop_campaign(*, trials: int, seed: int, only: tuple[str, ...] = (),
                             scheduler: str = '') -> Result:
    """Run trials runs with faults on star lists, and fewer of the other conditions."""
    import_basilisk()
    names = only or tuple(CONDITIONS)
    pieces = [(name, seed * 1_000_003 + 7919 * index) for name in names
              for index in range(max(1, round(trials * CONDITIONS[name].share)))]
    done = parallel_map(run, pieces, title='closed loop', scheduler=scheduler)
    rows = [row_of(name, [result for piece, result in zip(pieces, done) if piece[0] == name])
            for name in names]
    return Result('campaign closed-loop', rows, {
        'loop': f'Basilisk, {1 / _STEP_S:g} Hz, gyroless once an attitude is known; from '
                f'{TUMBLE_DEG_S:g} deg/s through a slew of 90 deg to fine pointing, blinded for '
                '30 s',
        'star lists': f'centroids of {SIGMA_PX:g} px, 3 false, 5 % missing; images: rendered, '
                      'smeared by the motion',
        'faults': '5 % of the frames dropped, 2 % torn, 1 % and twice 20 s with time tags 50 ms '
                  'off, twice 1 to 3 s without frames, twice 5 to 20 s blinded; wheels of 0 to '
                  '2 mN m of friction, inertia 2 % off, gyro drift to 30 deg/h',
        'wrong': f'used by the navigation and {WRONG_TEXT}; that contains the rate times 20 ms',
        'settle_s': 'from the end of the profile',
        'times_real_time': 'simulated time over wall time of one process',
        'trials': trials, 'seed': seed})
