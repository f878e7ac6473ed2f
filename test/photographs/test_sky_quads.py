# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Codes of quads and their look-up."""

from itertools import combinations, permutations

from native_core import call
import numpy as np
import pytest
from startracker_ros.core.maths.rotation import matrix_from_quaternion, random_attitude
from startracker_ros.photographs.sky_quads import in_order, matching_quads, quad_table, quads_of

ANYTHING = 0.1, 10.0


def code_of(direction, four):
    code = np.empty(4)
    assert call('stt_quad_code', direction, np.array(four, np.int32), code)
    return code


def sky(count=400, seed=5):
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def cap(count, radius_rad, rng):
    """Return unit vectors within a radius of the pole."""
    plane = rng.uniform(-radius_rad, radius_rad, (count, 2)) / 2
    vectors = np.column_stack([plane, np.ones(count)])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_a_code_depends_on_neither_attitude_nor_small_scale():
    rng = np.random.default_rng(1)
    stars = cap(4, 0.02, rng)
    turned = stars @ matrix_from_quaternion(random_attitude(rng)).T
    np.testing.assert_allclose(code_of(turned, [0, 1, 2, 3]), code_of(stars, [0, 1, 2, 3]),
                               atol=1e-10)
    half = stars * [0.5, 0.5, 1]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    np.testing.assert_allclose(code_of(half, [0, 1, 2, 3]), code_of(stars, [0, 1, 2, 3]),
                               atol=1e-3)


def test_the_code_is_where_c_and_d_are_between_a_and_b():
    stars = np.array([[0.0, 0], [0.01, 0], [0.004, 0.002], [0.005, -0.001]])
    stars = np.column_stack([stars, np.ones(4)])
    stars /= np.linalg.norm(stars, axis=1, keepdims=True)
    np.testing.assert_allclose(code_of(stars, [0, 1, 2, 3]), [0.4, 0.2, 0.5, -0.1], atol=1e-4)
    np.testing.assert_allclose(code_of(stars, [1, 0, 2, 3]), [0.6, -0.2, 0.5, 0.1], atol=1e-4)
    mirrored = stars * [1, -1, 1]
    np.testing.assert_allclose(code_of(mirrored, [0, 1, 2, 3]), [0.4, -0.2, 0.5, 0.1], atol=1e-4)


@pytest.mark.parametrize('order', [*permutations(range(4))])
def test_four_stars_are_found_in_any_order(order):
    direction = sky()
    table = quad_table(*quads_of(direction, 20.0, 40.0, 1.0))
    for row in range(0, len(table.star), len(table.star) // 20):
        star = table.star[row][list(order)]
        image, quad, ratio = matching_quads(table, direction[star], 0, 4, 1e-4, *ANYTHING, 100)
        mine = np.flatnonzero(quad == row)
        assert len(mine) and np.allclose(ratio[mine], 1)
        assert (star[image[mine]] == table.star[row]).all(1).any()


def test_the_table_has_quads_of_its_sides_alone():
    """And most of all there are: of more than four stars between A and B the brightest."""
    direction = sky(40)
    table = quad_table(*quads_of(direction, 40.0, 56.0, 1.0))
    dot = direction @ direction.T
    longest = {four: np.degrees(np.arccos(min(dot[pair] for pair in combinations(four, 2))))
               for four in combinations(range(40), 4)}
    possible = {four for four, side in longest.items() if 40.0 <= side <= np.sqrt(2) * 40.0}
    known = {tuple(sorted(row)) for row in table.star.tolist()}
    assert len(known) == len(table.star) and known <= possible
    assert len(known) > 0.6 * len(possible) > 20
    code = table.code
    assert (code[:, 0] + code[:, 2] <= 1 + 1e-6).all() and (code[:, 0] <= code[:, 2]).all()


def test_cells_give_a_poor_sky_as_many_quads_as_a_rich_one():
    rng, vectors = np.random.default_rng(3), sky(60_000)
    # The stars of the north are ten times as many, and in the same order of brightness.
    direction = vectors[(vectors[:, 2] > 0) | (rng.uniform(size=len(vectors)) < 0.1)]
    quads, poor = [], []
    for even in (False, True):
        table = quad_table(*quads_of(direction, 5.0, 7.0, 1.0, even=even))
        middle = direction[table.star].mean(axis=1)
        quads.append(len(table.star))
        poor.append(np.mean(middle[:, 2] < 0))
    assert poor[0] < 0.01 and 0.4 < poor[1] < 0.6
    # Not by more quads: those of crowds are left out.
    assert quads[1] < quads[0]


def test_a_table_finds_what_a_search_of_all_its_codes_finds():
    direction, rng = sky(), np.random.default_rng(2)
    table = quad_table(*quads_of(direction, 20.0, 40.0, 1.0))
    image = cap(6, 0.5, rng)
    base, quad, _ = matching_quads(table, image, 0, 6, 0.05, *ANYTHING, 10_000)
    assert len(quad)
    for four, row in zip(base, quad):
        assert np.abs(code_of(image, four) - table.code[row]).max() <= 0.05 + 1e-6
    found = set(zip(map(tuple, np.sort(base, axis=1).tolist()), quad.tolist()))
    expected = set()
    for four in permutations(range(6), 4):
        longest = max(np.linalg.norm(image[a] - image[b]) for a, b in combinations(four, 2))
        if np.linalg.norm(image[four[0]] - image[four[1]]) < longest:
            continue
        near = np.abs(code_of(image, four) - table.code).max(1) <= 0.05 - 1e-6
        expected |= {(tuple(sorted(four)), int(row)) for row in np.flatnonzero(near)}
    assert expected <= found


def test_quads_in_another_order_of_brightness_are_left_out():
    star = np.array([*permutations(range(4))])
    image = np.broadcast_to(np.arange(4), star.shape)
    kept = in_order(image, star)
    assert kept[0] and not kept[-1] and kept.sum() == 15
    # The order of the code does not matter.
    np.testing.assert_array_equal(in_order(image[:, [2, 0, 3, 1]], star[:, [2, 0, 3, 1]]), kept)
