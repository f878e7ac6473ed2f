// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "kernels_identify.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "identify/false_alarm.h"
#include "identify/lens_mismatch.h"
#include "identify/search.h"
#include "tracker.h"

using namespace st;

namespace {

Matrix3 matrix_of(const double *rows) {
    Matrix3 R;
    std::copy(rows, rows + 9, &R.row[0][0]);
    return R;
}

ImageStars stars_of(const st_image_stars &given, st_tracker &tracker) {
    ImageStars stars = image_stars(given.count, tracker.work);
    stars.count = given.count;
    for (int i = 0; i < given.count; ++i) {
        const double *direction = given.direction + ptrdiff_t{3} * i;
        stars.direction[i] = {{direction[0], direction[1], direction[2]}};
        stars.sigma[i] = given.sigma_rad[i];
    }
    complete(tracker.identification.lens().equidistant, stars, tracker.work);
    return stars;
}

}  // namespace

extern "C" {

double stt_binomial_tail(int32_t m, int32_t n, double p) {
    return binomial_tail(m, n, p);
}

double stt_fisher_combined(double product) {
    return fisher_combined(product);
}

int32_t stt_least_matches(int32_t n, double p, double share, int32_t base, double tolerance_sigmas,
                          double tested, double most) {
    return least_matches(n, p, share, base, tolerance_sigmas, tested, most);
}

int32_t stt_lens_mismatch(const st_tracker *tracker, const double *seen, const int32_t *star,
                          const double *residual, int32_t count, double radius, double sigma,
                          int32_t m, double p) {
    const Verifier &verifier = tracker->identification.uncounted();
    auto *places = const_cast<Point *>(reinterpret_cast<const Point *>(seen));
    const ImageStars stars{count, nullptr, nullptr, places, nullptr, sigma};
    const StarMatch found{const_cast<int32_t *>(star), const_cast<double *>(residual), 1.0,
                          identity<3>()};
    return lens_mismatch(verifier.sky, verifier.equidistant, stars, found, radius, sigma, m, p);
}

void stt_range(const double *values, const int32_t *below, int32_t count, double low, double high,
               int32_t range[2]) {
    Pairs pairs{0, count, nullptr, nullptr, values, below, nullptr, nullptr, 0.0, 1.0};
    set_steps(pairs);
    const PairRange found = pairs_between(pairs, low, high);
    range[0] = found.first;
    range[1] = found.end;
}

double stt_triangles(st_tracker *tracker, const st_image_stars *stars, const int32_t base[3],
                     double most_ns, int32_t *best, int32_t *count) {
    const Arena::Scope scope(tracker->work);
    const Verifier &verifier = tracker->identification.uncounted();
    const Pairs &pairs = verifier.sky.pairs;
    auto *latest =
        static_cast<int32_t *>(std::malloc(static_cast<size_t>(pairs.stars) * sizeof(int32_t)));
    std::fill(latest, latest + pairs.stars, -1);
    TriangleSearch search;
    search.begin(verifier, stars_of(*stars, *tracker), base, latest);
    Work work{0.0, INFINITY, most_ns};
    double tested = 0.0;
    search.proceed(verifier, pairs, work, tested);
    *count = search.count();
    for (int row = 0; row < *count; ++row) {
        std::copy(search.candidate(row), search.candidate(row) + 3, best + ptrdiff_t{3} * row);
    }
    std::free(latest);
    return tested;
}

int32_t stt_triangle_order(st_tracker *tracker, const st_image_stars *stars, int32_t *triangle,
                           int32_t most) {
    const Arena::Scope scope(tracker->work);
    const Verifier &verifier = tracker->identification.uncounted();
    const ImageStars image = stars_of(*stars, *tracker);
    const size_t bytes = TriangleOrder::bytes(image.count);
    void *memory = std::aligned_alloc(ALIGNMENT, bytes);
    Arena arena(memory, bytes);
    TriangleOrder order(image.count, arena);
    order.begin(image.count);
    int32_t count = 0;
    while (count < most && order.next(verifier.sky.pairs, image, verifier.side_sigmas,
                                      verifier.scale_error, triangle + ptrdiff_t{3} * count) > 0) {
        ++count;
    }
    std::free(memory);
    return count;
}

int32_t stt_is_searched(st_tracker *tracker, double median_sigma, int32_t count, double looked_up,
                        double cost_ns, double tested, double false_alarm_max) {
    return is_searched(tracker->identification.verifier(), median_sigma, count, looked_up, cost_ns,
                       tested, false_alarm_max);
}

int32_t stt_stars_in_image(const st_tracker *tracker, const double matrix[9]) {
    const StarMatch found{nullptr, nullptr, 1.0, matrix_of(matrix)};
    const Verifier &verifier = tracker->identification.uncounted();
    return count_in_image(verifier, found, verifier.sky.stars);
}

}  // extern "C"
