// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The blind search of photographs, for tools on the ground.

#include <algorithm>
#include <cmath>

#include "blind/lens_growth.h"
#include "blind/quads.h"
#include "blind/sky_triangle.h"
#include "ground.h"
#include "sky/near.h"
#include "startracker_ground.h"

using namespace st;

namespace {

bool is_given(const st_sky_and_spots *seen) {
    return seen != nullptr && seen->stars >= 0 && seen->spots >= 0 &&
           (seen->stars == 0 || seen->direction != nullptr) &&
           (seen->spots == 0 || (seen->spot_px != nullptr && seen->sigma_px != nullptr));
}

SkyAndSpots seen_of(const st_sky_and_spots &seen) {
    return {vectors(seen.direction), reinterpret_cast<const Point *>(seen.spot_px), seen.sigma_px,
            seen.stars, seen.spots};
}

bool is_possible(const st_camera &camera) {
    return camera.width_px > 0 && camera.height_px > 0 && camera.model >= 0 &&
           camera.model < ST_LENS_MODEL_COUNT;
}

bool are_parameters(int32_t count) {
    return count > RADIAL && count <= MOST_PARAMETERS;
}

st_status check(const st_lens_prior *prior, const st_sky_and_spots *seen) {
    if (prior == nullptr || !is_given(seen)) {
        return ST_NULL_POINTER;
    }
    return is_possible(prior->start) && are_parameters(prior->parameters) ? ST_OK : ST_BAD_INPUT;
}

LensPrior prior_of(const st_lens_prior &prior) {
    return {lens_of(prior.start), prior.free, prior.parameters};
}

LensView view_of(const st_camera &camera, const double *q) {
    return {lens_of(camera), {q[0], q[1], q[2], q[3]}};
}

/// Fill what a caller gets of a fit; the model of the camera stays.
void publish(const LensFit &fit, double probability, st_fitted_lens &lens) {
    const auto &[view, P, error_px] = fit;
    const Terms &t = view.lens.terms;
    const int32_t model = lens.camera.model;
    lens.camera = {view.lens.width,
                   view.lens.height,
                   view.lens.fx,
                   view.lens.fy,
                   view.lens.cx,
                   view.lens.cy,
                   {},
                   model,
                   0};
    const double fisheye[8] = {t.k1, t.k2, t.k3, t.k4};
    const double other[8] = {t.k1, t.k2, t.p1, t.p2, t.k3, t.d1, t.d2, t.d3};
    std::copy_n(view.lens.equidistant ? fisheye : other, 8, lens.camera.distortion);
    const double q[4] = {view.q.x, view.q.y, view.q.z, view.q.w};
    std::copy_n(q, 4, lens.quaternion);
    std::copy_n(&P.row[0][0], MOST_PARAMETERS * MOST_PARAMETERS, &lens.covariance[0][0]);
    lens.error_px = error_px;
    lens.probability = probability;
    const bool is_lens = view.lens.fx > 0 && view.lens.fy > 0;
    lens.folds = is_lens && image_does_not_fold(view.lens, nullptr) ? 0 : 1;
}

}  // namespace

extern "C" {

st_status st_pairs_within(const double *direction, size_t stars, const int32_t *start,
                          const int32_t *member, int32_t cells, double chord, int32_t *pairs,
                          double *square, size_t *found) {
    if (start == nullptr || found == nullptr ||
        (stars > 0 && (direction == nullptr || member == nullptr)) ||
        (*found > 0 && (pairs == nullptr || square == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (cells < 1 || !are_numbers(member, stars, stars)) {
        return ST_BAD_INPUT;
    }
    const Cells sky{cells, start, member};
    const Vector3 *vector = vectors(direction);
    const size_t most = *found;
    size_t count = 0;
    for (const int32_t *star = member; star < member + stars; ++star) {
        visit_near(sky, vector[*star], chord, [&](int32_t other) {
            if (other <= *star) {
                return;
            }
            const Vector3 d = vector[other] - vector[*star];
            const double distance2 = dot(d, d);
            if (distance2 <= chord * chord) {
                if (count < most) {
                    pairs[2 * count] = *star;
                    pairs[2 * count + 1] = other;
                    square[count] = distance2;
                }
                ++count;
            }
        });
    }
    *found = count;
    return ST_OK;
}

st_status st_match_quads(const st_quad_table *table, const double *direction, size_t stars,
                         const int32_t *quads, size_t count, double tolerance, double low,
                         double high, int32_t *image, int32_t *row, double *ratio, size_t *found) {
    if (table == nullptr || found == nullptr || (count > 0 && quads == nullptr) ||
        (stars > 0 && direction == nullptr) ||
        (*found > 0 && (image == nullptr || row == nullptr || ratio == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (!are_numbers(quads, QUAD * count, stars) || !(tolerance >= 0)) {
        return ST_BAD_INPUT;
    }
    QuadList list{image, row, ratio, *found, 0};
    match_quads(*table, vectors(direction), quads, count, tolerance, low, high, list);
    *found = list.count;
    return ST_OK;
}

st_status st_make_quads(const st_quad_level *level, int32_t *near, int64_t *by_rank,
                        double *square, uint8_t *alone, size_t *next, float *code, int32_t *star,
                        float *side_rad, size_t *found) {
    if (level == nullptr || next == nullptr || found == nullptr || level->start == nullptr ||
        (level->stars > 0 &&
         (level->direction == nullptr || level->member == nullptr || near == nullptr ||
          by_rank == nullptr || square == nullptr || alone == nullptr)) ||
        (*found > 0 && (code == nullptr || star == nullptr || side_rad == nullptr))) {
        return ST_NULL_POINTER;
    }
    const auto stars = static_cast<size_t>(level->stars);
    if (level->stars < 0 || level->cells < 1 || level->most_inner < 2 ||
        level->most_inner > ST_MOST_QUAD_INNER || !are_numbers(level->member, stars, stars)) {
        return ST_BAD_INPUT;
    }
    const QuadLevel given{vectors(level->direction),
                          stars,
                          {level->cells, level->start, level->member},
                          level->side,
                          level->longest,
                          level->crowd,
                          level->most_inner};
    if (*next == 0) {
        mark_alone(given, alone);
    }
    const QuadWork work{near, by_rank, square, alone};
    QuadsMade made{code, side_rad, star, *found, 0};
    size_t one = *next;
    while (one < stars && make_quads(given, static_cast<int32_t>(one), work, made)) {
        ++one;
    }
    if (one == *next && one < stars) {
        return ST_TOO_LITTLE_MEMORY;
    }
    *next = one;
    *found = made.count;
    return ST_OK;
}

st_status st_quad_cells(const float *code, size_t count, int32_t *cell) {
    if (count > 0 && (code == nullptr || cell == nullptr)) {
        return ST_NULL_POINTER;
    }
    for (size_t q = 0; q < count; ++q) {
        cell[q] = quad_cell(code + QUAD * q);
    }
    return ST_OK;
}

st_status st_sort_by_cell(const int32_t *cell, size_t count, int32_t cells, int32_t *start,
                          int32_t *order) {
    if (start == nullptr || (count > 0 && (cell == nullptr || order == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (cells < 1 || count > INT32_MAX || !are_numbers(cell, count, cells)) {
        return ST_BAD_INPUT;
    }
    std::fill(start, start + cells + 1, 0);
    for (size_t i = 0; i < count; ++i) {
        ++start[cell[i] + 1];
    }
    for (int32_t c = 0; c < cells; ++c) {
        start[c + 1] += start[c];
    }
    // Each start moves to the end of its cell, which is the start of the next.
    for (size_t i = 0; i < count; ++i) {
        order[start[cell[i]]++] = static_cast<int32_t>(i);
    }
    std::copy_backward(start, start + cells, start + cells + 1);
    start[0] = 0;
    return ST_OK;
}

st_status st_brightest_of_cells(const double *ra_rad, const double *dec_rad, size_t stars,
                                const int32_t *first, int32_t bands, int32_t most, uint8_t *filled,
                                uint8_t *chosen) {
    if (first == nullptr || filled == nullptr ||
        (stars > 0 && (ra_rad == nullptr || dec_rad == nullptr || chosen == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (bands < 1 || most < 1) {
        return ST_BAD_INPUT;
    }
    int64_t left = int64_t{most} * first[bands];
    for (size_t s = 0; s < stars && left > 0; ++s) {
        const int32_t band = clipped((dec_rad[s] / M_PI + 0.5) * bands, bands - 1);
        const int32_t across = first[band + 1] - first[band];
        const auto along =
            static_cast<int32_t>(std::floor((ra_rad[s] / (2 * M_PI) + 0.5) * across));
        const int32_t cell = first[band] + (along % across + across) % across;
        if (filled[cell] < most) {
            ++filled[cell];
            chosen[s] = 1;
            --left;
        }
    }
    return ST_OK;
}

st_status st_make_triangles(const double *direction, size_t stars, const int32_t *partner,
                            const int32_t *start, double shortest_rad, double least_longest_rad,
                            double longest_rad, float *side_rad, int32_t *star, int32_t *cell,
                            size_t *found) {
    if (start == nullptr || found == nullptr || (stars > 0 && direction == nullptr) ||
        (start[stars] > 0 && partner == nullptr) ||
        (*found > 0 && (side_rad == nullptr || star == nullptr || cell == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (!are_numbers(partner, static_cast<size_t>(start[stars]), stars)) {
        return ST_BAD_INPUT;
    }
    const size_t most = *found;
    size_t count = 0;
    visit_triangles(vectors(direction), stars, partner, start,
                    {shortest_rad, least_longest_rad, longest_rad},
                    [&](const Triangle &one, int one_cell) {
                        if (count < most) {
                            for (size_t k = 0; k < 3; ++k) {
                                side_rad[3 * count + k] = static_cast<float>(one.side[k]);
                                star[3 * count + k] = one.star[k];
                            }
                            cell[count] = one_cell;
                        }
                        ++count;
                    });
    *found = count;
    return ST_OK;
}

st_status st_fit_lens(const st_lens_prior *prior, const st_sky_and_spots *seen,
                      const int32_t *star, st_fitted_lens *lens, void *work, size_t bytes) {
    if (const st_status status = check(prior, seen); status != ST_OK) {
        return status;
    }
    if (lens == nullptr || work == nullptr || (seen->spots > 0 && star == nullptr)) {
        return ST_NULL_POINTER;
    }
    if (!is_possible(lens->camera) || std::any_of(star, star + seen->spots, [seen](int32_t one) {
            return one >= seen->stars;
        })) {
        return ST_BAD_INPUT;
    }
    Arena arena(work, bytes);
    const SpotWork lists(seen->spots, arena);
    if (!lists.is_whole()) {
        return ST_TOO_LITTLE_MEMORY;
    }
    LensFit fit{view_of(lens->camera, lens->quaternion), {}, 0.0};
    fit_lens(prior_of(*prior), seen_of(*seen), star, lists.square, fit);
    publish(fit, 1.0, *lens);
    return ST_OK;
}

st_status st_gated_stars(const st_fitted_lens *lens, int32_t parameters, double error_px,
                         const st_sky_and_spots *seen, int32_t *star, void *work, size_t bytes) {
    if (lens == nullptr || work == nullptr || !is_given(seen) ||
        (seen->spots > 0 && star == nullptr)) {
        return ST_NULL_POINTER;
    }
    if (!is_possible(lens->camera) || !are_parameters(parameters)) {
        return ST_BAD_INPUT;
    }
    Arena arena(work, bytes);
    const SpotWork lists(seen->spots, arena);
    if (!lists.is_whole()) {
        return ST_TOO_LITTLE_MEMORY;
    }
    LensFit fit{view_of(lens->camera, lens->quaternion), {}, lens->error_px};
    std::copy_n(&lens->covariance[0][0], MOST_PARAMETERS * MOST_PARAMETERS, &fit.P.row[0][0]);
    gated_stars(fit, parameters, error_px, seen_of(*seen), star, lists.best);
    return ST_OK;
}

st_status st_grow_lens(const st_lens_prior *prior, const st_sky_and_spots *seen,
                       const int32_t *spots, const int32_t *stars, const double *ratio,
                       size_t count, st_fitted_lens *lens, int32_t *star, void *work,
                       size_t bytes) {
    if (const st_status status = check(prior, seen); status != ST_OK) {
        return status;
    }
    if (lens == nullptr || work == nullptr || (seen->spots > 0 && star == nullptr) ||
        (count > 0 && (spots == nullptr || stars == nullptr || ratio == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (!are_numbers(spots, QUAD * count, static_cast<size_t>(seen->spots)) ||
        !are_numbers(stars, QUAD * count, static_cast<size_t>(seen->stars))) {
        return ST_BAD_INPUT;
    }
    Arena arena(work, bytes);
    const SpotWork lists(seen->spots, arena);
    if (!lists.is_whole()) {
        return ST_TOO_LITTLE_MEMORY;
    }
    const LensPrior given = prior_of(*prior);
    const SkyAndSpots sky = seen_of(*seen);
    *lens = {};
    lens->camera = prior->start;
    lens->quaternion[3] = lens->probability = 1.0;
    std::fill(star, star + seen->spots, -1);
    for (size_t k = 0; k < count; ++k) {
        LensPrior assumed = given;
        assumed.start.fx /= ratio[k];
        assumed.start.fy /= ratio[k];
        LensFit fit{};
        const double probability =
            grow_lens(assumed, sky, spots + QUAD * k, stars + QUAD * k, fit, lists);
        if (probability < lens->probability) {
            publish(fit, probability, *lens);
            std::copy(lists.star, lists.star + seen->spots, star);
        }
    }
    return ST_OK;
}

st_status st_stars_in_image(const st_camera *camera, const double quaternion[4],
                            const double *direction, size_t stars, int32_t *index, double *pixel,
                            size_t *count) {
    if (camera == nullptr || quaternion == nullptr || count == nullptr ||
        (stars > 0 && (direction == nullptr || index == nullptr || pixel == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (!is_possible(*camera)) {
        return ST_BAD_INPUT;
    }
    const LensView view = view_of(*camera, quaternion);
    const Matrix3 R = matrix_from_quaternion(view.q);
    const double least = least_cosine(view.lens);
    size_t found = 0;
    for (size_t i = 0; i < stars; ++i) {
        const Point at =
            pixel_in_image(view.lens, least, sensor_direction(R, vectors(direction)[i]));
        if (!std::isnan(at.x)) {
            index[found] = static_cast<int32_t>(i);
            pixel[2 * found] = at.x;
            pixel[2 * found++ + 1] = at.y;
        }
    }
    *count = found;
    return ST_OK;
}

}  // extern "C"
