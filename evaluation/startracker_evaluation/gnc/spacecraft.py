# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A spacecraft of Basilisk: orbit, rigid body, four reaction wheels, gyro and flight software."""

from dataclasses import dataclass

import numpy as np
from startracker_evaluation.gnc.basilisk_messages import (
    import_basilisk, mrp_from_quaternion, navigation_payload, quaternion_from_mrp)
from startracker_evaluation.gnc.guidance import Reference
from startracker_ros.core.astro.constants import EARTH_MU_M3_S2, EARTH_RADIUS_M
from startracker_ros.core.astro.orbit import CircularOrbit
from startracker_ros.core.maths.rotation import random_attitude

_NULL_SIGNS = (1, -1, 1, -1)
"""Turns of the wheels whose momenta cancel."""

_NULL_GAIN = 1e-4
"""Torque in N m for each rad/s that a wheel is away from its speed, without effect on the body."""

_FIRST = 100
"""Priority in a task of Basilisk; a higher one is executed earlier, -1 is the default."""

STEP_NS = 100_000_000
"""Step of the integration (Runge-Kutta 4) and of gyro measurements."""

TUMBLE_DEG_S = 3.0
CONTROL_NS = 200_000_000
LATENCY_NS = 100_000_000
"""The controller runs at 5 Hz, so long after the middle of each exposure."""


@dataclass(frozen=True)
class SpacecraftOptions:
    """
    A satellite of 100 kg in low orbit.

    inertia_kg_m2 is the diagonal that the flight software knows, inertia_error the relative error
    of it: the body has inertia_kg_m2 (1 + inertia_error). The wheels are a pyramid of four that
    store no momentum together but turn at wheel_rpm, so that none stands still; coulomb_n_m (4,)
    and viscous_n_m_s are their friction. The gains are those of mrpFeedback: with K, P and
    inertia J the frequency is sqrt(K / 4 J) and the damping P / sqrt(K J). gyro_bias_rad_s (3,)
    and gyro_sigma_rad_s of each measurement are on body axes.
    """

    inertia_kg_m2: tuple[float, float, float] = (11.0, 9.0, 10.0)
    inertia_error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    wheel_max_torque_n_m: float = 0.1
    wheel_momentum_n_m_s: float = 4.0
    wheel_max_rpm: float = 6000.0
    wheel_rpm: float = 2000.0
    coulomb_n_m: tuple[float, float, float, float] = (0.0005, 0.0005, 0.0005, 0.0005)
    viscous_n_m_s: float = 0.0
    K: float = 10.0
    P: float = 9.0
    Ki: float = 0.02
    integral_limit: float = 0.02
    gyro_bias_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_sigma_rad_s: float = 2e-4
    orbit: CircularOrbit = CircularOrbit(EARTH_RADIUS_M + 700e3, 0.5, 0.7, 0.0)


@dataclass(frozen=True)
class Truth:
    """
    What Basilisk integrated.

    q_icrf_from_body (4,), rate_rad_s (3,) on body axes, position_m and velocity_m_s (3,) on ICRF
    axes; wheel_rad_s (4,) of the wheels and torque_n_m (4,) of their motors.
    """

    time_ns: int
    q_icrf_from_body: np.ndarray
    rate_rad_s: np.ndarray
    position_m: np.ndarray
    velocity_m_s: np.ndarray
    wheel_rad_s: np.ndarray
    torque_n_m: np.ndarray


def tumbling(rng: np.random.Generator, options: SpacecraftOptions = SpacecraftOptions(), *,
             seed: int) -> 'Spacecraft':
    """Return a spacecraft that turns at TUMBLE_DEG_S about any axis, from any attitude."""
    axis = rng.standard_normal(3)
    return Spacecraft(random_attitude(rng),
                      np.radians(TUMBLE_DEG_S) * axis / np.linalg.norm(axis), options, seed=seed)


class Spacecraft:
    """
    Steps Basilisk from one exposure to the next.

    The flight software is attTrackingError, mrpFeedback, rwMotorTorque and rwNullSpace. It reads
    what command() wrote last, LATENCY_NS after each exposure.
    """

    def __init__(self, q_icrf_from_body: np.ndarray, rate_rad_s: np.ndarray,
                 options: SpacecraftOptions = SpacecraftOptions(), *, seed: int = 0) -> None:
        """Begin at time 0 with an attitude (4,) and a rate (3,) on body axes."""
        import_basilisk()
        from Basilisk.utilities.SimulationBaseClass import SimBaseClass
        self.options = options
        self._simulation = SimBaseClass()
        process = self._simulation.CreateNewProcess('spacecraft')
        process.addTask(self._simulation.CreateNewTask('dynamics', STEP_NS))
        # Its modules are executed by step_to(): a task runs at multiples of its period only.
        process.addTask(self._simulation.CreateNewTask('control', CONTROL_NS))
        self._add_dynamics(q_icrf_from_body, rate_rad_s)
        self._add_wheels()
        self._add_gyro(seed)
        self._add_control()
        self.time_ns = 0
        self.command(0, q_icrf_from_body, rate_rad_s, Reference.fixed(q_icrf_from_body))
        self._simulation.InitializeSimulation()
        self._simulation.disableTask('control')

    def step_to(self, time_ns: int) -> Truth:
        """Integrate up to the next multiple of CONTROL_NS, and return the state there."""
        control_ns = self.time_ns + LATENCY_NS
        self._integrate_to(control_ns)
        for module in self._software:
            module.UpdateState(control_ns)
        self._integrate_to(time_ns)
        state = self._body.scStateOutMsg.read()
        return Truth(
            time_ns, quaternion_from_mrp(np.array(state.sigma_BN)), np.array(state.omega_BN_B),
            np.array(state.r_BN_N), np.array(state.v_BN_N),
            self._wheel_rad_s(), self._motor_torque_n_m())

    def _integrate_to(self, time_ns: int) -> None:
        self._simulation.ConfigureStopTime(time_ns)
        self._simulation.ExecuteSimulation()
        self.time_ns = time_ns

    def gyro_rad_s(self) -> np.ndarray:
        """Return the rate (3,) that the gyro measured last, on body axes."""
        return np.array(self._gyro.sensorOutMsg.read().AngVelPlatform)

    def body_torque_n_m(self) -> np.ndarray:
        """Return the torque (3,) that the motors exert on the body."""
        return -self._axes @ self._motor_torque_n_m()

    def _motor_torque_n_m(self) -> np.ndarray:
        """Return the torque (4,) that is commanded to the motors, within their limits."""
        command = self._null_space.rwMotorTorqueOutMsg.read().motorTorque[:self._axes.shape[1]]
        limit = self.options.wheel_max_torque_n_m
        return np.clip(command, -limit, limit)

    def wheel_momentum_n_m_s(self) -> np.ndarray:
        """Return the momentum (3,) of the wheels on body axes, of their tachometers."""
        return self._axes @ (self._wheel_inertia * self._wheel_rad_s())

    def _wheel_rad_s(self) -> np.ndarray:
        speeds = self._wheel_effector.rwSpeedOutMsg.read().wheelSpeeds
        return np.array(speeds[:self._axes.shape[1]])

    def command(self, time_ns: int, q_icrf_from_body: np.ndarray, rate_rad_s: np.ndarray,
                reference: Reference) -> None:
        """Write the NavAtt message of a time and the reference of the same time."""
        from Basilisk.architecture import messaging
        payload = messaging.AttRefMsgPayload()
        payload.sigma_RN = mrp_from_quaternion(reference.quaternion).tolist()
        payload.omega_RN_N = reference.rate_icrf_rad_s.tolist()
        payload.domega_RN_N = reference.acceleration_icrf_rad_s2.tolist()
        self._reference.write(payload, self.time_ns)
        self._navigation.write(navigation_payload(time_ns, q_icrf_from_body, rate_rad_s),
                               self.time_ns)

    def reset_integral(self) -> None:
        """Forget the integral of the attitude error, as at a change of mode."""
        self._feedback.Reset(self.time_ns)

    def _add_dynamics(self, q: np.ndarray, rate_rad_s: np.ndarray) -> None:
        from Basilisk.simulation import gravityEffector, GravityGradientEffector, spacecraft
        body = self._body = spacecraft.Spacecraft()
        body.ModelTag = 'satellite'
        body.hub.mHub = 100.0
        body.hub.r_BcB_B = [[0.0], [0.0], [0.0]]
        body.hub.IHubPntBc_B = np.diag(np.multiply(
            self.options.inertia_kg_m2, np.add(1.0, self.options.inertia_error))).tolist()
        position_m, velocity_m_s = self.options.orbit.at(0.0)
        body.hub.r_CN_NInit = _column(position_m)
        body.hub.v_CN_NInit = _column(velocity_m_s)
        body.hub.sigma_BNInit = _column(mrp_from_quaternion(q))
        body.hub.omega_BN_BInit = _column(rate_rad_s)
        earth = self._earth = gravityEffector.GravBodyData()
        earth.planetName = 'earth_planet_data'
        earth.displayName = 'earth'
        earth.mu = EARTH_MU_M3_S2
        earth.radEquator = EARTH_RADIUS_M
        earth.isCentralBody = True
        body.gravField.setGravBodies(spacecraft.GravBodyVector([earth]))
        gradient = self._gradient = GravityGradientEffector.GravityGradientEffector()
        gradient.addPlanetName(earth.planetName)
        body.addDynamicEffector(gradient)
        self._simulation.AddModelToTask('dynamics', body)
        self._simulation.AddModelToTask('dynamics', gradient)

    def _add_wheels(self) -> None:
        from Basilisk.simulation import reactionWheelStateEffector
        from Basilisk.utilities.simIncludeRW import rwFactory
        options = self.options
        self._wheels, self._wheel_effector = (
            rwFactory(), reactionWheelStateEffector.ReactionWheelStateEffector())
        spin = np.array([[1, 1, 1], [-1, 1, 1], [-1, -1, 1], [1, -1, 1]]) / np.sqrt(3)
        self._axes = spin.T
        inertia = options.wheel_momentum_n_m_s / (options.wheel_max_rpm * np.pi / 30)
        self._wheel_inertia = inertia
        for axis, sign, coulomb_n_m in zip(spin, _NULL_SIGNS, options.coulomb_n_m):
            self._wheels.create(
                'custom', axis, Js=inertia, Omega_max=options.wheel_max_rpm,
                Omega=float(sign * options.wheel_rpm), u_max=options.wheel_max_torque_n_m,
                useRWfriction=True, fCoulomb=coulomb_n_m,
                cViscous=options.viscous_n_m_s)
        self._wheels.addToSpacecraft('wheels', self._wheel_effector, self._body)
        # Before the body: it reads the command that the body is integrated with.
        self._simulation.AddModelToTask('dynamics', self._wheel_effector, _FIRST)

    def _add_gyro(self, seed: int) -> None:
        from Basilisk.simulation import imuSensor
        gyro = self._gyro = imuSensor.ImuSensor()
        gyro.scStateInMsg.subscribeTo(self._body.scStateOutMsg)
        gyro.senRotBias = list(self.options.gyro_bias_rad_s)
        gyro.PMatrixGyro = (np.eye(3) * self.options.gyro_sigma_rad_s).tolist()
        gyro.RNGSeed = seed + 1
        self._simulation.AddModelToTask('dynamics', gyro)

    def _add_control(self) -> None:
        from Basilisk.architecture import messaging
        from Basilisk.fswAlgorithms import (
            attTrackingError, mrpFeedback, rwMotorTorque, rwNullSpace)
        options = self.options
        self._navigation, self._reference = messaging.NavAttMsg(), messaging.AttRefMsg()
        error = self._error = attTrackingError.attTrackingError()
        error.attNavInMsg.subscribeTo(self._navigation)
        error.attRefInMsg.subscribeTo(self._reference)
        vehicle = messaging.VehicleConfigMsgPayload()
        vehicle.ISCPntB_B = np.diag(options.inertia_kg_m2).ravel().tolist()
        self._vehicle = messaging.VehicleConfigMsg().write(vehicle)
        self._wheel_config = self._wheels.getConfigMessage()
        feedback = self._feedback = mrpFeedback.mrpFeedback()
        feedback.K, feedback.P, feedback.Ki = options.K, options.P, options.Ki
        feedback.integralLimit = options.integral_limit
        feedback.guidInMsg.subscribeTo(error.attGuidOutMsg)
        feedback.vehConfigInMsg.subscribeTo(self._vehicle)
        feedback.rwParamsInMsg.subscribeTo(self._wheel_config)
        feedback.rwSpeedsInMsg.subscribeTo(self._wheel_effector.rwSpeedOutMsg)
        motors = self._motors = rwMotorTorque.rwMotorTorque()
        motors.controlAxes_B = np.eye(3).ravel().tolist()
        motors.vehControlInMsg.subscribeTo(feedback.cmdTorqueOutMsg)
        motors.rwParamsInMsg.subscribeTo(self._wheel_config)
        null_space = self._null_space = rwNullSpace.rwNullSpace()
        null_space.OmegaGain = _NULL_GAIN
        constellation = messaging.RWConstellationMsgPayload()
        constellation.numRW = self._axes.shape[1]
        elements = []
        for axis in self._axes.T:
            element = messaging.RWConfigElementMsgPayload()
            element.gsHat_B = axis.tolist()
            element.Js = self._wheel_inertia
            element.uMax = self.options.wheel_max_torque_n_m
            elements.append(element)
        constellation.reactionWheels = elements
        self._constellation = messaging.RWConstellationMsg().write(constellation)
        speeds = messaging.RWSpeedMsgPayload()
        speeds.wheelSpeeds = [wheel.Omega for wheel in self._wheels.rwList.values()]
        self._wanted_speeds = messaging.RWSpeedMsg().write(speeds)
        null_space.rwMotorTorqueInMsg.subscribeTo(motors.rwMotorTorqueOutMsg)
        null_space.rwSpeedsInMsg.subscribeTo(self._wheel_effector.rwSpeedOutMsg)
        null_space.rwDesiredSpeedsInMsg.subscribeTo(self._wanted_speeds)
        null_space.rwConfigInMsg.subscribeTo(self._constellation)
        self._wheel_effector.rwMotorCmdInMsg.subscribeTo(null_space.rwMotorTorqueOutMsg)
        self._software = error, feedback, motors, null_space
        for module in self._software:
            self._simulation.AddModelToTask('control', module)


def _column(vector: np.ndarray) -> list[list[float]]:
    return [[float(value)] for value in vector]
