# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Injects a fault into a running star tracker and measures its recovery."""

from collections.abc import Callable
from dataclasses import dataclass
import time

import numpy as np
from startracker_evaluation.harness.fault_rig import CAMERA, FaultRig
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.processes import HarnessError

STALE = 'no diagnostics for'
"""Expected of a node that publishes no diagnostics; an aggregator of them reports it."""
_STALE_S = 2.0
FRAMES_BOUND_S = 2.0


@dataclass(frozen=True)
class Times:
    """Durations of the long faults in s, and the number of start orders."""

    blind_s: float = 30.0
    stopped_s: float = 25.0
    dead_s: float = 3.0
    frames_s: float = 10.0
    orders: int = 6


@dataclass(frozen=True)
class Expected:
    """
    The expected end of a fault that was undone at undone_s; undone says in words by what.

    Recovery has to follow within bound_s. One of diagnostics (node, text) has to be received
    since the injection. recovered returns the time of recovery since a time where attitudes do
    not show it. problem is an error that was found while the fault lasted; gap_s is the longest
    time without an attitude where the fault should not interrupt them.
    """

    undone: str
    undone_s: float
    diagnostics: tuple[tuple[str, str], ...]
    bound_s: float = FRAMES_BOUND_S
    recovered: Callable[[float], float | None] | None = None
    problem: str = ''
    gap_s: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """
    The measured end of a fault.

    recovery_s is None without recovery. diagnostic is the expected one received: empty where
    none is expected, None where it is missing.
    """

    expected: Expected
    recovery_s: float | None
    longest_gap_s: float
    attitudes: int
    wrong: int
    gross: int
    diagnostic: str | None

    @property
    def holds(self) -> bool:
        """Return whether the fault ended as expected, within its bound."""
        return (self.recovery_s is not None and self.recovery_s <= self.expected.bound_s
                and self.expected.gap_s <= FRAMES_BOUND_S and self.wrong == 0
                and not self.expected.problem and self.diagnostic is not None)


Fault = Callable[[FaultRig, Times, np.random.Generator], Expected]
"""Injects a fault, runs for its duration and undoes it."""


def inject(rig: FaultRig, name: str, fault: Fault, times: Times, *, timeout_s: float = 30.0
           ) -> Outcome:
    """
    Inject a fault into a rig that works, and wait at most timeout_s for the recovery.

    HarnessError when the nodes do not work beforehand.
    """
    _wait_until_working(rig, timeout_s)
    rng = np.random.default_rng([rig.seed, *name.encode()])
    begin_s = time.monotonic()
    expected = fault(rig, times, rng)
    recovered = expected.recovered or rig.recovered_s
    rig.run(timeout_s, lambda: recovered(expected.undone_s) is not None)
    recovered_s = recovered(expected.undone_s)
    rig.run(timeout_s, lambda: _expected_diagnostic(rig, expected, begin_s) is not None)
    end_s = time.monotonic()
    diagnostic = _expected_diagnostic(rig, expected, begin_s)
    attitudes, (wrong, gross) = rig.count_attitudes(begin_s, end_s)
    _reset_inputs(rig)
    return Outcome(expected, None if recovered_s is None else recovered_s - expected.undone_s,
                   rig.longest_gap_s(begin_s, end_s), attitudes, wrong, gross,
                   diagnostic)


def row_of(name: str, outcome: Outcome) -> dict[str, object]:
    """Return the row of a fault in the table of the campaign."""
    expected = outcome.expected
    problem = expected.problem or (
        f'no attitude for {expected.gap_s:.1f} s' if expected.gap_s > FRAMES_BOUND_S else '')
    return {'fault': name, 'recovery_from': expected.undone, 'recovery_s': outcome.recovery_s,
            'bound_s': expected.bound_s, 'longest_gap_s': outcome.longest_gap_s,
            'attitudes': outcome.attitudes, 'wrong': outcome.wrong,
            'gross': outcome.gross, 'reported': problem or outcome.diagnostic or None,
            'holds': outcome.holds}


def _expected_diagnostic(rig: FaultRig, expected: Expected, begin_s: float) -> str | None:
    """Return the expected diagnostic, empty where none is expected, None while it is missing."""
    if not expected.diagnostics:
        return ''
    for node, text in expected.diagnostics:
        found = rig.probe.find_diagnostic(text, node=node, since_s=begin_s)
        if found is not None:
            return f'{node}: {found.status.message}'
        silence_s = rig.probe.longest_silence_s(node, begin_s)
        if text == STALE and silence_s > _STALE_S:
            return f'{node}: {STALE} {silence_s:.1f} s'
    return None


def _reset_inputs(rig: FaultRig) -> None:
    """Return to the images, the clock and the camera of the rig."""
    if not rig.publishes_images:
        rig.processes.kill('sky_simulator')
        rig.publishes_images = True
    rig.clock_offset_ns = 0
    rig.set_camera(CAMERA)


def _wait_until_working(rig: FaultRig, timeout_s: float) -> None:
    """Start the nodes that do not run; wait for attitudes and for a recording."""
    for node in (*STAGES, 'bag_recorder'):
        if not rig.processes.is_running(node):
            rig.start(node)
    since_s = time.monotonic()
    # The first start on a machine compiles the kernels.
    if (rig.wait_recovered(since_s, 8 * timeout_s) is None or not rig.run(
            timeout_s, lambda: rig.probe.find_diagnostic(
                'recording', node='bag_recorder',
                since_s=rig.started_s['bag_recorder']) is not None)):
        raise HarnessError(f'the nodes do not work: see {rig.log_folder}')
