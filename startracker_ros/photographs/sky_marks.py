# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What an annotated picture has besides its spots: names, figures, scale, north and east."""

from collections.abc import Sequence

import cv2
import numpy as np
from startracker_ros.core.astro.earth import earth_position_au
from startracker_ros.core.catalog.constellations import FIGURES, NAMES
from startracker_ros.core.catalog.names import STAR_NAMES
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.stages.annotate import FOUND, Labels
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.photographs.deep_sky import DeepSkyObject
from startracker_ros.photographs.uncatalogued import Uncatalogued

NAMED, DEEP_SKY, _SCALE = (150, 190, 255), (225, 150, 255), (235, 235, 235)
_LINE = (70, 95, 140)
# Lines end so far from their stars, at most by a share of their length. They have so many points,
# for distorted images.
_LINE_GAP_PX, _LARGEST_GAP, _LINE_STEPS = 14.0, 0.2, 48
_SHIFT = 4  # bits of the fraction of a pixel
_STEPS_DEG = (30, 20, 10, 5, 2, 1, 1 / 2, 1 / 3, 1 / 6, 1 / 12, 1 / 30, 1 / 60)
_LONGEST, _ARROW, _MARGIN = 0.25, 0.06, 0.03  # of the width, of the shorter side
_SMALL_RAD = 1e-5


def mark_named_stars(picture: np.ndarray, sky: SkyMapping, year: float, hip: np.ndarray,
                     labels: Labels) -> None:
    """Write the names of bright stars that are not among the identified ones hip (N,)."""
    catalog = load_catalog().brighter_than(4.0)
    named = np.isin(catalog.hip, [*STAR_NAMES]) & ~np.isin(catalog.hip, hip)
    uv = sky.pixels(catalog.directions(year, earth_position_au(year))[named])
    for number, pixel in zip(catalog.hip[named], uv):
        if sky.camera.contains(pixel):
            labels.write(picture, STAR_NAMES[int(number)], tuple(map(round, pixel.tolist())),
                         NAMED)


def mark_figures(picture: np.ndarray, sky: SkyMapping, year: float, labels: Labels) -> None:
    """Draw the lines of the constellations, clear of the stars that they connect, and names."""
    catalog = load_catalog().brighter_than(6.0)
    order = np.argsort(catalog.hip)
    directions = catalog.directions(year, earth_position_au(year))
    share = np.linspace(0, 1, _LINE_STEPS)[:, None]
    figures = {}
    for name, lines in FIGURES.items():
        pairs = np.array([pair for line in lines for pair in zip(line, line[1:])])
        ends = order[np.searchsorted(catalog.hip, pairs, sorter=order)]
        parts = []
        for begin, end in directions[ends]:
            along = begin + share * (end - begin)
            uv = sky.pixels(along / np.linalg.norm(along, axis=1, keepdims=True))
            seen = np.isfinite(uv).all(axis=1)
            if not seen.any():
                continue
            length = np.linalg.norm(np.diff(uv[seen], axis=0), axis=1).sum()
            gap = min(_LINE_GAP_PX * labels.size, _LARGEST_GAP * length)
            # To an end outside the image the distance is NaN, which is not near.
            near = np.linalg.norm(uv[:, None] - uv[[0, -1]], axis=2) < gap
            shown = uv[seen & ~near.any(axis=1)]
            cv2.polylines(picture, [np.rint(shown * 2 ** _SHIFT).astype(np.int32)], False, _LINE,
                          labels.thick, cv2.LINE_AA, _SHIFT)
            parts.append(shown[sky.camera.contains(shown)])
        figures[name] = np.concatenate([*parts, np.empty((0, 2))])
        labels.keep_off(figures[name])
    for name, points in figures.items():
        if len(points):
            middle = np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()
            labels.write(picture, NAMES[name], _point(points[middle]), NAMED)


def mark_magnitudes(picture: np.ndarray, spots: Sequence[Uncatalogued], labels: Labels) -> None:
    """Draw a circle around each spot and write its magnitude."""
    for spot in spots:
        centre, radius = (round(spot.u), round(spot.v)), round(12 * labels.size)
        cv2.circle(picture, centre, radius, FOUND, labels.thick, cv2.LINE_AA)
        labels.write(picture, f'V {spot.magnitude:.1f}', centre, FOUND, radius)


def mark_deep_sky(picture: np.ndarray, sky: SkyMapping, objects: Sequence[DeepSkyObject],
                  labels: Labels) -> None:
    """Draw the outline of each object, or a circle if it is small, and its designation."""
    least = 12 * labels.size
    for one in objects:
        centre, outline = sky.pixels(one.direction[None])[0], sky.pixels(one.outline())
        radius = float(np.linalg.norm(outline - centre, axis=1).max())
        if radius < least:
            cv2.circle(picture, _point(centre), round(least), DEEP_SKY, labels.thick, cv2.LINE_AA)
        elif np.isfinite(outline).all():
            cv2.polylines(picture, [np.rint(outline * 2 ** _SHIFT).astype(np.int32)], True,
                          DEEP_SKY, labels.thick, cv2.LINE_AA, _SHIFT)
        # A name outside of a large outline may have no place in the image.
        if not labels.write(picture, one.name, _point(centre), DEEP_SKY,
                            round(np.nanmax([radius, least]))):
            labels.write(picture, one.name, _point(centre), DEEP_SKY)


def mark_scale(picture: np.ndarray, sky: SkyMapping, labels: Labels) -> None:
    """Draw a bar of a round number of degrees, and arrows to north and east, in free corners."""
    height, width = picture.shape[:2]
    margin = round(_MARGIN * min(width, height))
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    left, right = sky.directions(np.stack([middle - [0.5, 0], middle + [0.5, 0]]))
    deg_per_px = float(np.degrees(np.linalg.norm(right - left)))
    length_deg = next((step for step in _STEPS_DEG if step < _LONGEST * width * deg_per_px),
                      _STEPS_DEG[-1])
    _draw_bar(picture, length_deg, round(length_deg / deg_per_px), margin, labels)
    _draw_compass(picture, compass(sky, middle), margin, labels)


def _draw_bar(picture: np.ndarray, length_deg: float, length: int, margin: int, labels: Labels
              ) -> None:
    size, thick = labels.size, labels.thick
    left, top = labels.corner(length, round(26 * size), margin, right=False).tolist()
    row = top + round(20 * size)
    cv2.line(picture, (left, row), (left + length, row), _SCALE, thick, cv2.LINE_AA)
    for end in (left, left + length):
        cv2.line(picture, (end, row - round(4 * size)), (end, row + round(4 * size)), _SCALE,
                 thick, cv2.LINE_AA)
    text = f'{length_deg:g} deg' if length_deg >= 1 else f'{60 * length_deg:.0f} arcmin'
    cv2.putText(picture, text, (left, row - round(8 * size)), cv2.FONT_HERSHEY_SIMPLEX,
                0.5 * size, _SCALE, thick, cv2.LINE_AA)


def _draw_compass(picture: np.ndarray, ways: dict[str, np.ndarray], margin: int, labels: Labels
                  ) -> None:
    size, thick = labels.size, labels.thick
    arrow = _ARROW * min(picture.shape[:2])
    ends = np.stack([np.zeros(2), *(1.35 * arrow * way for way in ways.values())])
    letter = 8 * size
    low, high = ends.min(axis=0) - letter, ends.max(axis=0) + letter
    width, height = np.ceil(high - low).astype(int).tolist()
    foot = labels.corner(width, height, margin, right=True) - low
    for name, way in ways.items():
        cv2.arrowedLine(picture, _point(foot), _point(foot + arrow * way), _SCALE, thick,
                        cv2.LINE_AA, tipLength=0.25)
        cv2.putText(picture, name, _point(foot + 1.35 * arrow * way + [-5 * size, 5 * size]),
                    cv2.FONT_HERSHEY_SIMPLEX, 0.5 * size, _SCALE, thick, cv2.LINE_AA)


def compass(sky: SkyMapping, pixel: np.ndarray) -> dict[str, np.ndarray]:
    """Return the unit vectors (2,) in px towards north and east at a pixel (2,)."""
    z, = sky.directions(pixel[None])
    east = np.cross([0.0, 0.0, 1.0], z)
    east /= max(float(np.linalg.norm(east)), 1e-12)
    ways = sky.pixels(z + _SMALL_RAD * np.stack([np.cross(z, east), east])) - pixel
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return dict(zip('NE', ways))


def _point(pixel: np.ndarray) -> tuple[int, int]:
    u, v = pixel.round().astype(int).tolist()
    return u, v
