# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demo of the closed loop over the nodes, its first frames."""

import numpy as np
import pytest
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.io.bags.reader import decode, read_messages

FRAMES = 100


@pytest.fixture(scope='module')
def demo(basilisk, tmp_path_factory):
    from startracker_evaluation.gnc.loop import ClosedLoop
    from startracker_evaluation.gnc.navigation import Navigation
    from startracker_evaluation.gnc.plan import Plan, PlanOptions
    from startracker_evaluation.gnc.spacecraft import Spacecraft, SpacecraftOptions
    from startracker_evaluation.harness.closed_loop_demo import ClosedLoopDemo
    from startracker_ros.core.maths.rotation import random_attitude
    from startracker_ros.ros.processes import set_environment
    set_environment(isolated=True)
    options, plan = SpacecraftOptions(), Plan(PlanOptions(acquire_s=5.0))
    spacecraft = Spacecraft(random_attitude(np.random.default_rng(1)),
                            np.radians([1.5, -1.0, 0.5]), options)
    with ClosedLoopDemo(tmp_path_factory.mktemp('demo')) as demo:
        demo.start(1)
        demo.run(ClosedLoop(spacecraft, demo, Navigation(np.array(options.inertia_kg_m2)), plan),
                 FRAMES)
        demo.finish()
        demo.plan = plan
        yield demo


def test_the_nodes_stop_the_tumbling_and_begin_the_slew(demo):
    from startracker_evaluation.gnc.plan import Phase
    history = demo.history(demo.plan)
    assert history.steps[-1].phase is Phase.SLEW
    assert history.wrong == 0
    assert history.used[-10:].all()
    assert np.abs(history.knowledge_arcsec[history.within(Phase.ACQUIRE)][-1, :2]).max() < 10


def test_no_frame_is_lost_and_all_is_in_the_bag(demo):
    stamps_ns = {}
    for topic in ('/motion/odometry', '/truth/attitude', '/attitude_imu', '/control/torque'):
        stamps_ns[topic] = [ns_from_stamp(decode(record.type_name, record.data).header.stamp)
                            for record in read_messages(demo.bag, topics=[topic])]
    sent_ns = stamps_ns['/motion/odometry']
    assert len(sent_ns) == FRAMES
    assert (np.diff(sent_ns) == 200_000_000).all()
    assert all(topic_ns == sent_ns for topic_ns in stamps_ns.values())
