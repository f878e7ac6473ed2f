// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "identify/verification.h"

#include <algorithm>
#include <cmath>

#include "identify/false_alarm.h"
#include "identify/lens_mismatch.h"
#include "maths/sorting.h"
#include "sky/near.h"

namespace st {
namespace {

constexpr int CORNERS = 33;  // along each side of the image, of the cells whose angles are added
// A field of view wider than nominal contains stars from a little beyond.
constexpr double WIDER = 1.1;

/// Return the solid angle of the image in sr, or of its circle: a wide lens shows less than its
/// area.
double solid_angle(const Lens &lens) {
    Vector3 above[CORNERS], row[CORNERS];
    double sum = 0.0;
    for (int j = 0; j < CORNERS; ++j) {
        for (int i = 0; i < CORNERS; ++i) {
            row[i] = unproject(lens, {-0.5 + lens.width * (i / (CORNERS - 1.0)),
                                      -0.5 + lens.height * (j / (CORNERS - 1.0))});
        }
        for (int i = 0; j > 0 && i + 1 < CORNERS; ++i) {
            Vector3 across, down;
            for (int k = 0; k < 3; ++k) {
                across[k] = above[i + 1][k] - above[i][k];
                down[k] = row[i][k] - above[i][k];
            }
            const double cell = norm(cross(across, down));
            sum += std::isnan(cell) ? 0.0 : cell;
        }
        std::copy(row, row + CORNERS, above);
    }
    return sum;
}

}  // namespace

Field field_of(const Lens &lens) {
    const double right = lens.width - 0.5, bottom = lens.height - 0.5;
    const double u = (right - 0.5) / 2, v = (bottom - 0.5) / 2, circle = lens.farthest_rad;
    const auto border = [circle](double edge, double sign) {
        return std::isnan(edge) ? sign * circle : edge;
    };
    return {border(undistorted(lens, {-0.5, v}).x, -1),
            border(undistorted(lens, {right, v}).x, 1),
            border(undistorted(lens, {u, -0.5}).y, -1),
            border(undistorted(lens, {u, bottom}).y, 1),
            2 * std::sin(std::fmin(WIDER * corner_angle(lens), M_PI) / 2),
            lens.width * lens.height / (lens.fx * lens.fy),
            solid_angle(lens)};
}

void count_fields(Verifier &verifier) {
    const Patterns &sky = verifier.sky;
    // Archimedes: the cap of a sphere has the area of a disc whose radius is its chord.
    const double chord = std::fmin(std::sqrt(verifier.field.solid_angle / M_PI), 2.0);
    const double golden = M_PI * (3 - std::sqrt(5.0));
    // Wide fields overlap: more of them tell nothing new.
    const double wide = SAMPLES_OF_STAR * 4 * M_PI / verifier.field.solid_angle;
    const auto samples = static_cast<int>(std::fmin(std::ceil(wide), MOST_SAMPLES));
    verifier.samples = samples;
    for (int i = 0; i < samples; ++i) {
        // Evenly over the sphere, on a spiral of the golden angle.
        const double z = 1 - (2 * i + 1.0) / samples, r = std::sqrt(1 - z * z);
        const Vector3 centre{{r * std::cos(golden * i), r * std::sin(golden * i), z}};
        int32_t count = 0;
        visit_near(sky.cells, centre, chord, [&](int32_t star) {
            const double *d = sky.direction[star];
            const double dx = d[0] - centre[0], dy = d[1] - centre[1], dz = d[2] - centre[2];
            count += dx * dx + dy * dy + dz * dz <= chord * chord;
        });
        verifier.counts[i] = count;
    }
    sort_ascending(verifier.counts, samples);
}

int count_in_image(const Verifier &verifier, const StarMatch &found, int32_t brightest) {
    const Field &field = verifier.field;
    const Matrix3 &R = found.R;
    const double low_a = field.low_a / found.focal_ratio,
                 high_a = field.high_a / found.focal_ratio;
    const double low_b = field.low_b / found.focal_ratio,
                 high_b = field.high_b / found.focal_ratio;
    int stars = 0;
    visit_near(verifier.sky.cells, {{R[0][2], R[1][2], R[2][2]}}, field.chord, [&](int32_t star) {
        if (star >= brightest) {
            return;
        }
        const Point at = seen_at(verifier.equidistant, R, verifier.sky.direction[star]);
        // NaN is in no range.
        stars += low_a <= at.x && at.x <= high_a && low_b <= at.y && at.y <= high_b;
    });
    return stars;
}

Verification verification(int most, Arena &arena) {
    return {1.0, star_match(most, arena)};
}

void copy(const Verification &from, int count, Verification &to) {
    to.false_alarm = from.false_alarm;
    copy(from.found, count, to.found);
}

void verify(const Verifier &verifier, const ImageStars &stars, const int32_t *base,
            const int32_t *star, int based, double tested, Verification &result, Arena &work) {
    const Arena::Scope scope(work);
    StarMatch &found = result.found;
    const double sigma = stars.median_sigma, r = verifier.tolerance_sigmas * sigma;
    const double area = verifier.field.area;
    result.false_alarm = 1.0;
    if (!align(verifier.sky, verifier.equidistant, stars, base, star, based, r,
               verifier.scale_error, found, work)) {
        return;
    }
    const int in_field = count_in_image(verifier, found, verifier.sky.stars);
    auto *brightest = work.take<bool>(static_cast<size_t>(stars.count));
    const int cells = occupied_cells(stars, found.star, area, CELLS_ACROSS, brightest, work);
    const auto marked = static_cast<int>(std::count(brightest, brightest + stars.count, true));
    // The stars of the base are not evidence for it.
    const int m = std::max(marked - based, 0), n = std::max(cells - based, m);
    const double p = std::fmin(1.0, std::max(in_field, 1) * M_PI * r * r / area);
    const int32_t *counts = verifier.counts;
    const auto not_richer = std::max<ptrdiff_t>(
        std::upper_bound(counts, counts + verifier.samples, in_field) - counts, 1);
    for (int i = 0; verifier.bases_by_brightness && i < based; ++i) {
        brightest[base[i]] = false;
    }
    const double product = binomial_tail(m, n, p) *
                           (static_cast<double>(not_richer) / verifier.samples) *
                           order_probability(found.star, brightest, stars.count) *
                           residual_probability(found.residual, stars.count, r, based);
    result.false_alarm = std::fmin(1.0, std::fmax(tested, 1.0) * fisher_combined(product));
    if (result.false_alarm < 1 && verifier.lens_known &&
        lens_mismatch(verifier.sky, verifier.equidistant, stars, found, r, sigma, m, p)) {
        result.false_alarm = 1.0;
    }
}

bool same_attitude(const StarMatch &a, const StarMatch &b, int count) {
    int shared = 0;
    for (int i = 0; i < count; ++i) {
        shared += a.star[i] >= 0 && a.star[i] == b.star[i];
    }
    return shared >= 2;
}

size_t verification_bytes(int most) {
    const auto capacity = static_cast<size_t>(most);
    return Arena::padded<bool>(capacity) + Arena::padded<int32_t>(capacity) +
           3 * Arena::padded<Point>(capacity) + 2 * Arena::padded<Vector3>(capacity) +
           Arena::padded<double>(capacity);
}

}  // namespace st
