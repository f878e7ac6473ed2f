# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Messier, NGC and IC objects in an image.

They are those of OpenNGC (https://github.com/mattiaverga/OpenNGC, CC-BY-SA-4.0), which the
library PyOngc holds. Its licence is not that of this package, which therefore has no copy.
"""

from collections.abc import Iterator
import re
from typing import Any, NamedTuple

import numpy as np
from startracker_ros.core.extras import extra
from startracker_ros.core.maths.rotation import ARCSEC, radec_from_unit, unit_from_radec
from startracker_ros.core.stages.sky_mapping import SkyMapping

# A smaller one would be a mark like that of a star. Messier's are named at any size, in the widest
# fields those that the eye sees.
_LEAST_OF_FIELD = 1 / 60
_WIDEST_DEG, _WIDEST_LIMIT = 60.0, 6.5
_MOST_NAMED = 40
_NOT_EXTENDED = ('Star', 'Double star', 'Nova star', 'Duplicated record', 'Nonexistent object',
                 'Object of other/unknown type')
_ARCMIN = 60 * ARCSEC
_OUTLINE_POINTS = 49


class DeepSkyObject(NamedTuple):
    """Designation, direction (3,), semi-axes in rad, position angle of the longer one in rad."""

    name: str
    direction: np.ndarray
    semi_axes_rad: tuple[float, float]
    angle_rad: float

    def outline(self) -> np.ndarray:
        """Return directions (N, 3) along its edge, an ellipse, from its end in the north on."""
        turn = np.linspace(0, 2 * np.pi, _OUTLINE_POINTS)[:, None]
        east = np.cross([0.0, 0.0, 1.0], self.direction)
        east /= max(float(np.linalg.norm(east)), 1e-12)
        north = np.cross(self.direction, east)
        sine, cosine = np.sin(self.angle_rad), np.cos(self.angle_rad)
        major, minor = self.semi_axes_rad
        edge = self.direction + (major * np.cos(turn) * (cosine * north + sine * east)
                                 + minor * np.sin(turn) * (cosine * east - sine * north))
        return edge / np.linalg.norm(edge, axis=1, keepdims=True)


def check_deep_sky() -> None:
    """MissingLibraryError without the library that holds the objects."""
    with extra('deep-sky', 'PyOngc', 'Naming deep-sky objects'):
        import pyongc.ongc  # noqa: F401


def deep_sky_in(sky: SkyMapping) -> list[DeepSkyObject]:
    """
    Return the objects in an image that are large enough for a name in it, at most 40.

    Messier's come first, then the largest. MissingLibraryError without PyOngc.
    """
    check_deep_sky()
    camera = sky.camera
    middle = np.array([[(camera.width - 1) / 2, (camera.height - 1) / 2]])
    field_rad = max(camera.width, camera.height) * camera.pixel_rad
    regions = [*_regions(sky.directions(middle)[0], sky.reach_rad)]
    least_arcmin = _LEAST_OF_FIELD * field_rad / _ARCMIN
    messier: dict[str, Any] = {'catalog': 'M'}
    if field_rad > np.radians(_WIDEST_DEG):
        messier['uptovmag'] = _WIDEST_LIMIT
    found = [dso for region in regions for limit in (messier, {'minsize': least_arcmin})
             for dso in _listed(**limit, **region)]
    by_name = {one.name: one for one in map(_object, found) if one is not None}
    objects = sorted(by_name.values(), key=lambda one: (
        not one.name.startswith('M'), -one.semi_axes_rad[0]))
    if not objects:
        return []
    inside = camera.contains(sky.pixels(np.array([one.direction for one in objects])))
    return [one for one, seen in zip(objects, inside) if seen][:_MOST_NAMED]


def _listed(**limits: Any) -> list[Any]:
    from pyongc.ongc import listObjects
    listed: list[Any] = listObjects(**limits)
    return listed


def _regions(direction: np.ndarray, reach_rad: float) -> Iterator[dict[str, float]]:
    """Yield limits in deg of right ascension and declination about a direction (3,)."""
    ra, dec = (float(angle) for angle in radec_from_unit(direction))
    declinations = {'mindec': np.degrees(dec - reach_rad), 'maxdec': np.degrees(dec + reach_rad)}
    if abs(dec) + reach_rad >= np.pi / 2:
        yield declinations
        return
    half = np.arcsin(min(np.sin(reach_rad) / np.cos(dec), 1.0))
    low, high = np.degrees([ra - half, ra + half])
    # The library has right ascensions of 0 to 360 deg.
    for turn in (-360, 0, 360):
        if low + turn < 360 and high + turn > 0:
            yield {'minra': low + turn, 'maxra': high + turn, **declinations}


def _object(dso: Any) -> DeepSkyObject | None:
    """Return an object of the library, None for one without a place or of no such kind."""
    name = _designation(dso)
    if not name or dso.rad_coords is None or (
            dso.type in _NOT_EXTENDED and not name.startswith('M')):
        return None
    major, minor, angle_deg = dso.dimensions
    major = major or 0.0
    minor = major if minor is None or angle_deg is None else minor
    return DeepSkyObject(name, unit_from_radec(*np.array(dso.rad_coords)),
                         (major * _ARCMIN / 2, minor * _ARCMIN / 2),
                         float(np.radians(angle_deg or 0)))


def _designation(dso: Any) -> str:
    """Return M 31, NGC 7000 or IC 434; empty for another catalogue and for parts of objects."""
    messier = dso.identifiers[0]
    if messier:
        return f'M {int(messier[1:])}'
    name = re.fullmatch(r'(NGC|IC)0*(\d+)', dso.name)
    return f'{name[1]} {name[2]}' if name else ''
