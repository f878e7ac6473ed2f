# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names and events of diagnostics; test_lifecycle.py has the names of all nodes."""

import rclpy
from startracker_ros.ros.diagnostics import Diagnostics, OK


def test_names_of_several_trackers_differ_with_use_fqn(nodes, probe):
    for namespace, parameters in (('one', {'diagnostic_updater.use_fqn': True}), ('two', {})):
        nodes.start('target_locator', parameters, namespace=namespace)
    probe.wait(lambda: {(s.name, s.hardware_id) for s in probe.statuses()} == {
        ('/one/target_locator: location', 'one'), ('target_locator: location', 'two')},
        'both names')


def test_many_events_of_one_kind_do_not_push_out_another(probe):
    node = rclpy.create_node('starved', context=probe.context)
    diagnostics = Diagnostics(node, 'work', 'star_tracker')
    diagnostics.report(OK, 'works')
    diagnostics.report_event('busy or stopped for 0.6 s')
    for k in range(20):
        diagnostics.report_event(f'/tracks: time went ahead by 0.{k} s')
    diagnostics.publish()
    message = probe.wait_diagnostic('busy or stopped for 0.6 s').message
    # As many as fit, the newest.
    assert message.count('ahead') == 4 and message.endswith('ahead by 0.19 s')
    node.destroy_node()
