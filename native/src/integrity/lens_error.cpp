// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/lens_error.h"

#include <cmath>

#include "integrity/checks.h"
#include "integrity/residual_columns.h"

namespace st {
namespace {

using namespace checks;

constexpr double MEMORY = 0.98;  // of the sums of the frames before
constexpr int ROTATION = 3, OF_RESIDUAL = ROTATION, OF_AWAY = ROTATION + 1, COLUMNS = ROTATION + 2;

/// A star without the rotation of all: residual and distance from the axis, px, the share that the
/// residual holds of the variance of errors that are as large for all stars, and the variance of the
/// centroid, px^2.
struct StarSums {
    Point residual, away;
    double left, variance;
};

/// r^T W d and d^T W d of residuals r and distances d from the axis, W = 1 / sigma^2.
struct LensSums {
    double outwards, square;
};

/// Fill in the residuals of stars without their rotation.
LensSums lens_sums(const Lens &lens, const DetectedStar *stars, int count, StarSums *sums,
                   Arena &arena) {
    const Arena::Scope scope(arena);
    const int rows = 2 * count;
    double *columns = arena.take<double>(static_cast<size_t>(COLUMNS * rows));
    for (int i = 0; i < count; ++i) {
        const DetectedStar &star = stars[i];
        sums[i].variance = (star.error.uu + star.error.vv) / 2;
        const double root = 1 / std::sqrt(sums[i].variance);
        const double residual[2] = {star.residual.x, star.residual.y};
        const double away[2] = {star.uv.x - lens.cx, star.uv.y - lens.cy};
        for (int axis = 0; axis < 2; ++axis) {
            const int row = 2 * i + axis;
            for (int k = 0; k < ROTATION; ++k) {
                columns[k * rows + row] = star.flow[axis][k] * root;
            }
            columns[OF_RESIDUAL * rows + row] = residual[axis] * root;
            columns[OF_AWAY * rows + row] = away[axis] * root;
        }
    }
    remove_first(columns, COLUMNS, rows, ROTATION);
    const double *white = columns + OF_RESIDUAL * rows, *outward = columns + OF_AWAY * rows;
    // Diagonal of A A^T with A = I - s Q Q^T / s and the standard deviations s.
    Matrix3 Q{};
    for (int row = 0; row < rows; ++row) {
        for (int k = 0; k < ROTATION; ++k) {
            for (int m = 0; m < ROTATION; ++m) {
                Q[k][m] +=
                    columns[k * rows + row] * columns[m * rows + row] / sums[row / 2].variance;
            }
        }
    }
    for (int i = 0; i < count; ++i) {
        const double sigma = std::sqrt(sums[i].variance);
        sums[i].residual = {white[2 * i] * sigma, white[2 * i + 1] * sigma};
        sums[i].away = {outward[2 * i] * sigma, outward[2 * i + 1] * sigma};
        sums[i].left = 1.0;
        for (int row = 2 * i; row < 2 * i + 2; ++row) {
            for (int k = 0; k < ROTATION; ++k) {
                const double q = columns[k * rows + row];
                sums[i].left -= q * q;
                for (int m = 0; m < ROTATION; ++m) {
                    sums[i].left += q * Q[k][m] * columns[m * rows + row] * sums[i].variance / 2;
                }
            }
        }
    }
    return {inner(white, outward, rows), inner(outward, outward, rows)};
}

/// Return the scale k = r^T W d / d^T W d, zero where it is not significant.
double relative_scale(double outwards, double square) {
    return outwards * outwards > LENS_ERROR.threshold * square ? outwards / square : 0.0;
}

/// Add pairs of residuals, in addition to a change of the scale, of stars in this frame and in
/// the last one, which this frame then is.
///
/// Of a star in both frames the mean product of two axes, p = r_k . r_k-1 / 2, has the weight
/// w = 1 / (v_k v_k-1), and by chance the variance w / 2 of w p.
void add_pairs(const int32_t *star, const StarSums *sums, int count, double change,
               LensError &error, RememberedStar *now) {
    double product = 0.0, weight = 0.0, chance = 0.0;
    bool any = false;
    for (int i = 0; i < count; ++i) {
        const StarSums &s = sums[i];
        now[i] = {star[i],
                  {s.residual.x - change * s.away.x, s.residual.y - change * s.away.y},
                  s.variance};
        for (int k = 0; k < error.remembered; ++k) {
            const RememberedStar &before = error.last[k];
            if (before.star != star[i]) {
                continue;
            }
            const double w = 1 / (s.variance * before.variance_px2);
            product +=
                w *
                (now[i].residual.x * before.residual.x + now[i].residual.y * before.residual.y) /
                2;
            weight += w * s.left;
            chance += w / 2;
            any = true;
        }
    }
    const double fade = any ? MEMORY : 1.0;
    error.product = fade * error.product + product;
    error.weight = fade * error.weight + weight;
    error.chance = fade * fade * error.chance + chance;
    error.remembered = count < MOST_REMEMBERED ? count : MOST_REMEMBERED;
    for (int i = 0; i < error.remembered; ++i) {
        error.last[i] = now[i];
    }
}

}  // namespace

bool add_frame(const Lens &lens, const int32_t *star, const DetectedStar *stars, int count,
               LensError &error, Arena &arena) {
    if (count < limit(LENS_ERROR, "stars")) {
        return false;
    }
    const Arena::Scope scope(arena);
    const auto n = static_cast<size_t>(count);
    StarSums *sums = arena.take<StarSums>(n);
    const LensSums all = lens_sums(lens, stars, count, sums, arena);
    // The residuals are those in addition to the scale before, outwards is that of all of it.
    const double before = error.scale;
    error.outwards = MEMORY * error.outwards + all.outwards + before * all.square;
    error.square = MEMORY * error.square + all.square;
    const double scale = relative_scale(error.outwards, error.square);
    add_pairs(star, sums, count, scale - before, error, arena.take<RememberedStar>(n));
    const bool significant = error.product > sigmas(LENS_ERROR) * std::sqrt(error.chance);
    error.value_px = significant ? std::sqrt(error.product / error.weight) : 0.0;
    // The attitude of this frame is by the scale of the one before.
    error.scale_sigma = std::hypot(scale - before, scale != 0 ? 1 / std::sqrt(error.square) : 0.0);
    error.scale = scale;
    return scale != before && before == 0;
}

Lens corrected_lens(const Lens &lens, const LensError &error) {
    Lens corrected = lens;
    corrected.fx = (1 + error.scale) * lens.fx;
    corrected.fy = (1 + error.scale) * lens.fy;
    return corrected;
}

size_t lens_error_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return Arena::padded<StarSums>(n) + Arena::padded<RememberedStar>(n) +
           Arena::padded<double>(n * 2 * COLUMNS);
}

}  // namespace st
