# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The run of three heads: key figures of the demo, and its picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, UTC
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.astro.bodies import bright_bodies
from startracker_ros.core.astro.constants import EARTH_RADIUS_M
from startracker_ros.core.astro.epoch import epoch_year_from_stamp, stamp_from_datetime
from startracker_ros.core.astro.exclusion import STEP_S
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.maths.rotation import (
    ARCSEC, conjugate, matrix_from_quaternion, multiply, quaternion_from_axes,
    quaternion_from_rotation_vector, rotate)
from startracker_ros.io.recordings.recording import Recording
from startracker_ros.sim.sky.motion import SteadyMotion
from startracker_ros.tools.figures.correctness import count_wrong
from startracker_ros.tools.figures.rows import Row
from startracker_ros.tools.report.chart import draw_error, draw_errors, picture
from startracker_ros.tools.report.heads import HeadsRecording

# --- orbit and mounts ---

START_NS = stamp_from_datetime(datetime(2026, 6, 9, 12, tzinfo=UTC))
TURN_S = 600.0
"""Of the body: the time of an orbit, accelerated."""

ALTITUDE_M = 20_200e3
MOUNTS = {f'tracker_{number}': quaternion_from_axes(
    np.array(z, float), np.roll(np.array(z, float), 1)) for number, z in enumerate(
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)), 1)}
"""q_body_from_sensor (4,) of the heads."""

_AXIS = np.ones(3) / np.sqrt(3)
_CONE_RAD = np.arccos(_AXIS[2])
# From the cone, and around it from the Sun.
_SUN_OFF, _MOON_OFF, _EARTH_OFF = np.radians([20.0, 4.0, 24.0])
_EARTH_FROM_SUN = np.radians(165.5)
_START_FROM_SUN = np.radians(69.0)


def body_motion() -> SteadyMotion:
    """Return the motion of the body from START_NS on."""
    bodies = bright_bodies(epoch_year_from_stamp(START_NS))
    sun = bodies['Sun'][0]
    axis = _axis(sun, bodies['Moon'][0])

    def around(angle: float) -> np.ndarray:
        return rotate(quaternion_from_rotation_vector(axis * angle), sun)
    outwards = around(_EARTH_FROM_SUN) - axis * (axis @ sun)
    outwards /= np.linalg.norm(outwards)
    earth_rad = _CONE_RAD + _EARTH_OFF
    zenith = -(np.cos(earth_rad) * axis + np.sin(earth_rad) * outwards)
    start = quaternion_from_axes(axis, around(_START_FROM_SUN))
    q_icrf_from_body = multiply(start, conjugate(quaternion_from_axes(_AXIS, np.eye(3)[2])))
    return SteadyMotion(q_icrf_from_body, 2 * np.pi / TURN_S * _AXIS, _orbit(zenith, axis))


def _axis(sun: np.ndarray, moon: np.ndarray) -> np.ndarray:
    """Return the axis (3,) of the cone, from which Sun and Moon are as far as they have to be."""
    cosines = np.cos(_CONE_RAD + np.array([_SUN_OFF, _MOON_OFF]))
    pair = np.array([sun, moon])
    within = pair.T @ np.linalg.solve(pair @ pair.T, cosines)
    normal = np.cross(sun, moon)
    return within + normal * np.sqrt(1 - within @ within) / np.linalg.norm(normal)


def _orbit(zenith: np.ndarray, axis: np.ndarray) -> CircularOrbit:
    """Return the orbit that passes a zenith (3,) at time 0, in a plane across the axis' one."""
    normal = np.cross(zenith, np.cross(axis, zenith))
    normal /= np.linalg.norm(normal)
    node = np.arctan2(normal[0], -normal[1])
    to_node = np.array([np.cos(node), np.sin(node), 0.0])
    latitude = np.arctan2(zenith @ np.cross(normal, to_node), zenith @ to_node)
    return CircularOrbit(EARTH_RADIUS_M + ALTITUDE_M, float(np.arccos(normal[2])), float(node),
                         float(latitude))


# --- history ---

JUMP_SIGMAS = 3.0
FORECAST_LIMIT_S = STEP_S + 1.0  # tracker_state repeats a forecast for a second
_COLOURS = {'Sun': 'tab:orange', 'Moon': 'tab:grey', 'Earth': 'tab:blue'}


class Forecast(NamedTuple):
    """The next blinding of a head as tracker_state has it at a stamp: body or none, seconds."""

    head: str
    stamp_ns: int
    body: str
    in_s: float
    return_s: float


class Blinding(NamedTuple):
    """Frames first to end (exclusive) in which a body is within its exclusion angle of a head."""

    head: str
    body: str
    first: int
    end: int


@dataclass(frozen=True)
class HeadsHistory:
    """
    Frames at stamp_ns (N,) along the true motion of the body.

    has_attitude and identified (N,) by head: frames with a trusted attitude, and those whose stars
    were identified lost in space. exclusion_deg is by body.
    """

    stamp_ns: np.ndarray
    motion: SteadyMotion
    exclusion_deg: Mapping[str, float]
    has_attitude: Mapping[str, np.ndarray]
    identified: Mapping[str, np.ndarray]
    forecasts: tuple[Forecast, ...]

    @property
    def time_s(self) -> np.ndarray:
        """Return the times (N,) since the first frame."""
        return (self.stamp_ns - self.stamp_ns[0]) * 1e-9

    @cached_property
    def blindings(self) -> list[Blinding]:
        """Return the true blindings, by truth and ephemeris."""
        within = {(head, body): np.zeros(len(self.stamp_ns), bool)
                  for head in MOUNTS for body in self.exclusion_deg}
        for index, stamp_ns in enumerate(self.stamp_ns.tolist()):
            state = self.motion.at((stamp_ns - START_NS) * 1e-9)
            bodies = bright_bodies(epoch_year_from_stamp(stamp_ns), state.position_m)
            for head, mount in MOUNTS.items():
                q = multiply(state.q_icrf_from_sensor, mount)
                boresight = matrix_from_quaternion(q)[:, 2]
                for body, least_deg in self.exclusion_deg.items():
                    direction, radius_rad = bodies[body]
                    limb_rad = np.arccos(np.clip(boresight @ direction, -1, 1)) - radius_rad
                    within[head, body][index] = np.degrees(limb_rad) < least_deg
        found = []
        for (head, body), mask in within.items():
            edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
            found += [Blinding(head, body, int(first), int(end))
                      for first, end in edges.reshape(-1, 2)]
        return sorted(found, key=lambda blinding: blinding.first)

    def reacquisitions(self) -> list[int]:
        """Return frames from the first identified one to the next attitude after each blinding."""
        counts = []
        for blinding in self.blindings:
            attitude = self.has_attitude[blinding.head]
            dark = np.flatnonzero(~attitude[blinding.first:blinding.end]) + blinding.first
            if not len(dark):
                continue
            back = np.flatnonzero(attitude[dark[-1]:]) + dark[-1]
            seen = np.flatnonzero(self.identified[blinding.head][blinding.first:])
            seen = seen + blinding.first
            # Of those after the last frame without stars.
            seen = seen[seen <= back[0]] if len(back) else seen
            if len(back) and len(seen):
                counts.append(int(back[0] - seen[-1]))
        return counts

    def returns_s(self) -> list[float]:
        """Return the times from the end of each exclusion to an attitude, 0 with one there."""
        found = []
        for blinding in self.blindings:
            back = np.flatnonzero(self.has_attitude[blinding.head][blinding.end:])
            if len(back):
                found.append(float(self.time_s[blinding.end + back[0]]
                                   - self.time_s[blinding.end]))
        return found

    def forecast_errors_s(self) -> tuple[np.ndarray, np.ndarray]:
        """Return forecast minus true times (A,) to blindings and (B,) to returns, in s."""
        starts, ends = [], []
        for one in self.forecasts:
            index = int(np.searchsorted(self.stamp_ns, one.stamp_ns))
            now_s = self.time_s[index]
            # A forecast may be of a blinding that has just ended.
            ahead = [b for b in self.blindings if b.head == one.head and (
                b.end > index or b.body == one.body
                and now_s - self.time_s[b.end - 1] <= FORECAST_LIMIT_S)]
            if one.body == 'none' or not ahead:
                continue
            blinding = ahead[0]
            starts.append(one.in_s - max(0.0, self.time_s[blinding.first] - now_s))
            if blinding.end < len(self.stamp_ns):
                ends.append(one.return_s - (self.time_s[blinding.end] - now_s))
        return np.array(starts), np.array(ends)

    def rows(self, recording: Recording, heads: HeadsRecording) -> list[Row]:
        """Return the key figures, each with its bound."""
        stamps, error, sigma = recording.errors()
        fused = len(np.intersect1d(stamps, self.stamp_ns))
        share = 100 * fused / len(self.stamp_ns)
        wrong, gross = count_wrong(error * ARCSEC, sigma * ARCSEC)
        cross = float(np.sqrt(np.mean(error[:, :2] ** 2)))
        roll = float(np.sqrt(np.mean(error[:, 2] ** 2)))
        jump = self._jump(stamps, error, sigma, heads)
        blinded = {(b.head, b.body) for b in self.blindings}
        counts, returns = self.reacquisitions(), self.returns_s()
        starts, ends = self.forecast_errors_s()
        limit_s = FORECAST_LIMIT_S
        rows = [
            Row('frames', len(self.stamp_ns), 'frames'),
            Row('frames with fused attitude', share, '%', least=99),
            Row('wrong fused attitudes', wrong, 'frames', exactly=0),
            Row('gross fused attitudes', gross, 'frames', exactly=0),
            Row('fused error across the boresight of the first head, rms each axis', cross,
                'arcsec'),
            Row('fused error in its roll, rms', roll, 'arcsec'),
            Row('roll over cross error', roll / cross, '', most=1.3),
            Row('largest jump where a head drops out or returns', jump, 'sigma', most=JUMP_SIGMAS),
            Row('blindings; pairs of head and body', len(blinded), '')]
        if counts:
            rows.append(Row('after blinding: identified frame to attitude, most', max(counts),
                            'frames', most=1))
        if returns:
            rows.append(Row('end of the exclusion to attitude, longest', max(returns), 's',
                            exactly=0))
        for name, errors in (('blinding', starts), ('return', ends)):
            if len(errors):
                worst = float(np.abs(errors).max())
                rows.append(Row(f'forecast of the time to {name}, largest error', worst, 's',
                                most=limit_s))
        return [*rows, *self._mount_rows(heads)]

    def _jump(self, stamps: np.ndarray, error: np.ndarray, sigma: np.ndarray,
              heads: HeadsRecording) -> float:
        """
        Return the largest change of the error from one frame to the next, in sigma.

        The variance of the change is the sum of both: the errors of frames are all but independent
        where the noise of the gyro is that of a frame.
        """
        used = np.array([*heads.in_use(stamps).values()])
        changed = np.flatnonzero((used[:, 1:] != used[:, :-1]).any(axis=0)) + 1
        # What the fusion starts with has no frame before it.
        change = np.abs(error[changed] - error[changed - 1]) / np.hypot(
            sigma[changed], sigma[changed - 1])
        return float(change.max(initial=0.0))

    def _mount_rows(self, heads: HeadsRecording) -> list[Row]:
        rows = []
        for name, series in heads.mounts.items():
            # Without those of which the recorder lost the truth.
            known = np.isfinite(series.truth).all(axis=1)
            error, sigma = series.error_arcsec()[known], series.sigma_arcsec()[known]
            last = slice(len(error) // 2, None)
            within = 100 * float(np.mean(np.abs(error) <= 3 * sigma))
            rows += [Row(f'mount of {name}: error of the file at the start',
                         float(np.linalg.norm(error[0])), 'arcsec'),
                     Row(f'mount of {name}: error in the second half, rms', float(np.sqrt(np.mean(
                         np.sum(error[last] ** 2, axis=1)))), 'arcsec'),
                     Row(f'mount of {name}: axes within 3 sigma', within, '%', least=95)]
        return rows

    def draw(self, path: Path, recording: Recording, heads: HeadsRecording) -> None:
        """Write a PNG: error of the fused attitude, heads in use, errors of the mounts."""
        stamps, error, sigma = recording.errors()
        title = 'three heads, one attitude: each blinded in turn by Moon, Sun and Earth'
        with picture(path, 13, 130, title=title) as figure:
            grid = figure.add_gridspec(7, 1, height_ratios=(1, 1, 1, 1.3, 1, 1, 1))
            first, *_, last = draw_errors(
                [grid[row] for row in range(3)], self._since_s(stamps), error, sigma,
                ('x, cross', 'y, cross', 'z, roll'), 'arcsec',
                'error of the fused attitude about the axes of the first head')
            middle = figure.add_subplot(grid[3], sharex=first)
            self._draw_heads(middle, heads)
            mounts = [figure.add_subplot(grid[4 + row], sharex=first) for row in range(3)]
            for row, (axis, label) in enumerate(zip(mounts, 'xyz')):
                for colour, (name, series) in zip(('C1', 'C2'), heads.mounts.items()):
                    draw_error(axis, self._since_s(series.stamp_ns),
                               series.error_arcsec()[:, row], series.sigma_arcsec()[:, row],
                               label=name, band='', style='-', colour=colour)
                # The bounds of the first seconds may leave the panel.
                limit = max(max(1.1 * np.abs(series.error_arcsec()[:, row]).max(),
                                4.5 * np.median(series.sigma_arcsec()[:, row]))
                            for series in heads.mounts.values())
                axis.set(ylabel=f'mount, {label}\n[arcsec]', ylim=(-limit, limit))
            for axis in (last, middle, *mounts[:-1]):
                axis.tick_params(labelbottom=False)
            mounts[0].legend(loc='lower right', bbox_to_anchor=(1, 1), ncols=2, frameon=False,
                             borderaxespad=0.2)
            mounts[-1].set_xlabel('time [s]')

    def _draw_heads(self, axis: Any, heads: HeadsRecording) -> None:
        """Draw a bar for each head: its frames with attitude, in use by the fusion, the bodies."""
        used = heads.in_use(self.stamp_ns)
        step_s = float(np.median(np.diff(self.time_s)))
        for row, name in enumerate(MOUNTS):
            for lower, height, mask, colour in (
                    (row - 0.35, 0.4, used.get(name, np.zeros(len(self.stamp_ns), bool)),
                     'tab:green'),
                    (row + 0.05, 0.15, self.has_attitude[name], 'tab:olive')):
                edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
                axis.broken_barh([(self.time_s[a], self.time_s[b - 1] + step_s - self.time_s[a])
                                  for a, b in edges.reshape(-1, 2)], (lower, height),
                                 color=colour, linewidth=0)
            for blinding in self.blindings:
                if blinding.head == name:
                    begin_s = self.time_s[blinding.first]
                    axis.broken_barh([(begin_s, self.time_s[blinding.end - 1] - begin_s)],
                                     (row + 0.2, 0.2), color=_COLOURS[blinding.body], linewidth=0)
                    axis.text(begin_s, row + 0.22, blinding.body, fontsize=9)
        axis.set_yticks(range(len(MOUNTS)), MOUNTS)
        axis.set_title('green: in use by the fusion; olive: attitude of the head; above: bodies '
                       'within their exclusion angles', loc='left')

    def _since_s(self, stamp_ns: np.ndarray) -> np.ndarray:
        return (stamp_ns - self.stamp_ns[0]) * 1e-9
