# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Presets: values for many options of the simulator at once."""

from dataclasses import replace
from typing import TypeVar

from startracker_ros.core.options import Options

AnyOptions = TypeVar('AnyOptions', bound=Options)

PRESETS: dict[str, dict[str, object]] = {
    'none': {},
    # A bad day in low orbit: worn sensor, bright limb near the field, solar protons.
    'harsh': {
        'motion_smear': True, 'line_time_us': 10.0, 'psf_corner_sigma_px': 1.2,
        'coma_corner_px': 2.0, 'astigmatism_corner_px': 0.5, 'vignetting_percent': 25.0,
        'dark_current_e_s': 100.0, 'hot_pixel_fraction': 5e-4, 'flat_field_percent': 1.0,
        'row_noise_dn': 0.7, 'column_pattern_dn': 0.7, 'blooming': True,
        'stray_light_e': 500.0, 'cosmic_ray_hits_cm2_s': 1000.0, 'trails': 1,
        'star_like_spots': 5, 'ghost_ratio': 0.003, 'saturated_columns': 1, 'warm_columns': 4,
        'dead_columns': 2, 'dead_rows': 1, 'torn_frame_probability': 0.01,
        'repeated_frame_probability': 0.01},
}


def with_preset(options: AnyOptions, preset: str) -> AnyOptions:
    """Return options with the values of a preset in place of those that are at their default."""
    values = PRESETS[preset]
    return replace(options, **{
        row.name: values[row.name] for row in options.table()
        if row.name in values and getattr(options, row.name) == row.default})
