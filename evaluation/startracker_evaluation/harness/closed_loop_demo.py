# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demo of the closed loop: Basilisk's spacecraft controlled by what the nodes see."""

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import QuaternionStamped, Vector3Stamped
from nav_msgs.msg import Odometry
import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rich.table import Table
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from startracker_evaluation.gnc.camera import (
    FrameFault, Observation, START_NS, SUN_FALLOFF_DEG, SUN_LIGHT_E)
from startracker_evaluation.gnc.history import draw, History, rows_of
from startracker_evaluation.gnc.loop import ClosedLoop, Step
from startracker_evaluation.gnc.navigation import Navigation
from startracker_evaluation.gnc.plan import Plan
from startracker_evaluation.gnc.spacecraft import CONTROL_NS, tumbling
from startracker_ros.core.maths.rotation import ARCSEC
from startracker_ros.io.bags.layouts import INERTIAL_FRAME_ID, ns_from_stamp, SENSOR_FRAME_ID
from startracker_ros.io.table import Result
from startracker_ros.ros import qos
from startracker_ros.ros.executables import STAGES
from startracker_ros.ros.messages.attitude import quaternion_to_message, tracked_attitude_from_imu
from startracker_ros.ros.messages.header import make_header, stamp_from_ns, vector_to_geometry
from startracker_ros.ros.messages.odometry import motion_to_odometry
from startracker_ros.ros.processes import HarnessError
from startracker_ros.sim.sky.sampled_motion import SampledMotion
from startracker_ros.tools.demos.live_demo import draw_if_possible, LockStepDemo, STALL_S
from startracker_ros.tools.demos.readiness import needs_of
from startracker_ros.tools.figures.machine import machine
from startracker_ros.tools.figures.rows import DemoRow

_RATE_HZ = 1e9 / CONTROL_NS
_PARAMETERS = {
    'use_sim_time': True, 'frame_rate_hz': _RATE_HZ, 'width': 1024, 'height': 1024,
    'fov_deg': 12.0, 'bit_depth': 12, 'motion': 'topic', 'lock_step': True,
    'motion_smear': True,
    # image_raw: the extractor. camera_info: the four stages, the recorder and, once all nodes are
    # ready, the demo.
    'wait_for_subscribers': 1, 'wait_for_camera_users': 6}
_NODES = ('sky_simulator', *STAGES)


class ClosedLoopDemo(LockStepDemo):
    """The nodes in one process, and the bridge: truth to them, attitudes to the loop."""

    endpoints = {'attitude_imu': (1, 2), 'tracker_state': (1, 2), '/clock': (1, 2),
                 'truth/attitude': (1, 1)}
    needs = needs_of(('bag_recorder', *_NODES))

    def __init__(self, output: Path) -> None:
        super().__init__(output)
        self._state = 'starting'
        self._steps: list[Step] = []
        self._answer: tuple[int, Observation] = 0, Observation(self._state)
        self._blinded = False
        probe = self.probe
        self._clock = probe.create_publisher(Clock, '/clock', qos.LIST)
        self._motion = probe.create_publisher(Odometry, 'motion/odometry', qos.LIST)
        self._reference = probe.create_publisher(
            QuaternionStamped, 'control/reference', qos.LIST)
        self._torque = probe.create_publisher(Vector3Stamped, 'control/torque', qos.LIST)
        probe.create_subscription(DiagnosticStatus, 'tracker_state', self._on_state, qos.STATE)
        probe.create_subscription(Imu, 'attitude_imu', self._on_attitude, qos.LIST)

    def start(self, seed: int) -> None:
        """Start all nodes."""
        self.processes.start('bag_recorder', {
            'folder': str(self.bag), 'exclude': [
                '*/image_raw', '*/image_annotated', '*/transition_event', '/imu', '/truth/stars']})
        self.processes.start('composed_pipeline', {**_PARAMETERS, 'seed': seed},
                             ('--', *_NODES))

    @property
    def frames(self) -> int:
        """Frames that were simulated."""
        return len(self._steps)

    def run(self, loop: ClosedLoop, frames: int = 0) -> float:
        """Step the loop to the end of its plan or for some frames; return the wall time in s."""
        self._connect()

        def step() -> None:
            self._steps.append(loop.step())
            self._publish_control(loop, self._steps[-1])
        return self.run_steps(step, lambda: loop.plan.finished or bool(
            frames and len(self._steps) >= frames), frames)

    def history(self, plan: Plan) -> History:
        """Return what the loop went through."""
        return History(self._steps, plan)

    def observe(self, time_ns: int, motion: SampledMotion, fault: FrameFault) -> Observation:
        """Publish clock and truth of a frame, and return what the nodes answer to it."""
        self._blind(fault.blinded)
        stamp_ns, state = START_NS + time_ns, motion.at(time_ns * 1e-9)
        self._clock.publish(Clock(clock=stamp_from_ns(stamp_ns)))
        self._motion.publish(motion_to_odometry(
            state.position_m, state.velocity_m_s, state.q_icrf_from_sensor, state.rate_rad_s,
            make_header(stamp_ns, INERTIAL_FRAME_ID), SENSOR_FRAME_ID))
        self.await_attitudes(lambda: '' if self._answer[0] == stamp_ns else (
            f'the frame at {time_ns * 1e-9:.1f} s'))
        return self._answer[1]

    def table(self, frames: int) -> Table:
        """Return the newest step."""
        table = Table(title='closed loop demo', title_justify='left', min_width=78)
        for name in ('time s', 'phase', 'tracker', 'pointing arcsec', 'torque mN m', 'hold s'):
            table.add_column(name, justify='right')
        if not self._steps:
            table.add_row('-', '-', self._state, '-', '-', '-')
            return table
        step = self._steps[-1]
        pointing = np.hypot(*step.pointing_rad[:2]) / ARCSEC
        table.add_row(
            f'{step.time_ns * 1e-9:.1f}', str(step.phase), step.tracker, f'{pointing:.2f}',
            f'{1e3 * np.abs(step.truth.torque_n_m).max():.2f}', f'{step.hold_s:.1f}')
        return table

    def _connect(self) -> None:
        """Wait until all nodes are ready, then let the simulator subscribe to the motion."""
        # The nodes learn the epoch of the sky with the camera.
        self.await_ready(lambda: self._clock.publish(Clock(clock=stamp_from_ns(START_NS))))
        # The simulator and the recorder.
        self.probe.wait(lambda: self._motion.get_subscription_count() >= 2,
                        'subscribers of motion/odometry', STALL_S)
        self.probe.spin_for(0.5)

    def _blind(self, blinded: bool) -> None:
        """Let the Sun into the images, or out of them."""
        if blinded == self._blinded:
            return
        self._blinded = blinded
        values = {'stray_light_e': SUN_LIGHT_E if blinded else 0.0,
                  'stray_light_falloff_deg': SUN_FALLOFF_DEG}
        request = SetParameters.Request(parameters=[
            Parameter(name, value=value).to_parameter_msg() for name, value in values.items()])
        results = self.probe.call(
            SetParameters, 'sky_simulator/set_parameters', request).results
        if not all(result.successful for result in results):
            raise HarnessError(f'sky_simulator: {"; ".join(r.reason for r in results)}')

    def _publish_control(self, loop: ClosedLoop, step: Step) -> None:
        """Publish what the controller follows and exerts, for the bag."""
        header = make_header(START_NS + step.time_ns, INERTIAL_FRAME_ID)
        self._torque.publish(Vector3Stamped(
            header=make_header(START_NS + step.time_ns, 'body'),
            vector=vector_to_geometry(loop.torque_n_m)))
        if not loop.plan.damps_rate:
            reference = loop.plan.reference(step.time_ns * 1e-9, step.truth.q_icrf_from_body)
            self._reference.publish(quaternion_to_message(reference.quaternion, header))

    def _on_state(self, message: DiagnosticStatus) -> None:
        self._state = message.message

    def _on_attitude(self, message: Imu) -> None:
        tracked = tracked_attitude_from_imu(message)
        seen = Observation(self._state) if tracked is None else Observation(
            self._state, tracked.attitude.quaternion, tracked.attitude.covariance_sensor,
            tracked.rate_rad_s if message.angular_velocity_covariance[0] >= 0 else None)
        self._answer = ns_from_stamp(message.header.stamp), seen


def _write_report(bag: Path, page: Path) -> None:
    from startracker_ros.tools.report.page import write_report
    write_report(bag, page)


def run_closed_loop_demo(output: Path, *, seed: int) -> Result:
    """Run the loop over the nodes; HarnessError when a node fails."""
    spacecraft = tumbling(np.random.default_rng(seed), seed=seed)
    with ClosedLoopDemo(output) as demo:
        demo.start(seed)
        plan = Plan()
        wall_s = demo.run(ClosedLoop(
            spacecraft, demo, Navigation(np.array(spacecraft.options.inertia_kg_m2)), plan))
        demo.finish()
    history = demo.history(plan)
    pace = float(history.time_s[-1] / wall_s)
    rows = [*map(DemoRow.of, rows_of(history)),
            DemoRow.with_goal('pace, simulated time over wall time', pace, '', 1.0, least=True),
            DemoRow('processor time of all processes, starts included', float(
                demo.cpu_s / history.time_s[-1]), 's each simulated s')]
    picture, page = output / 'closed_loop.png', output / 'report.html'
    drawn = draw_if_possible(picture, lambda: draw(picture, history, 'closed loop, five nodes'))
    written = draw_if_possible(page, lambda: _write_report(demo.bag, page))
    return Result('demo closed-loop', rows, {
        'spacecraft': 'Basilisk: 700 km, rigid body of 10 kg m^2, four reaction wheels of 0.1 N m '
                      'with friction, gravity gradient, gyro',
        'flight software': 'attTrackingError, mrpFeedback, rwMotorTorque, rwNullSpace at 5 Hz, '
                           '0.1 s after each exposure; gyro in detumbling only',
        'sky': '1024 x 1024 px, 12 deg, 5 Hz in lock-step, smeared images, five nodes in one '
               'process',
        'machine': machine(str(demo.load)),
        'bag': demo.bag_text(), 'picture': drawn, 'report': written})
