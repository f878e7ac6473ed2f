# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Methods of published papers, which register themselves by name."""

from startracker_ros.core.registry import Method, METHODS, Model, MODELS

METHODS['quad'] = Method(f'{__name__}.quad:QuadIdentifier')
METHODS['hausdorff_pivot'] = Method(f'{__name__}.hausdorff:PivotIdentifier', in_a_plane=True)
METHODS['hausdorff_segment'] = Method(f'{__name__}.hausdorff:SegmentIdentifier', in_a_plane=True)
METHODS['extended_grid'] = Method(
    f'{__name__}.extended_grid:ExtendedGridIdentifier', in_a_plane=True)

_FILTER_OF_EACH_STAR = Model(
    options=('solver', 'association', 'sna_confirmation', 'roll_by_gyro'))
MODELS['constant_velocity'] = MODELS['coordinated_turn'] = _FILTER_OF_EACH_STAR
MODELS['sna'] = Model(
    options=('solver',),
    ignored=('acceleration_deg_s2', 'roll_acceleration_deg_s2', 'detection_probability',
             'gate_probability'))
