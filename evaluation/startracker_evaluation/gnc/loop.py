# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The loop: truth, star tracker, navigation, flight software, torques, in lock-step."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from startracker_evaluation.gnc.camera import FrameFault, LoopCamera, Observation, SOUND
from startracker_evaluation.gnc.navigation import Navigation, NavigationState
from startracker_evaluation.gnc.plan import Phase, Plan
from startracker_evaluation.gnc.spacecraft import CONTROL_NS, LATENCY_NS, Spacecraft, Truth
from startracker_ros.core.maths.rotation import (
    attitude_error, conjugate, matrix_from_quaternion, multiply, rotate)
from startracker_ros.sim.sky.motion_state import MotionState
from startracker_ros.sim.sky.sampled_motion import SampledMotion
from startracker_ros.tools.figures.correctness import NOT_WRONG, verdict, WrongCount

Q_BODY_FROM_SENSOR = np.array([0.5, 0.5, 0.5, 0.5])
"""The camera looks along x of the body, its image upright: sensor x, y, z are body y, z, x."""


@dataclass(frozen=True)
class Step:
    """
    One frame of the loop.

    pointing_rad (3,) is the rotation vector from the reference to the true attitude about sensor
    axes, x and y across the boresight, NaN while only the rate is controlled; knowledge_rad (3,)
    that from the truth to the navigation, NaN without one. hold_s is how long the attitude has
    been propagated. used: whether the controller used the measurement of the frame,
    wrong whether that was wrong and gross, zeros where not used.
    """

    time_ns: int
    phase: Phase
    tracker: str
    truth: Truth
    pointing_rad: np.ndarray
    knowledge_rad: np.ndarray
    hold_s: float
    used: bool
    wrong: WrongCount


class ClosedLoop:
    """
    Basilisk's spacecraft controlled by what a star tracker sees.

    fault_of returns what is wrong with a frame by its time in s, besides the Sun. torque_n_m
    (3,) is that of the wheels on the body, commanded before the newest frame.
    """

    def __init__(self, spacecraft: Spacecraft, camera: LoopCamera, navigation: Navigation,
                 plan: Plan, fault_of: Callable[[float], FrameFault] = lambda time_s: SOUND
                 ) -> None:
        self._spacecraft = spacecraft
        self._camera = camera
        self.navigation = navigation
        self.plan = plan
        self._fault_of = fault_of
        self._motion = SampledMotion()
        self._index = 0
        self.torque_n_m = np.zeros(3)

    def step(self) -> Step:
        """Go to the next frame: see, navigate, command."""
        spacecraft, navigation, plan = self._spacecraft, self.navigation, self.plan
        self._index += 1
        time_ns = self._index * CONTROL_NS
        truth = spacecraft.step_to(time_ns)
        self._motion.add(time_ns * 1e-9, sensor_state(truth))
        # The last command came into effect LATENCY_NS after the last frame.
        before_n_m, self.torque_n_m = self.torque_n_m, spacecraft.body_torque_n_m()
        momentum = spacecraft.wheel_momentum_n_m_s()
        navigation.propagate(time_ns - CONTROL_NS + LATENCY_NS, before_n_m, momentum)
        navigation.propagate(time_ns, self.torque_n_m, momentum)
        fault = self._fault_of(time_ns * 1e-9)
        if plan.phase is Phase.BLINDED:
            fault = FrameFault(True, fault.dropped, fault.torn, fault.offset_s)
        seen = Observation('no frame') if fault.dropped else self._camera.observe(
            time_ns, self._motion, fault)
        used, wrong = self._use(time_ns, seen, truth)
        state = navigation.state
        if (plan.update(time_ns * 1e-9, spacecraft.gyro_rad_s(), state)
                and plan.phase is Phase.SLEW):
            # From here on the attitude is controlled. Later the integral is that of the friction
            # of the wheels: without it the boresight would leave its reference.
            spacecraft.reset_integral()
        self._command(time_ns, state, momentum)
        return self._record(time_ns, truth, seen, state, used, wrong)

    def _use(self, time_ns: int, seen: Observation, truth: Truth) -> tuple[bool, WrongCount]:
        """Correct the navigation by a trusted attitude; return whether, and how wrong it is."""
        if seen.quaternion is None or seen.covariance is None:
            return False, NOT_WRONG
        body, matrix = body_attitude(seen.quaternion), _MATRIX
        covariance = matrix @ seen.covariance @ matrix.T
        rate = (self._spacecraft.gyro_rad_s() if seen.rate_rad_s is None
                else matrix @ seen.rate_rad_s)
        used = self.navigation.correct(time_ns, body, covariance, rate)
        if used is None:
            return False, NOT_WRONG
        return True, verdict(body, used, truth.q_icrf_from_body)

    def _command(self, time_ns: int, state: NavigationState | None, momentum: np.ndarray) -> None:
        """Write attitude and rate of when the controller runs, and the reference."""
        spacecraft, at_ns = self._spacecraft, time_ns + LATENCY_NS
        if state is None:
            # Without an attitude only the rate is damped: the reference is the attitude.
            rest = np.array([0.0, 0.0, 0.0, 1.0])
            spacecraft.command(at_ns, rest, spacecraft.gyro_rad_s(),
                               Plan().reference(at_ns * 1e-9, rest))
            return
        ahead = self.navigation.predicted(at_ns, self.torque_n_m, momentum)
        spacecraft.command(at_ns, ahead.q_icrf_from_body, ahead.rate_rad_s,
                           self.plan.reference(at_ns * 1e-9, ahead.q_icrf_from_body))

    def _record(self, time_ns: int, truth: Truth, seen: Observation,
                state: NavigationState | None, used: bool, wrong: WrongCount) -> Step:
        pointing = knowledge = np.full(3, np.nan)
        if not self.plan.damps_rate:
            reference = self.plan.reference(time_ns * 1e-9, truth.q_icrf_from_body)
            pointing = _MATRIX.T @ attitude_error(truth.q_icrf_from_body, reference.quaternion)
        if state is not None:
            knowledge = _MATRIX.T @ attitude_error(state.q_icrf_from_body, truth.q_icrf_from_body)
        return Step(time_ns, self.plan.phase, seen.state, truth, pointing, knowledge,
                    self.navigation.hold_s(time_ns), used, wrong)


_MATRIX = matrix_from_quaternion(Q_BODY_FROM_SENSOR)


def body_attitude(q_icrf_from_sensor: np.ndarray) -> np.ndarray:
    """Return q_icrf_from_body (4,) of an attitude of the sensor."""
    return multiply(q_icrf_from_sensor, conjugate(Q_BODY_FROM_SENSOR))


def sensor_state(truth: Truth) -> MotionState:
    """Return the motion of the sensor of a spacecraft."""
    return MotionState(multiply(truth.q_icrf_from_body, Q_BODY_FROM_SENSOR),
                       rotate(conjugate(Q_BODY_FROM_SENSOR), truth.rate_rad_s),
                       truth.position_m, truth.velocity_m_s)
