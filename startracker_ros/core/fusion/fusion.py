# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Several heads, one attitude of the body: each head is checked against the others and the gyro.

Frames may come late and out of order. States are stored over the horizon; a late frame corrects
the state of its time, from which the frames after it are used again.
"""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.constants import SPEED_OF_LIGHT_M_S
from startracker_ros.core.astro.epoch import why_no_date
from startracker_ros.core.astro.observer_motion import EARTH_SIGMA_M_S
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.fusion.head import Head, HeadFrame, HeadState
from startracker_ros.core.fusion.motion import BodyMotion
from startracker_ros.core.fusion.mounts import Mount, MountOptions
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.fusion.state import BODY, FusedState, GATE, Innovation, Measurement
from startracker_ros.core.fusion.steps import MountStep, StepDetector
from startracker_ros.core.integrity.checks import HEAD_DIFFERS, HEAD_RETURNS
from startracker_ros.core.maths.compiled_rotation import rotation_between
from startracker_ros.core.maths.rotation import (
    ARCSEC, matrix_from_quaternion, multiply, quaternion_from_rotation_vector, sign_continuous)
from startracker_ros.core.track.motion_filter import resumed, weight_of, WIDE, with_tails
from startracker_ros.core.track.tracks import Hint

RETURN_GATE = HEAD_RETURNS.threshold
START_FACTORS = 10.0, 100.0
"""Accelerations before a start, in units of acceleration_deg_s2, and before one that follows."""

_PLAUSIBLE_FRAMES = 4  # of a head from one check of its mount to the next
RESTART_FRAMES = 3  # in a row that no state can be compared with

_SHARP_RAD = 10 * ARCSEC  # a prediction that decides alone whether a head is right
_START_RAD, _START_RAD_S = 0.1, 0.1


@dataclass(frozen=True)
class FusedAttitude:
    """
    The attitude of the body at a stamp.

    quaternion (4,) is q_icrf_from_body, covariance (3, 3) rad^2 about body axes; rate and drift
    (3,) rad/s about body axes with their covariances (3, 3).
    """

    stamp_ns: int
    quaternion: np.ndarray
    covariance: np.ndarray
    rate_rad_s: np.ndarray
    rate_covariance: np.ndarray
    drift_rad_s: np.ndarray
    drift_covariance: np.ndarray


class _Entry(NamedTuple):
    """A frame and the state after it."""

    state: FusedState
    head: Head
    frame: HeadFrame


class AttitudeFusion:
    """
    Fuses the frames of heads, in any order, and rates about body axes.

    mounts by name are those of the file; the first is the reference, whose mount defines the
    body. heads are by name, mounts what is learnt of theirs, motion has the gyro. trouble is why
    there is no attitude, empty if there is one; steps are the steps of mounts that were found, to
    be taken out by the caller.
    """

    def __init__(self, mounts: Mapping[str, Mount], options: FusionOptions = FusionOptions(),
                 mount_options: MountOptions = MountOptions(),
                 gyro_options: GyroErrorOptions = GyroErrorOptions()) -> None:
        if not mounts:
            raise ValueError('no heads')
        self._options = options
        self.heads: dict[str, Head] = {}
        for name, mount in mounts.items():
            first = max((head.columns.stop for head in self.heads.values()), default=BODY)
            self.heads[name] = Head(name, mount, mount_options, first, not self.heads,
                                    options.correlation_s)
        self.mounts = MountBank(self.heads)
        self.motion = BodyMotion(options, gyro_options, np.concatenate(
            [head.walk() for head in self.heads.values()]))
        self._needed = min(options.start_heads, len(self.heads))
        self.reset()

    def reset(self) -> None:
        """Forget attitude, gyro and frames; the mounts are those of the file again."""
        self._history: list[_Entry] = []
        for head in self.heads.values():
            head.reset()
        self.mounts.reset()
        self.motion.reset()
        self._steps = StepDetector(tuple(self.heads))
        self.steps: list[MountStep] = []
        self._drop('waiting for frames')
        self._previous: np.ndarray | None = None

    def _drop(self, trouble: str) -> None:
        """Drop the attitude, not the mounts."""
        self._history = []
        self.trouble = trouble
        self._untested = 0
        self.motion.forget_gyro()

    # --- input ---

    def add_rate(self, stamp_ns: int, rate_rad_s: np.ndarray) -> bool:
        """Add a rate (3,) about body axes as BodyMotion does."""
        return self.motion.add_rate(stamp_ns, rate_rad_s)

    def add_frame(self, name: str, frame: HeadFrame) -> FusedAttitude | None:
        """Add a frame of a head; return the attitude at its stamp if it counts as the newest."""
        head = self.heads[name]
        accepted = head.accept(frame)
        if accepted is None:
            head.counts['repeated stamps'] += 1
            head.reason = 'repeats stamps'
            return None
        frame = accepted
        if not self._history:
            return self._start(head, frame)
        newest_ns = self._history[-1].state.stamp_ns
        late_s = (newest_ns - frame.stamp_ns) * 1e-9
        if late_s > self._options.horizon_s or frame.stamp_ns < self._history[0].state.stamp_ns:
            head.counts['late'] += 1
            head.reason = f'frames {late_s:.1f} s behind the other heads'
        elif -late_s > self.motion.bridged_s(frame.stamp_ns):
            head.counts['ahead'] += 1
            head.reason = f'frames {-late_s:.1f} s ahead of the other heads'
        elif self.motion.extrapolates(frame.stamp_ns) and self._live(newest_ns, head):
            head.counts['ahead'] += 1
            head.reason = f'frames {-late_s:.1f} s ahead of the other heads, and ahead of imu'
        else:
            return self._test(head, frame)
        if head.state is HeadState.USED and head.is_silent(newest_ns, self._options.max_gap_s):
            head.enter(HeadState.CHECKED, head.reason)
        self._untested += 1
        return self._start(head, frame) if self._untested >= RESTART_FRAMES else None

    # --- from frame to frame ---

    def _measurement(self, state: FusedState, head: Head, frame: HeadFrame) -> Measurement:
        return head.measurement(frame, state.coefficients[own_coefficients(head)])

    def _innovation(self, state: FusedState, head: Head, frame: HeadFrame) -> Innovation:
        return state.innovation(self._measurement(state, head, frame))

    def _test(self, head: Head, frame: HeadFrame) -> FusedAttitude | None:
        """Compare a frame with the state of its time and use it if the head counts."""
        index = bisect_right(
            self._history, frame.stamp_ns, key=lambda entry: entry.state.stamp_ns)
        before, newest = self._history[index - 1].state, index == len(self._history)
        predicted = self.motion.propagated(before, frame.stamp_ns)
        if self._gave_up(predicted):
            return None
        innovation = self._innovation(predicted, head, frame)
        if innovation.nis > GATE and newest and self._is_alone(head, frame.stamp_ns):
            for mode in WIDE:
                predicted = FusedState.of(
                    predicted.motion, weight_of(predicted.motion, mode))
                innovation = self._innovation(predicted, head, frame)
                if innovation.nis <= GATE:
                    break
        if head.state is HeadState.USED:
            head.noise.add(innovation.nis, [
                other.noise for other in self._live(frame.stamp_ns, head)])
        if innovation.nis > GATE:
            head.counts['disagreeing'] += 1
            return self._disputed(head, frame, innovation)
        if not self._counts(head, frame, predicted, innovation):
            head.counts['agreeing, not counted yet'] += 1
            return None
        state = predicted.updated(innovation.measured, before.stamp_ns)
        if self._gave_up(state):
            return None
        head.counts['used'] += 1
        self._insert(index, _Entry(state, head, frame))
        self._observe(head, frame, predicted, innovation)
        head.used_ns = max(frame.stamp_ns, head.used_ns or frame.stamp_ns)
        if not newest or (head.counts['used'] % _PLAUSIBLE_FRAMES == 0
                          and self._has_implausible_mounts(frame.stamp_ns)):
            return None
        if self.motion.compare_gyro(head.name, before, state, innovation.measured):
            self._history[-1] = self._history[-1]._replace(state=state.with_unknown_motion(
                _START_RAD_S, self.motion.drift_sigma_rad_s))
        return self._result()

    def _gave_up(self, state: FusedState) -> bool:
        """Drop a state whose covariance is none, with the mounts learnt; return whether it is."""
        if state.has_covariance:
            return False
        self._drop('the covariance of the filter is not positive definite, its diagonal is '
                   f'{np.diagonal(state.covariance).tolist()}')
        self.mounts.reset()
        return True

    def _counts(self, head: Head, frame: HeadFrame, predicted: FusedState,
                innovation: Innovation) -> bool:
        """Return whether a frame that agrees counts, and count how long its head has agreed."""
        silent = head.is_silent(frame.stamp_ns, self._options.max_gap_s)
        if head.state is HeadState.USED and not silent:
            head.disagreed, head.reason = 0, ''
            return True
        others = self._live(frame.stamp_ns, head)
        sigma_rad = math.sqrt(max(np.diagonal(predicted.covariance)[:3]))
        if not others and sigma_rad > _SHARP_RAD and self._needed > 1:
            head.enter(HeadState.CHECKED, 'no other head or prediction to check it')
            self._untested += 1
            if self._untested >= RESTART_FRAMES:
                self._drop('no head that another one confirms')
            return False
        if head.state is HeadState.USED or head.state is HeadState.WAITING:
            head.enter(HeadState.CHECKED, 'is checked after a time without frames')
        head.agreed = [*head.agreed, innovation.nis][-self._options.agree_frames:]
        if len(head.agreed) < self._options.agree_frames:
            return False
        if sum(head.agreed) > self._options.agree_frames * RETURN_GATE:
            # An error that lasts shows in the mean, though each frame is within the gate.
            head.enter(HeadState.EXCLUDED, _disagreement(innovation))
            return False
        if innovation.nis > RETURN_GATE:
            return False
        head.enter(HeadState.USED)
        return True

    def is_missing(self, name: str, stamp_ns: int) -> bool:
        """Return whether a head has had no frame that counts for so long that it is silent."""
        return self.heads[name].is_silent(stamp_ns, self._options.max_gap_s)

    def _is_live(self, head: Head, stamp_ns: int) -> bool:
        """Return whether a head counts and its last frames did."""
        return (head.state is HeadState.USED and not head.disagreed
                and not head.is_silent(stamp_ns, self._options.max_gap_s))

    def _live(self, stamp_ns: int, but: Head | None = None) -> list[Head]:
        """Return the heads that count, but for one."""
        return [head for head in self.heads.values()
                if head is not but and self._is_live(head, stamp_ns)]

    def _is_alone(self, head: Head, stamp_ns: int) -> bool:
        """Return whether a head without gyro is the only one that counts: it may manoeuvre."""
        return (self._is_live(head, stamp_ns) and not self.motion.gyro_runs(stamp_ns)
                and not self._live(stamp_ns, head))

    def _disputed(self, head: Head, frame: HeadFrame, innovation: Innovation
                  ) -> FusedAttitude | None:
        """Use no frame that disagrees, unless two heads are more than those that agree."""
        head.agreed.clear()
        head.disagreed += 1
        head.reason = _disagreement(innovation)
        if head.state is not HeadState.USED or head.disagreed >= self._options.exclude_frames:
            disagreed = head.disagreed
            head.enter(HeadState.EXCLUDED, head.reason)
            head.disagreed = disagreed
        live, newest_ns = self._live(frame.stamp_ns), self._history[-1].state.stamp_ns
        result = self._start(head, frame) if len(live) < 2 else None
        if not (result or live or self._live(newest_ns)):
            self.trouble = f'{head.name} is {head.reason}, and no other head counts'
        return result

    def _insert(self, index: int, entry: _Entry) -> None:
        """Insert a frame, use those after it again, and forget those beyond the horizon."""
        later = self._history[index:]
        self._history[index:] = [entry]
        for after in later:
            before = self._history[-1].state
            state = self.motion.propagated(before, after.frame.stamp_ns)
            self._history.append(after._replace(state=state.updated(
                self._measurement(state, after.head, after.frame), before.stamp_ns)))
        oldest_ns = self._history[-1].state.stamp_ns - round(self._options.horizon_s * 1e9)
        while len(self._history) > 1 and self._history[1].state.stamp_ns <= oldest_ns:
            del self._history[0]
        self.mounts.follow(self._history[-1].state)
        self._untested, self.trouble = 0, ''

    def _result(self) -> FusedAttitude:
        state = self._history[-1].state
        P = with_tails(state.motion, state.covariance[:6, :6].copy())
        self._previous = sign_continuous(state.quaternion, self._previous)
        return FusedAttitude(
            state.stamp_ns, self._previous, P[:3, :3] + self._lasting_rad2 * np.eye(3), state.rate,
            P[3:, 3:], state.drift, state.covariance[6:BODY, 6:BODY])

    @property
    def _lasting_rad2(self) -> float:
        """Return the variance per axis of an error that is in all frames: of an unknown date."""
        newest = self._history[-1]
        if not why_no_date(newest.state.stamp_ns):
            return 0.0
        # Across the boresight, which two axes are. Heads of a sky without aberration have less.
        across = float(np.linalg.eigvalsh(newest.frame.covariance)[1])
        return min(across, (EARTH_SIGMA_M_S / SPEED_OF_LIGHT_M_S) ** 2)

    # --- start ---

    def _start(self, head: Head, frame: HeadFrame) -> FusedAttitude | None:
        """
        Begin with two frames of a head and one of another that agrees, or with one head.

        A state before is replaced: its mounts are used again, not its gyro.
        """
        trouble = ''
        for other in self._candidates(head, frame):
            # Heads that have agreed before see a manoeuvre, others may be wrong by its size.
            known = self._history and {head.state, other.state} == {HeadState.USED}
            factor = START_FACTORS[-1 if known else 0]
            entries = self._begun(other)
            if other is not head:
                before = entries[-1].state
                innovation = self._innovation(self.motion.at_constant_rate(
                    before, frame.stamp_ns, factor), head, frame)
                if innovation.nis > RETURN_GATE:
                    angle_deg = math.degrees(float(np.linalg.norm(innovation.vector)))
                    # In one order, whichever frame came last: the text is one condition.
                    names = ' and '.join(sorted((other.name, head.name)))
                    trouble = f'{names} disagree by {angle_deg:.3g} deg'
                    continue
                entries.append(self._next_entry(before, head, frame))
            return self._started(entries)
        if not self._history:
            self.trouble = trouble or (
                'no frames of two heads at a time' if self._needed > 1 else 'waiting for frames')
        return None

    def _candidates(self, head: Head, frame: HeadFrame) -> list[Head]:
        """Return the heads that may confirm a frame, excluded ones only if there are no others."""
        if self._needed == 1:
            return [head] if self._is_candidate(head, frame) else []
        good = [one for one in self.heads.values() if one.state is not HeadState.EXCLUDED
                and one.has_frames(frame.stamp_ns, self._options.max_gap_s)]
        heads = good if len(good) > 1 else self.heads.values()
        return [one for one in heads if one is not head and self._is_candidate(one, frame)
                ] if len(good) < 2 or head in good else []

    def _is_candidate(self, other: Head, frame: HeadFrame) -> bool:
        """Return whether another head has new frames of its own that are in use nowhere."""
        if len(other.recent) < 2 or self._history and other.used_ns == other.recent[-1].stamp_ns:
            return False
        age_s = (frame.stamp_ns - other.recent[-1].stamp_ns) * 1e-9
        step_s = (other.recent[-1].stamp_ns - other.recent[0].stamp_ns) * 1e-9
        return 0 <= age_s <= self._options.max_gap_s and 0 < step_s <= self._options.max_gap_s

    def _begun(self, head: Head) -> list[_Entry]:
        """Return the states after two frames of a head, by a prior that knows nothing."""
        coefficients, covariance = self.mounts.coefficients, self.mounts.covariance
        first, second = head.recent
        own = own_coefficients(head)
        quaternions = [head.measurement(frame, coefficients[own]).quaternion
                       for frame in (first, second)]
        dt_s = (second.stamp_ns - first.stamp_ns) * 1e-9
        P = np.zeros((BODY + len(coefficients), BODY + len(coefficients)))
        P[:BODY, :BODY] = np.diag(np.repeat([
            _START_RAD ** 2, _START_RAD_S ** 2, self.motion.drift_sigma_rad_s ** 2], 3))
        P[BODY:, BODY:] = covariance
        body = AttitudeState(first.stamp_ns, quaternions[0],
                             rotation_between(*quaternions) / dt_s, np.zeros(3), P)
        state = FusedState.begin(
            body, np.diagonal(head.measurement(first, coefficients[own]).covariance).copy(), dt_s,
            coefficients)
        if self._history:
            state = FusedState.of(resumed(state.motion, self._history[-1].state.motion))
        entry = self._next_entry(state, head, first)
        return [entry, self._next_entry(entry.state, head, second)]

    def _next_entry(self, before: FusedState, head: Head, frame: HeadFrame) -> _Entry:
        """Return a frame of a start and the state after it."""
        state = self.motion.without_gyro(before, frame.stamp_ns)
        return _Entry(state.updated(self._measurement(state, head, frame), before.stamp_ns),
                      head, frame)

    def _started(self, entries: list[_Entry]) -> FusedAttitude:
        """Use the states of a start."""
        stamp_ns = entries[-1].state.stamp_ns
        if (self.motion.gyro_runs(stamp_ns) and (stamp_ns - self._history[-1].state.stamp_ns)
                <= self._options.max_gyro_gap_s * 1e9):
            self.motion.contradict_gyro('the heads agree with each other and not with imu')
        self._drop('')
        self._history = entries
        self.mounts.follow(entries[-1].state)
        for entry in entries:
            if entry.head.state is not HeadState.USED:
                entry.head.enter(HeadState.USED)
            entry.head.disagreed, entry.head.reason = 0, ''
            entry.head.used_ns = entry.frame.stamp_ns
            entry.head.counts['used'] += 1
        return self._result()

    # --- mounts ---

    def _has_implausible_mounts(self, stamp_ns: int) -> bool:
        """
        Drop the attitude where a mount has left what its file allows, and exclude the head.

        The reference, where two others have left theirs: all mounts are against it.
        """
        wrong = self.mounts.implausible(stamp_ns)
        if not wrong:
            return False
        names = ', '.join(head.name for head in wrong)
        text = f'mount of {names} further from mounts_file than its sigma allows'
        self._drop(text)
        self.mounts.reset()
        reference = next(iter(self.heads.values()))
        if reference.state is not HeadState.USED or len(self.heads) == 2:
            # The mounts of those in use are against each other: any may be wrong.
            suspects = list(self.heads.values())
        else:
            suspects = [reference] if len(wrong) > 1 else wrong
        for head in suspects:
            head.enter(HeadState.EXCLUDED, text)
        return True

    def _observe(self, head: Head, frame: HeadFrame, predicted: FusedState,
                 innovation: Innovation) -> None:
        """Look for steps of the mounts in the differences of the heads."""
        measured, own = innovation.measured, own_coefficients(head)
        offset = innovation.vector + measured.sensitivity @ predicted.coefficients[own]
        variance = np.diagonal(predicted.covariance)[:3] + np.diagonal(measured.covariance)
        for step in self._steps.add(head.name, frame.stamp_ns, offset, variance,
                                    measured.sensitivity[0, 3::3]):
            self.steps.append(step)
            self.heads[step.head].stepped_rad2 += float(step.size_rad @ step.size_rad)
            self._history = [entry._replace(state=reopened(
                entry.state, self.heads[step.head], step)) for entry in self._history]


def _disagreement(innovation: Innovation) -> str:
    return HEAD_DIFFERS.diagnostic.format(
        angle_deg=math.degrees(float(np.linalg.norm(innovation.vector))))


def warm_up() -> None:
    """Compile and load what a frame needs."""
    fusion = AttitudeFusion({'head': Mount(np.array([0.0, 0.0, 0.0, 1.0]))})
    for stamp_ns in range(0, 10 ** 9, 10 ** 8):
        fusion.add_rate(stamp_ns, np.zeros(3))
        fusion.add_frame('head', HeadFrame(
            stamp_ns, np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3) * ARCSEC ** 2))


def hint_for(fusion: AttitudeFusion, name: str, fused: FusedAttitude) -> Hint:
    """Return the fused attitude and rate on the axes of a head, with the error of its mount."""
    mount, covariance = fusion.mounts.at(name, fused.stamp_ns)
    R = matrix_from_quaternion(mount)
    return Hint(fused.stamp_ns, multiply(fused.quaternion, mount),
                R.T @ (fused.covariance + covariance) @ R,
                R.T @ fused.rate_rad_s, R.T @ fused.rate_covariance @ R)


# --- the mounts of all heads as learnt so far: out of the state of the fusion, or of the file ---


class MountBank:
    """coefficients (M,) rad of all mounts and their covariance (M, M), by the newest state."""

    def __init__(self, heads: Mapping[str, Head]) -> None:
        self._heads = heads
        self.reset()

    def reset(self) -> None:
        """Return to what files and options have."""
        priors = [head.prior for head in self._heads.values()]
        self.coefficients = np.concatenate([mean for mean, _ in priors])
        self.covariance = np.zeros((len(self.coefficients), len(self.coefficients)))
        for head, (_, covariance) in zip(self._heads.values(), priors):
            own = own_coefficients(head)
            self.covariance[own, own] = covariance

    def follow(self, state: FusedState) -> None:
        """Use the mounts of a state."""
        self.coefficients, self.covariance = state.coefficients, state.covariance[BODY:, BODY:]

    def learnt(self) -> dict[str, Mount]:
        """Return the mounts for the file."""
        return {name: head.learnt(self.coefficients[own_coefficients(head)],
                                  self.covariance[own_coefficients(head), own_coefficients(head)])
                for name, head in self._heads.items()}

    def misalignment(self, name: str, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return what a mount differs from its file (3,) rad, and its covariance (3, 3)."""
        head = self._heads[name]
        B, own = head.sensitivity(stamp_ns), own_coefficients(head)
        return B @ self.coefficients[own], B @ self.covariance[own, own] @ B.T

    def at(self, name: str, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return q_body_from_sensor (4,) at a time, bent as learnt, and its covariance (3, 3)."""
        offset, covariance = self.misalignment(name, stamp_ns)
        mount = self._heads[name].mount.quaternion
        return multiply(quaternion_from_rotation_vector(offset), mount), covariance

    def implausible(self, stamp_ns: int) -> list[Head]:
        """Return the heads whose mounts have left what their files allow."""
        return [head for head in self._heads.values() if not head.is_plausible(
            self.coefficients[own_coefficients(head)], stamp_ns)]


def own_coefficients(head: Head) -> slice:
    """Return the slice of a head in the coefficients (M,) of all."""
    return slice(head.columns.start - BODY, head.columns.stop - BODY)


def reopened(state: FusedState, head: Head, step: MountStep) -> FusedState:
    """Return a state that does not know the mount that has made a step."""
    # Before the coefficients the error state of a motion has the acceleration as well.
    first, P = head.columns.start + 3, state.motion.covariance.copy()
    own = np.arange(first, first + 3)
    P[:, own, own] += float(step.size_rad @ step.size_rad)
    return FusedState.of(state.motion._replace(covariance=P))
