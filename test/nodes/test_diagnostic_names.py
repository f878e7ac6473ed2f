# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Names of the diagnostics of several star trackers; test_lifecycle.py has those of all nodes."""


def test_names_of_several_trackers_differ_with_use_fqn(nodes, probe):
    for namespace, parameters in (('one', {'diagnostic_updater.use_fqn': True}), ('two', {})):
        nodes.start('target_locator', parameters, namespace=namespace)
    probe.wait(lambda: {(s.name, s.hardware_id) for s in probe.statuses()} == {
        ('/one/target_locator: location', 'one'), ('target_locator: location', 'two')},
        'both names')
