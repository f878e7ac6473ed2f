// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Identification for tools on the ground: by arrays, and of candidates found elsewhere.

#include <algorithm>
#include <cmath>

#include "attitude/results.h"
#include "blind/few_stars.h"
#include "ground.h"
#include "startracker_ground.h"
#include "tracker.h"

using namespace st;

namespace {

constexpr size_t MOST_GIVEN = 100000000;

bool are_given(const st_pairs &pairs) {
    return pairs.pairs == 0 || (pairs.star != nullptr && pairs.direction != nullptr &&
                                pairs.separation_rad != nullptr && pairs.below != nullptr &&
                                pairs.member != nullptr && pairs.previous != nullptr);
}

const double (*rows(const double *array))[3] {
    return reinterpret_cast<const double (*)[3]>(array);
}

Pairs pairs_of(const st_pairs &pairs) {
    Pairs made{pairs.stars,
               pairs.pairs,
               pairs.star,
               rows(pairs.direction),
               pairs.separation_rad,
               pairs.below,
               pairs.member,
               pairs.previous,
               0.0,
               0.0};
    set_steps(made);
    return made;
}

st_status check(const st_patterns *patterns) {
    if (patterns->hip == nullptr || patterns->direction == nullptr ||
        patterns->magnitude == nullptr || patterns->blended == nullptr ||
        patterns->start == nullptr || patterns->member == nullptr ||
        !are_given(patterns->bright) || !are_given(patterns->pairs)) {
        return ST_NULL_POINTER;
    }
    const bool possible = patterns->stars > 0 && patterns->cells > 0 && patterns->in_cells > 0 &&
                          patterns->in_cells <= patterns->stars && patterns->pairs.pairs >= 0 &&
                          patterns->bright.pairs >= 0 && patterns->most_centroids > 0 &&
                          patterns->bright_image_stars >= 0 && patterns->scale_error >= 0 &&
                          patterns->scale_error < 1;
    if (!possible) {
        return ST_BAD_INPUT;
    }
    return ST_OK;
}

/// Set what a tracker takes from a sky file, and from patterns instead of those of the file.
st_status set_up_for(const st_config *config, const st_camera *camera, const st_sky *sky,
                     const st_patterns *given, Setup &setup, st_fault *fault) {
    if (config == nullptr || given == nullptr) {
        return ST_NULL_POINTER;
    }
    st_status status = check_tracker(config, camera, fault);
    if (status == ST_OK) {
        status = has(*config, ST_IDENTIFIES) ? check(given) : ST_NO_STAGE;
    }
    st_config others = *config;
    others.stages &= ~ST_IDENTIFIES;
    if (status == ST_OK) {
        status = set_up(others, *camera, sky, setup, fault);
    }
    if (status == ST_OK) {
        const Cells cells{given->cells, given->start, given->member};
        setup.identification = {
            {given->stars, given->hip, rows(given->direction), given->magnitude, given->blended,
             cells, given->in_cells, pairs_of(given->bright), pairs_of(given->pairs)},
            {given->bright_image_stars, given->bright_triangles},
            given->scale_error,
            given->bases_by_brightness != 0,
            given->lens_unknown == 0,
            config->identification.max_image_stars,
            std::max(given->most_centroids, most_centroids(*config))};
    }
    return status;
}

st_status check(const st_tracker *tracker, const st_image_stars *stars) {
    if (tracker == nullptr || stars == nullptr ||
        (stars->count > 0 && (stars->direction == nullptr || stars->sigma_rad == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (!has_stage(*tracker, ST_IDENTIFIES)) {
        return ST_NO_STAGE;
    }
    return stars->count < 0                                      ? ST_BAD_INPUT
           : stars->count > tracker->identification.most_stars() ? ST_TOO_MANY
                                                                 : ST_OK;
}

/// Return the image stars of a caller in the work memory of a tracker.
ImageStars stars_of(const st_image_stars &given, st_tracker &tracker) {
    ImageStars stars = image_stars(given.count, tracker.work);
    stars.count = given.count;
    for (int i = 0; i < given.count; ++i) {
        const double *direction = given.direction + ptrdiff_t{3} * i;
        stars.index[i] = i;
        stars.direction[i] = {{direction[0], direction[1], direction[2]}};
        stars.sigma[i] = given.sigma_rad[i];
    }
    complete(tracker.identification.lens().equidistant, stars, tracker.work);
    return stars;
}

/// Fill what a call for image stars returns of a verification: the best fit where it is not rejected.
void publish(const st_tracker &tracker, const ImageStars &image, const Verification &result,
             st_verification &verification, int32_t *star, double *residual_px,
             double *residual_rad, Arena &work) {
    const IdentificationStage &stage = tracker.identification;
    const double pixels = std::sqrt(stage.lens().fx * stage.lens().fy);
    set_unknown(verification.attitude);
    verification.focal_ratio = result.found.focal_ratio;
    verification.false_alarm_probability = result.false_alarm;
    for (int i = 0; i < image.count; ++i) {
        star[i] = result.found.star[i];
        residual_px[i] = result.found.residual[i] * pixels;
        residual_rad[i] = NAN;
    }
    if (result.false_alarm < 1) {
        const Verifier &verifier = stage.uncounted();
        const AttitudeFit best = fit_attitude(verifier.sky, verifier.equidistant, image,
                                              result.found, residual_rad, work);
        set_fit(best, residual_rad, image.count, 1 / pixels, verification.attitude);
    }
}

}  // namespace

extern "C" {

st_status st_size_for(const st_config *config, const st_camera *camera, const st_sky *sky,
                      const st_patterns *patterns, size_t *bytes) {
    if (bytes == nullptr) {
        return ST_NULL_POINTER;
    }
    Setup setup;
    const st_status status = set_up_for(config, camera, sky, patterns, setup, nullptr);
    if (status == ST_OK) {
        *bytes = tracker_bytes(*config, *camera, setup);
    }
    return status;
}

st_status st_create_for(void *memory, size_t bytes, const st_config *config,
                        const st_camera *camera, const st_sky *sky, const st_patterns *patterns,
                        st_tracker **tracker, st_fault *fault) {
    if (memory == nullptr || tracker == nullptr) {
        return ST_NULL_POINTER;
    }
    Setup setup;
    const st_status status = set_up_for(config, camera, sky, patterns, setup, fault);
    return status == ST_OK ? make_tracker(memory, bytes, *config, *camera, setup, tracker)
                           : status;
}

st_status st_usable_stars(const st_camera *camera, const st_centroid *centroids,
                          const int32_t *order, size_t given, double sigma_floor_px,
                          int32_t *index, double *direction, double *sigma_rad, size_t *count) {
    if (camera == nullptr || count == nullptr ||
        (given > 0 && (centroids == nullptr || order == nullptr)) ||
        (*count > 0 && (index == nullptr || direction == nullptr || sigma_rad == nullptr))) {
        return ST_NULL_POINTER;
    }
    const st_status status = st_check_camera(camera, nullptr);
    if (status != ST_OK) {
        return status;
    }
    if (given > MOST_GIVEN || *count > MOST_GIVEN) {
        return ST_TOO_MANY;
    }
    const auto centroid_count = static_cast<int32_t>(given);
    if (!are_numbers(order, given, centroid_count) || !(sigma_floor_px >= 0)) {
        return ST_BAD_INPUT;
    }
    ImageStars stars{0, index, reinterpret_cast<Vector3 *>(direction), nullptr, sigma_rad, 0.0};
    usable_stars(lens_of(*camera), centroids, order, centroid_count, static_cast<int>(*count),
                 sigma_floor_px, stars);
    *count = static_cast<size_t>(stars.count);
    return ST_OK;
}

st_status st_support(st_tracker *tracker, const st_image_stars *stars, const int32_t *base,
                     const int32_t *candidates, size_t count, double *support) {
    const st_status status = check(tracker, stars);
    if (status != ST_OK) {
        return status;
    }
    if (base == nullptr || (count > 0 && (candidates == nullptr || support == nullptr))) {
        return ST_NULL_POINTER;
    }
    const Verifier &verifier = tracker->identification.uncounted();
    if (!are_numbers(base, 3, stars->count) ||
        !are_numbers(candidates, 3 * count, verifier.sky.stars)) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    const Supporters others = supporters(verifier.sky.in_cells, stars_of(*stars, *tracker), base,
                                         verifier.tolerance_sigmas);
    for (size_t i = 0; i < count; ++i) {
        const int32_t *three = candidates + 3 * i;
        support[i] = st::support(verifier.sky, others, three[0], three[1], three[2], 0.0);
    }
    return ST_OK;
}

st_status st_verify(st_tracker *tracker, const st_image_stars *stars, const int32_t *base,
                    const int32_t *pattern, size_t based, double tested,
                    st_verification *verification, int32_t *star, double *residual_px,
                    double *residual_rad) {
    const st_status status = check(tracker, stars);
    if (status != ST_OK) {
        return status;
    }
    if (base == nullptr || pattern == nullptr || verification == nullptr || star == nullptr ||
        residual_px == nullptr || residual_rad == nullptr) {
        return ST_NULL_POINTER;
    }
    const Verifier &verifier = tracker->identification.uncounted();
    if (based < 2 || !are_numbers(base, based, stars->count) ||
        !are_numbers(pattern, based, verifier.sky.stars)) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    const ImageStars image = stars_of(*stars, *tracker);
    Verification result = st::verification(image.count, tracker->work);
    verify(tracker->identification.verifier(), image, base, pattern, static_cast<int>(based),
           tested, result, tracker->work);
    publish(*tracker, image, result, *verification, star, residual_px, residual_rad,
            tracker->work);
    return ST_OK;
}

st_status st_verify_quads(st_tracker *tracker, const st_image_stars *stars, const int32_t *base,
                          const int32_t *pattern, size_t count, double least_support,
                          double tested, int32_t *best, double *false_alarm_probability) {
    const st_status status = check(tracker, stars);
    if (status != ST_OK) {
        return status;
    }
    if (best == nullptr || false_alarm_probability == nullptr ||
        (count > 0 && (base == nullptr || pattern == nullptr))) {
        return ST_NULL_POINTER;
    }
    const Verifier &verifier = tracker->identification.uncounted();
    if (!are_numbers(base, QUAD * count, stars->count) ||
        !are_numbers(pattern, QUAD * count, verifier.sky.stars)) {
        return ST_BAD_INPUT;
    }
    const Arena::Scope scope(tracker->work);
    const ImageStars image = stars_of(*stars, *tracker);
    Verification result = verification(image.count, tracker->work);
    *best = -1;
    *false_alarm_probability = 1.0;
    for (size_t i = 0; i < count; ++i) {
        const int32_t *four = base + QUAD * i, *star = pattern + QUAD * i;
        const Supporters others =
            supporters(verifier.sky.in_cells, image, four, verifier.tolerance_sigmas);
        if (!(st::support(verifier.sky, others, star[0], star[1], star[2], least_support) >
              least_support)) {
            continue;
        }
        verify(tracker->identification.verifier(), image, four, star, static_cast<int>(QUAD),
               tested, result, tracker->work);
        if (result.false_alarm < *false_alarm_probability) {
            *best = static_cast<int32_t>(i);
            *false_alarm_probability = result.false_alarm;
        }
    }
    return ST_OK;
}

st_status st_few_stars(st_tracker *tracker, const st_image_stars *stars,
                       const st_triangle_table *table, double false_alarm_max, double most_work_s,
                       st_verification *verification, int32_t *star, double *residual_px,
                       double *residual_rad, double *work_s) {
    const st_status status = check(tracker, stars);
    if (status != ST_OK) {
        return status;
    }
    if (table == nullptr || verification == nullptr || star == nullptr || residual_px == nullptr ||
        residual_rad == nullptr || work_s == nullptr) {
        return ST_NULL_POINTER;
    }
    const Arena::Scope scope(tracker->work);
    const ImageStars image = stars_of(*stars, *tracker);
    Verification best = st::verification(image.count, tracker->work);
    std::fill(best.found.star, best.found.star + image.count, -1);
    std::fill(best.found.residual, best.found.residual + image.count, NAN);
    *work_s = 1e-9 * find_few_stars(tracker->identification.verifier(), *table, image,
                                    false_alarm_max, 1e9 * most_work_s, best, tracker->work);
    publish(*tracker, image, best, *verification, star, residual_px, residual_rad, tracker->work);
    return ST_OK;
}

st_status st_support_in_cells(const st_star_cells *sky, const st_image_stars *stars,
                              double tolerance_sigmas, const int32_t *base, const int32_t *star,
                              size_t count, double least, double *support) {
    if (sky == nullptr || sky->direction == nullptr || sky->start == nullptr ||
        sky->member == nullptr || stars == nullptr ||
        (stars->count > 0 && (stars->direction == nullptr || stars->sigma_rad == nullptr)) ||
        (count > 0 && (base == nullptr || star == nullptr || support == nullptr))) {
        return ST_NULL_POINTER;
    }
    if (sky->cells < 1 || !are_numbers(base, QUAD * count, stars->count) ||
        !are_numbers(star, QUAD * count, sky->stars)) {
        return ST_BAD_INPUT;
    }
    const auto *direction = reinterpret_cast<const float (*)[3]>(sky->direction);
    const Cells cells{sky->cells, sky->start, sky->member};
    ImageStars image{};
    image.count = stars->count;
    image.direction = const_cast<Vector3 *>(vectors(stars->direction));
    image.sigma = const_cast<double *>(stars->sigma_rad);
    for (size_t k = 0; k < count; ++k) {
        const Supporters others = supporters(sky->stars, image, base + QUAD * k, tolerance_sigmas);
        double left = others.sum;
        support[k] = 0.0;
        for (int i = 0; i < others.count && support[k] + left > least; ++i) {
            left -= others.gain[i];
            if (is_supported(cells, direction, others, i, star + QUAD * k)) {
                support[k] += others.gain[i];
            }
        }
    }
    return ST_OK;
}

}  // extern "C"
