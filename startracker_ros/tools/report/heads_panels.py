"""The figures of several heads: which of them count, and their mounts."""

from typing import Any

import numpy as np
from startracker_ros.tools.report.heads import HeadsRecording
from startracker_ros.tools.report.panels import Panel, Panels


def head_states(panels: Panels, heads: HeadsRecording) -> list[dict[str, Any]]:
    """Return name and intervals of the conditions of each head."""
    return [{'name': name, 'states': panels.intervals(heads.changed_ns, conditions)}
            for name, conditions in heads.conditions.items()]


def mount_panels(panels: Panels, heads: HeadsRecording) -> list[Panel]:
    """
    Return panels of each learnt mount about body x, y, z, with 3 sigma.

    Drawn is the error where the bag has the truth of body and head, elsewhere the change since the
    first mount, between its 3 sigma bounds.
    """
    found = []
    for number, (name, series) in enumerate(heads.mounts.items()):
        error, three = series.error_arcsec(), 3 * series.sigma_arcsec()
        known, change = np.isfinite(error).any(), series.change_arcsec()
        for axis, letter in enumerate('xyz'):
            curves = ([('3 sigma', 'band', three), ('error', 'dots', error)] if known else
                      [('change', 'line', change), ('+3 sigma', 'line', change + three),
                       ('\u22123 sigma', 'line', change - three)])
            found.append({
                'id': f'mount-{number}-{letter}', 'title': f'mount of {name}, body {letter}',
                'unit': 'arcsec', 'series': [panels.series(
                    label, kind, series.stamp_ns, values[:, axis], 4)
                    for label, kind, values in curves]})
    return found
