// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "integrity/row_pattern.h"

#include <cmath>

#include "integrity/checks.h"
#include "integrity/residual_columns.h"
#include "maths/sorting.h"

namespace st {
namespace {

using namespace checks;

constexpr double MEMORY = 0.98;  // of the slopes of the frames before
constexpr int ROTATION = 3, REMOVED = 5, PATTERNS = 1 + STEPS;
/// Stars at either end that are not beyond a step.
constexpr int BEYOND = 3;
/// Of a column that is a pattern: that of stars that do not move is zero.
constexpr double LEAST_ENERGY = 1e-12;

double greater(double a, double b) {
    return a > b ? a : b;
}

/// Return the pattern with the largest (c^T r)^2 / c^T c; the first that is NaN.
int strongest(const RowFit &fit) {
    int best = 0;
    double most = -1.0;
    for (int k = 0; k < PATTERNS; ++k) {
        const double gain = fit.product[k] * fit.product[k] / greater(fit.energy[k], LEAST_ENERGY);
        if (std::isnan(gain)) {
            return k;
        }
        if (gain > most) {
            best = k;
            most = gain;
        }
    }
    return best;
}

double mean_square_speed(const DetectedStar *stars, int count) {
    double sum = 0.0;
    for (int i = 0; i < count; ++i) {
        const Point &v = stars[i].velocity;
        sum += v.x * v.x + v.y * v.y;
    }
    return sum / (2 * count);
}

}  // namespace

RowFit fit_rows(const Lens &lens, const DetectedStar *stars, int count, Arena &arena) {
    const Arena::Scope scope(arena);
    const int height = lens.height, rows = 2 * count, of_residual = REMOVED;
    const auto n = static_cast<size_t>(count);
    double *place = arena.take<double>(n), *ordered = arena.take<double>(n);
    for (int i = 0; i < count; ++i) {
        place[i] = (stars[i].uv.y - (height - 1) / 2.0) / height;
        insert_sorted(ordered, i, place[i]);
    }
    RowFit fit;
    const int inside = count - 2 * BEYOND;
    for (int k = 0; k < STEPS; ++k) {
        fit.edge[k] = ordered[BEYOND + k * (inside - 1) / (STEPS - 1)];
    }
    double *columns = arena.take<double>(n * 2 * (REMOVED + 1 + PATTERNS));
    const auto column = [&](int k, int star) { return columns + k * rows + 2 * star; };
    for (int i = 0; i < count; ++i) {
        const DetectedStar &star = stars[i];
        const Covariance2 &R = star.error;
        const double du = (star.uv.x - lens.cx) / height, dv = (star.uv.y - lens.cy) / height;
        const double square = du * du + dv * dv;
        for (int k = 0; k < ROTATION; ++k) {
            whiten(R, star.flow[0][k], star.flow[1][k], column(k, i));
        }
        whiten(R, du, dv, column(3, i));
        whiten(R, du * square, dv * square, column(4, i));
        whiten(R, star.residual.x, star.residual.y, column(of_residual, i));
        const Point &f = star.velocity;
        whiten(R, f.x * place[i], f.y * place[i], column(of_residual + 1, i));
        for (int k = 0; k < STEPS; ++k) {
            const double side = place[i] > fit.edge[k] ? 0.5 : -0.5;
            whiten(R, f.x * side, f.y * side, column(of_residual + 2 + k, i));
        }
    }
    remove_first(columns, REMOVED + 1 + PATTERNS, rows, REMOVED);
    const double *r = column(of_residual, 0);
    for (int k = 0; k < PATTERNS; ++k) {
        const double *c = column(of_residual + 1 + k, 0);
        fit.product[k] = inner(c, r, rows);
        fit.energy[k] = inner(c, c, rows);
    }
    fit.chi2 = inner(r, r, rows);
    return fit;
}

size_t row_fit_bytes(int count) {
    const auto n = static_cast<size_t>(count);
    return 2 * Arena::padded<double>(n) + Arena::padded<double>(n * 2 * (REMOVED + 1 + PATTERNS));
}

st_reason find_pattern(const Lens &lens, const DetectedStar *stars, int count, RowPattern &memory,
                       Arena &arena) {
    if (count < limit(TORN_FRAME, "stars")) {
        return {};
    }
    const RowFit fit = fit_rows(lens, stars, count, arena);
    const int best = strongest(fit), height = lens.height;
    const double product = fit.product[best], energy = greater(fit.energy[best], LEAST_ENERGY);
    const double line = fit.product[0], line_energy = greater(fit.energy[0], LEAST_ENERGY);
    const double chi2 = fit.chi2, dof = greater(2 * count - 6, 1);
    const double speed_px_s = std::sqrt(2 * mean_square_speed(stars, count));
    const double gain = product * product / energy;
    const double scatter = greater(1.0, (chi2 - line * line / line_energy) / dof);
    memory.product = MEMORY * memory.product + line / scatter;
    memory.energy = MEMORY * memory.energy + line_energy / scatter;
    memory.excess = MEMORY * memory.excess + (chi2 - dof) / scatter;
    const double shift_s = product / energy;
    if (best > 0 && gain > TORN_FRAME.threshold * greater(1.0, (chi2 - gain) / dof) &&
        gain > limit(TORN_FRAME, "explained_share") * chi2 &&
        std::fabs(shift_s) * speed_px_s > limit(TORN_FRAME, "step_px")) {
        return reason_of(TORN_FRAME, {(fit.edge[best - 1] + 0.5) * height, shift_s});
    }
    ++memory.frames;
    const st_check &check = memory.frames <= FIRST_LINE_TIME.frames ? FIRST_LINE_TIME : LINE_TIME;
    const double line_s = memory.product / memory.energy / height;
    const double explained = memory.product * memory.product / memory.energy;
    if (explained > check.threshold &&
        std::fabs(line_s) * height * speed_px_s > limit(LINE_TIME, "slope_px") &&
        explained > limit(LINE_TIME, "explained_share") * memory.excess) {
        return reason_of(check, {1e6 * line_s});
    }
    return {};
}

}  // namespace st
