// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/streak.h"

namespace st {
namespace {

constexpr double CLOSE_SHARE = 0.3;  // of the length,
constexpr double CLOSE_PX = 0.5;     // by which the estimates of one streak differ

}  // namespace

bool Streak::is_close(const Streak &other) const {
    const double same = std::hypot(u_px - other.u_px, v_px - other.v_px);
    const double opposite = std::hypot(u_px + other.u_px, v_px + other.v_px);
    return std::fmin(same, opposite) < std::fmax(CLOSE_SHARE * length_px(), CLOSE_PX);
}

Streak Streak::joined(const Streak &other) const {
    // The moments [a b; b c] have eigenvalues that differ by hypot(a - c, 2 b), and the axis of the
    // greater one has the angle atan2(2 b, a - c) / 2.
    const double a = u_px * u_px + other.u_px * other.u_px;
    const double b = u_px * v_px + other.u_px * other.v_px;
    const double c = v_px * v_px + other.v_px * other.v_px;
    const double length = std::sqrt(std::hypot(a - c, 2 * b));
    const double angle = std::atan2(2 * b, a - c) / 2;
    const double u = length * std::cos(angle), v = length * std::sin(angle);
    Streak longer = length_px() >= other.length_px() ? *this : other;
    const double along = u * longer.u_px + v * longer.v_px;
    const double sign = along > 0 ? 1.0 : along < 0 ? -1.0 : 0.0;
    longer.u_px = sign * u;
    longer.v_px = sign * v;
    return longer;
}

Streak fit_streak(const Place *places, const Place *streaks, const double *weight, int count,
                  int width, int height) {
    const double v0 = (height - 1) / 2.0, u0 = (width - 1) / 2.0;
    double total = 0.0, mean_u = 0.0, mean_v = 0.0, shift_u = 0.0, shift_v = 0.0;
    for (int i = 0; i < count; ++i) {
        total += weight[i];
        mean_u += weight[i] * places[i].u;
        mean_v += weight[i] * places[i].v;
        shift_u += weight[i] * streaks[i].u;
        shift_v += weight[i] * streaks[i].v;
    }
    mean_u /= total;
    mean_v /= total;
    shift_u /= total;
    shift_v /= total;
    // About the mean of the stars the roll is independent of the shift.
    double spread = 0.0, moment = 0.0;
    for (int i = 0; i < count; ++i) {
        const double u = places[i].u - mean_u, v = places[i].v - mean_v;
        spread += weight[i] * (u * u + v * v);
        moment += weight[i] * (u * (streaks[i].v - shift_v) - v * (streaks[i].u - shift_u));
    }
    const double roll = count >= 4 && spread > 0 ? moment / spread : 0.0;
    return {shift_u + roll * (mean_v - v0), shift_v - roll * (mean_u - u0), roll, u0, v0};
}

}  // namespace st
