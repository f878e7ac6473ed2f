# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification of a few stars among many false spots, by all triangles of them.

Where one spot of ten is a star, one triangle of a thousand is of stars alone. So all are looked up
(sky_triangles.py), and the stars about a triangle of the sky vote: A, B, C and the image stars
a, b, c put a catalogue star s = w_A A + w_B B + w_C C at w_A a + w_B b + w_C c, with
w_A = s . (B x C) / A . (B x C) and so on, which needs no attitude and no scale. Where one of them
meets a spot, the candidate is verified by all spots.

What is accepted depends on no number of triangles, but on how many fields of the sky agree as well
by chance: false_alarm.py.
"""

from typing import NamedTuple

import numpy as np
from startracker_ros.core.attitude.estimate import estimate_attitude
from startracker_ros.core.camera.lens import plane_points, rays, undistorted
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.sky_grid import count_in_image, SkyGrid
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.compiled import compiled, inlined
from startracker_ros.core.identify.identification import FieldStars, Identification, Identifier
from startracker_ros.core.identify.star_matcher import usable_stars
from startracker_ros.core.identify.verification import Match
from startracker_ros.core.maths.sorting import upper_median
from startracker_ros.photographs.association import align
from startracker_ros.photographs.chance import (
    few_star_probability, FEWEST, occupied_cells, order_probability)
from startracker_ros.photographs.sky_triangles import (
    cell_along, code_cell, FLATTEST, side_order, TriangleTable)
from startracker_ros.photographs.support import squared_chord, triple_product

MOST_SPOTS = 80
# Cells along one side of the image, of whose matches one counts: two of six stars are soon so
# close as in the coarser cells of other identifications.
_CELLS = 32
# The radius in which a spot is looked for, in those of a match: the triangle has errors too.
_REACH = 2.0
# The gate of a side, in those radii: of all triangles of true stars one is enough.
_GATE = 0.7
# Expected time in ns: of an image triangle, of a triangle of the sky that fits, of a verification.
_LOOK_UP_NS, _VOTE_NS, _VERIFY_NS = 300.0, 400.0, 40_000.0


class SpotField(NamedTuple):
    """
    What verifies a candidate: the sky, the tolerance in sigmas, the share of the focal length.

    equidistant is of the lens; border holds those of the image in undistorted coordinates (low,
    high, low, high) and the chord from its axis to the farthest corner; area is in rad^2.
    """

    sky: SkyGrid
    tolerance_sigmas: float
    scale_error: float
    equidistant: bool
    border: tuple[float, float, float, float, float]
    area: float


class Verification(NamedTuple):
    """
    A candidate that was verified; a false_alarm of one means that it is rejected.

    star (N,) are the catalogue stars of the image stars, -1 for none; residual (N,) is in
    undistorted coordinates; matrix (3, 3) turns sensor vectors to ICRF.
    """

    false_alarm: float
    focal_ratio: float
    star: np.ndarray
    residual: np.ndarray
    matrix: np.ndarray


def few_stars(identifier: Identifier, table: TriangleTable, centroids: Centroids,
              sigma_floor_px: float, false_alarm_max: float, work_s: float
              ) -> tuple[Identification, float]:
    """
    Return the stars of the first triangle that is accepted by so much work, and what it took.

    Work is that of PyramidIdentifier.identify_within().
    """
    index, image, sigma = usable_stars(
        identifier.camera, centroids, identifier.options.max_image_stars, sigma_floor_px)
    in_time, found, work_ns = identify_few(
        table, spot_field(identifier), image, sigma, false_alarm_max, 1e9 * work_s)
    if found.false_alarm > false_alarm_max:
        status = 'no_candidate' if in_time else 'time_limit'
        return identifier.unidentified(centroids, status, f'{len(index)} spots, no few of them '
                                       'are stars', found.false_alarm), 1e-9 * work_ns
    return identifier.identified(
        centroids, FieldStars(index, image, sigma, centroids.flux[index]),
        _match(identifier, found, image, sigma)), 1e-9 * work_ns


def spot_field(identifier: Identifier) -> SpotField:
    """Return what verifies the candidates of an identifier."""
    camera, options = identifier.camera, identifier.options
    return SpotField(
        identifier.onboard.grid, float(options.tolerance_sigmas), float(identifier.scale_error),
        camera.model.equidistant,
        # A field of view wider than nominal contains stars from a little beyond.
        (*_borders(camera), float(2 * np.sin(min(1.1 * camera.corner_angle_rad, np.pi) / 2))),
        image_area(camera))


def image_area(camera: Camera) -> float:
    """Return the area of an image in rad^2, at the scale of its middle."""
    return camera.width * camera.height * camera.pixel_rad ** 2


def _borders(camera: Camera) -> tuple[float, float, float, float]:
    """
    Return the least and largest undistorted coordinates a, then b, on the axes of the image.

    They are those of the image circle where that is smaller.
    """
    right, bottom = camera.width - 0.5, camera.height - 0.5
    middle_u, middle_v = (right - 0.5) / 2, (bottom - 0.5) / 2
    edges = undistorted(camera.lens, np.array([[-0.5, middle_v], [right, middle_v],
                                               [middle_u, -0.5], [middle_u, bottom]]))
    border = edges[[0, 1, 2, 3], [0, 0, 1, 1]]
    low_a, high_a, low_b, high_b = np.where(
        np.isnan(border), camera.lens.farthest_rad * np.array([-1, 1, -1, 1]), border).tolist()
    return low_a, high_a, low_b, high_b


def _match(identifier: Identifier, found: Verification, image: np.ndarray, sigma: np.ndarray
           ) -> Match:
    """Return a verification of image stars (N, 3) with its attitude."""
    equidistant, known = identifier.camera.model.equidistant, found.star >= 0
    sensor = rays(equidistant, plane_points(equidistant, image[known]) / found.focal_ratio)
    attitude = estimate_attitude(
        sensor, identifier.onboard.direction[found.star[known]], sigma[known])
    return Match(found.star, found.residual / identifier.camera.pixel_rad, attitude,
                 found.focal_ratio, found.false_alarm)


class _SpotMap(NamedTuple):
    """Spots in the cells (R, C) of an image of about the radius of a search, -1 for none."""

    spot: np.ndarray
    low_a: float
    low_b: float
    per_cell: float


@compiled
def _spot_map(seen: np.ndarray, reach: float) -> _SpotMap:
    """Return the map of spots seen (N, 2), each in its cell and the eight about it."""
    low_a, low_b = seen[:, 0].min() - 2 * reach, seen[:, 1].min() - 2 * reach
    per_cell = 1 / reach
    spot = np.full((int((seen[:, 0].max() - low_a) * per_cell) + 3,
                    int((seen[:, 1].max() - low_b) * per_cell) + 3), -1, np.int16)
    # The brightest of several spots is the last that is put there.
    for i in range(len(seen) - 1, -1, -1):
        row = int((seen[i, 0] - low_a) * per_cell)
        column = int((seen[i, 1] - low_b) * per_cell)
        for r in range(row - 1, row + 2):
            for c in range(column - 1, column + 2):
                spot[r, c] = i
    return _SpotMap(spot, low_a, low_b, per_cell)


@inlined
def _spot_at(spots: _SpotMap, a: float, b: float) -> int:
    """Return the spot near a, b, -1 for none."""
    row, column = (a - spots.low_a) * spots.per_cell, (b - spots.low_b) * spots.per_cell
    if not (0 <= row < spots.spot.shape[0] and 0 <= column < spots.spot.shape[1]):
        return -1
    return int(spots.spot[int(row), int(column)])


@compiled
def identify_few(table: TriangleTable, verifier: SpotField, image: np.ndarray,
                 sigma: np.ndarray, false_alarm_max: float, most_ns: float
                 ) -> tuple[bool, Verification, float]:
    """
    Return whether all was searched, the first accepted verification or the best, and the work.

    Work is in ns, most_ns at most.

    image (N, 3) are the image stars, brightest first, sigma (N,) their errors in rad.
    """
    seen = plane_points(verifier.equidistant, image)
    best, work_ns = _rejected(len(image)), 0.0
    count = min(len(image), MOST_SPOTS)
    if count < FEWEST:
        return True, best, 0.0
    radius = verifier.tolerance_sigmas * upper_median(sigma)
    spots = _spot_map(seen, _REACH * radius)
    # Of the difference of two directions.
    gate = np.sqrt(2.0) * _GATE * radius
    angle = _angles(image[:count])
    base, star = np.empty(3, np.int64), np.empty(3, np.int64)
    for k in range(2, count):
        for j in range(1, k):
            for i in range(j):
                work = _LOOK_UP_NS
                first, second, third = side_order(angle[j, k], angle[i, k], angle[i, j])
                three = (i, j, k)
                base[0], base[1], base[2] = three[first], three[second], three[third]
                longest, middle = angle[base[1], base[2]], angle[base[0], base[2]]
                shortest = angle[base[0], base[1]]
                if (not table.low <= longest <= table.high
                        or middle + shortest < FLATTEST * longest):
                    continue
                turned = triple_product(image, base[0], base[1], base[2]) < 0
                slack = gate / longest
                low, high = longest * (1 - verifier.scale_error) - gate, (
                    longest * (1 + verifier.scale_error) + gate)
                for x in range(cell_along(shortest / longest - slack),
                               cell_along(shortest / longest + slack) + 1):
                    for y in range(cell_along(middle / longest - slack),
                                   cell_along(middle / longest + slack) + 1):
                        cell = code_cell(x, y, turned)
                        row = _first_from(table, cell, low)
                        while row < table.start[cell + 1] and table.side[row, 0] <= high:
                            if _fits(table, row, longest, middle, shortest, gate,
                                     verifier.scale_error):
                                work += _VOTE_NS
                                for m in range(3):
                                    star[m] = table.star[row, m]
                                if _has_vote(table, verifier, spots, seen, image, base, star,
                                             radius):
                                    work += _VERIFY_NS
                                    found = _verify(verifier, seen, sigma, base, star, radius)
                                    if found.false_alarm < best.false_alarm:
                                        best = found
                                        if best.false_alarm <= false_alarm_max:
                                            return True, best, work_ns + work
                            row += 1
                work_ns += work
                if work_ns > most_ns:
                    return False, best, work_ns
    return True, best, work_ns


@compiled
def _rejected(count: int) -> Verification:
    """Return the verification of no candidate, for count image stars."""
    return Verification(1.0, 1.0, np.full(count, -1), np.full(count, np.nan), np.eye(3))


@compiled
def _angles(image: np.ndarray) -> np.ndarray:
    """Return the angles (N, N) in rad between unit vectors (N, 3)."""
    count = len(image)
    angle = np.zeros((count, count))
    for i in range(count):
        for j in range(i):
            angle[i, j] = angle[j, i] = 2 * np.arcsin(
                min(np.sqrt(squared_chord(image, i, j)) / 2, 1.0))
    return angle


@inlined
def _first_from(table: TriangleTable, cell: int, low: float) -> int:
    """Return the first triangle of a cell whose longest side is not below low."""
    first, last = int(table.start[cell]), int(table.start[cell + 1])
    while first < last:
        half = (first + last) // 2
        if table.side[half, 0] < low:
            first = half + 1
        else:
            last = half
    return first


@inlined
def _fits(table: TriangleTable, row: int, longest: float, middle: float, shortest: float,
          gate: float, scale_error: float) -> bool:
    """Return whether a triangle of the sky fits three sides with one scale."""
    d_0, d_1, d_2 = table.side[row, 0], table.side[row, 1], table.side[row, 2]
    s = ((d_0 * longest + d_1 * middle + d_2 * shortest)
         / (longest * longest + middle * middle + shortest * shortest))
    return (abs(d_0 - s * longest) <= gate and abs(d_1 - s * middle) <= gate
            and abs(d_2 - s * shortest) <= gate
            and abs(s - 1) <= scale_error + gate / longest)


@compiled
def _has_vote(table: TriangleTable, verifier: SpotField, spots: _SpotMap, seen: np.ndarray,
              image: np.ndarray, base: np.ndarray, star: np.ndarray, radius: float) -> bool:
    """Return whether a star about a triangle star (3,) meets a spot beside those of base (3,)."""
    direction = verifier.sky.direction
    a, b, c = star[0], star[1], star[2]
    whole = triple_product(direction, a, b, c)
    ax, ay, az = direction[a, 0], direction[a, 1], direction[a, 2]
    bx, by, bz = direction[b, 0], direction[b, 1], direction[b, 2]
    cx, cy, cz = direction[c, 0], direction[c, 1], direction[c, 2]
    bc_x, bc_y, bc_z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    ca_x, ca_y, ca_z = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
    ab_x, ab_y, ab_z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    i, j, k = base[0], base[1], base[2]
    for m in range(table.neighbour.shape[1]):
        s = table.neighbour[a, m]
        if s < 0:
            break
        if s in (b, c):
            continue
        x, y, z = direction[s, 0], direction[s, 1], direction[s, 2]
        w_a = (x * bc_x + y * bc_y + z * bc_z) / whole
        w_b = (x * ca_x + y * ca_y + z * ca_z) / whole
        w_c = (x * ab_x + y * ab_y + z * ab_z) / whole
        depth = w_a * image[i, 2] + w_b * image[j, 2] + w_c * image[k, 2]
        if depth <= 0:
            continue
        # Where the lens is a plane; the spots of a few degrees of others differ little from it.
        at_a = (w_a * image[i, 0] + w_b * image[j, 0] + w_c * image[k, 0]) / depth
        at_b = (w_a * image[i, 1] + w_b * image[j, 1] + w_c * image[k, 1]) / depth
        spot = _spot_at(spots, at_a, at_b)
        if spot < 0 or spot in (i, j, k):
            continue
        da, db = seen[spot, 0] - at_a, seen[spot, 1] - at_b
        spread = min(1 + w_a * w_a + w_b * w_b + w_c * w_c, _REACH * _REACH)
        if da * da + db * db <= radius * radius * spread:
            return True
    return False


@compiled
def _verify(verifier: SpotField, seen: np.ndarray, sigma: np.ndarray, base: np.ndarray,
            star: np.ndarray, radius: float) -> Verification:
    """Verify that image stars base (3,) are the catalogue stars star (3,)."""
    sky, equidistant, area = verifier.sky, verifier.equidistant, verifier.area
    agrees, ratio, matched, residual, matrix = align(
        sky, equidistant, seen, sigma, base, star, radius, verifier.scale_error)
    if not agrees:
        return Verification(1.0, ratio, matched, residual, matrix)
    low_a, high_a, low_b, high_b, chord = verifier.border
    field = low_a / ratio, high_a / ratio, low_b / ratio, high_b / ratio
    size = high_a - low_a, high_b - low_b
    stars = count_in_image(sky, equidistant, matrix, chord, *field, len(sky.direction))
    cells, chosen = occupied_cells(seen, matched, area, _CELLS)
    rank = np.zeros(len(matched), np.int64)
    for i in range(len(matched)):
        if chosen[i]:
            rank[i] = count_in_image(sky, equidistant, matrix, chord, *field, matched[i] + 1)
    # Each choice of matches is a field of its own: one match by chance must not hide the others.
    false_alarm, left_out = _probability(cells, stars, matched, residual, rank, chosen, size,
                                         verifier.scale_error), 0
    while left_out >= 0:
        left_out = -1
        for i in range(len(chosen)):
            if not chosen[i]:
                continue
            chosen[i] = False
            without = _probability(cells, stars, matched, residual, rank, chosen, size,
                                   verifier.scale_error)
            chosen[i] = True
            if without < false_alarm:
                false_alarm, left_out = without, i
        if left_out >= 0:
            chosen[left_out] = False
            matched[left_out], residual[left_out] = -1, np.nan
    return Verification(false_alarm, ratio, matched, residual, matrix)


@compiled
def _probability(cells: int, stars: int, matched: np.ndarray, residual: np.ndarray,
                 rank: np.ndarray, chosen: np.ndarray, size: tuple[float, float],
                 scale_error: float) -> float:
    """Return P_few of the chosen ones (N,) of the matches, rank (N,) that of their stars."""
    m = faintest = 0
    square = 0.0
    for i in range(len(chosen)):
        if chosen[i]:
            m += 1
            faintest = max(faintest, rank[i])
            square += residual[i] ** 2
    return few_star_probability(cells, m, faintest, stars, square,
                                order_probability(matched, chosen), size, scale_error)
