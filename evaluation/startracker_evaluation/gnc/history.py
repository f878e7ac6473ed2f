# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a run of the loop was like: key figures, and a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from startracker_evaluation.gnc.loop import Step
from startracker_evaluation.gnc.plan import Phase, Plan
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.report.chart import picture

SETTLED_ARCSEC = 10.0
"""Settled: both errors across the boresight stay smaller from then on, for SETTLED_S at least."""

SETTLED_S = 10.0
FINE_RMS_ARCSEC, SETTLE_S = 2.0, 60.0
RECOVERY_S = 10.0
LOST_DEG = 5.0
"""Control is lost if the boresight is farther from its reference in or after the slew."""


class History:
    """
    The steps of a run, as arrays.

    time_s (N,); pointing_arcsec and knowledge_arcsec (N, 3) about sensor axes, NaN where there is
    none; torque_n_m (N, 4) of the motors; hold_s (N,).
    """

    def __init__(self, steps: Sequence[Step], plan: Plan) -> None:
        self.steps, self.plan = steps, plan
        self.time_s = np.array([step.time_ns for step in steps]) * 1e-9
        self.pointing_arcsec = np.array([step.pointing_rad for step in steps]) / ARCSEC
        self.knowledge_arcsec = np.array([step.knowledge_rad for step in steps]) / ARCSEC
        self.torque_n_m = np.array([step.truth.torque_n_m for step in steps])
        self.rate_deg_s = np.degrees(np.linalg.norm(
            [step.truth.rate_rad_s for step in steps], axis=1))
        self.hold_s = np.array([step.hold_s for step in steps])
        self.used = np.array([step.used for step in steps])
        self.wrong = sum(step.wrong.wrong for step in steps)
        self.gross = sum(step.wrong.gross for step in steps)

    def within(self, phase: Phase) -> np.ndarray:
        """Return which steps (N,) are of a phase."""
        return np.array([step.phase is phase for step in self.steps])

    def boresight_arcsec(self) -> np.ndarray:
        """Return the angle (N,) between the boresight and its reference."""
        return np.hypot(self.pointing_arcsec[:, 0], self.pointing_arcsec[:, 1])

    @property
    def fine_rms_arcsec(self) -> np.ndarray:
        """Return the rms (3,) in fine pointing about sensor x, y, z, NaN without such steps."""
        fine = self.pointing_arcsec[self.within(Phase.FINE)]
        return np.sqrt(np.mean(fine ** 2, axis=0)) if len(fine) else np.full(3, np.nan)

    @property
    def settle_s(self) -> float:
        """Return the time from the end of the profile to a settled boresight, inf without."""
        slew = self.plan.slew
        if slew is None:
            return np.inf
        after = self.within(Phase.SETTLE) | self.within(Phase.FINE)
        time_s = self.time_s[after]
        away = np.abs(self.pointing_arcsec[after, :2]).max(axis=1, initial=0.0) > SETTLED_ARCSEC
        if not len(time_s):
            return np.inf
        settled_s = time_s[np.flatnonzero(away)[-1]] if away.any() else slew.end_s
        return max(settled_s - slew.end_s, 0.0) if time_s[-1] - settled_s > SETTLED_S else np.inf

    @property
    def recovery_s(self) -> float:
        """Return the time from the end of the blinding to the next measurement, inf without."""
        later = self.within(Phase.RECOVERED)
        times = self.time_s[later & self.used]
        return float(times[0] - self.time_s[later][0]) if len(times) else np.inf

    @property
    def in_control(self) -> bool:
        """Return whether the boresight came to its reference and stayed near it."""
        farthest_arcsec = np.nanmax(self.boresight_arcsec(), initial=0.0)
        return bool(self.within(Phase.FINE).any() and farthest_arcsec < LOST_DEG * 3600)


def rows_of(history: History) -> list[Row]:
    """Return the key figures of the run of a whole plan, each with its bound."""
    begins, options = history.plan.begins_s, history.plan.options
    rows = [Row('detumbled', begins.get(Phase.ACQUIRE, np.inf), 's')]
    slew = history.plan.slew
    if slew is not None:
        rows.append(Row('slew begins', slew.begin_s, 's'))
        rows.append(Row(f'slew of {np.degrees(slew.angle_rad):g} deg settled after its profile',
                        history.settle_s, 's', most=SETTLE_S))
    for axis, rms in zip(('x, cross boresight', 'y, cross boresight'), history.fine_rms_arcsec):
        rows.append(Row(f'fine pointing rms, {axis}', float(rms), 'arcsec', most=FINE_RMS_ARCSEC))
    rows.append(Row('fine pointing rms, z, roll', float(history.fine_rms_arcsec[2]), 'arcsec'))
    if options.blinded_s:
        dark = history.within(Phase.BLINDED)
        worst = float(np.nanmax(history.boresight_arcsec()[dark], initial=0.0))
        rows += [Row('largest pointing error while blinded', worst, 'arcsec'),
                 Row('measurement again after blinding', history.recovery_s, 's', most=RECOVERY_S)]
    return [*rows,
            Row('longest hold by propagation', float(history.hold_s.max()), 's'),
            Row('largest motor torque', float(np.abs(history.torque_n_m).max()), 'N m'),
            Row('wrong attitudes used', history.wrong, 'frames', exactly=0),
            Row('gross attitudes used', history.gross, 'frames', exactly=0),
            Row('frames', len(history.steps), 'frames')]


def draw(path: Path, history: History, title: str) -> None:
    """Write a PNG: pointing and knowledge, rate, motor torques, tracker and hold over time."""
    with picture(path, 11, 130, title=title) as figure:
        pointing, rate, torque, hold = axes = figure.subplots(4, 1, sharex=True)
        time_s = history.time_s
        x, y, z = history.pointing_arcsec.T
        for name, error in (('cross boresight', np.hypot(x, y)), ('roll', np.abs(z))):
            pointing.semilogy(time_s, error, label=name, linewidth=0.8)
        knowledge = np.hypot(history.knowledge_arcsec[:, 0], history.knowledge_arcsec[:, 1])
        pointing.semilogy(time_s, knowledge, color='black', linewidth=0.5, alpha=0.6,
                          label='error of the estimated boresight')
        pointing.set(ylabel='pointing error [arcsec]', ylim=(1e-2, None))
        rate.semilogy(time_s, history.rate_deg_s, linewidth=0.8)
        rate.set_ylabel('true rate [deg/s]')
        for wheel in range(history.torque_n_m.shape[1]):
            torque.plot(time_s, 1e3 * history.torque_n_m[:, wheel], linewidth=0.8,
                        label=f'motor {wheel + 1}')
        torque.set_ylabel('torque [mN m]')
        hold.plot(time_s, history.hold_s, color='black', label='hold by propagation')
        hold.set(ylabel='hold [s]', xlabel='time [s]')
        _mark_states(hold, history)
        # Above the curves, phases that begin soon after one another on different lines.
        for row, (phase, begin_s) in enumerate(history.plan.begins_s.items()):
            pointing.annotate(f' {phase}', (begin_s, 1), (0, 4 + 14 * (row % 3)),
                              xycoords=pointing.get_xaxis_transform(), textcoords='offset points')
        pointing.legend(loc='upper center', bbox_to_anchor=(0.5, 0), ncols=4, frameon=False)
        for axis in (torque, hold):
            axis.legend(loc='lower center', bbox_to_anchor=(0.5, 1), ncols=4, frameon=False)
        for axis in axes:
            for begin_s in history.plan.begins_s.values():
                axis.axvline(begin_s, color='grey', linewidth=0.8, linestyle=':')


def _mark_states(axis: Any, history: History) -> None:
    """Shade the time axis by the state of the tracker."""
    colours = {'TRACKING': 'tab:green', 'ACQUIRING': 'tab:orange'}
    states = np.array([step.tracker for step in history.steps])
    for state in dict.fromkeys(states):
        axis.fill_between(history.time_s, 0, 1, where=states == state, alpha=0.2, linewidth=0,
                          transform=axis.get_xaxis_transform(), label=f'tracker {state}',
                          color=colours.get(state, 'tab:red'))
