// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Orbits of startracker_ground.h.

#include <cmath>

#include "maths/matrix.h"
#include "startracker_ground.h"

using namespace st;

namespace {

/// Return velocity and acceleration of a state (position, velocity).
///
/// Vallado, Fundamentals of Astrodynamics, equation 8-50:
/// a_i = -mu / r^3 r_i (1 + 3/2 J2 (R / r)^2 (c_i - 5 z^2 / r^2)), c = (1, 1, 3).
Vector<6> derivative(const Vector<6> &state, const st_gravity &gravity) {
    const double r2 = dot(first<3>(state), first<3>(state));
    const double mu_r3 = gravity.mu_m3_s2 / (r2 * std::sqrt(r2));
    const double j2_term = 1.5 * gravity.j2 * gravity.radius_m * gravity.radius_m / r2;
    const double z_term = 5 * state[2] * state[2] / r2;
    Vector<6> change;
    for (int i = 0; i < 3; ++i) {
        change[i] = state[3 + i];
        change[3 + i] = -mu_r3 * state[i] * (1 + j2_term * ((i == 2 ? 3 : 1) - z_term));
    }
    return change;
}

}  // namespace

extern "C" {

void st_propagate_orbit(const st_gravity *gravity, double step_s, int32_t steps, double state[6]) {
    Vector<6> now;
    for (int i = 0; i < 6; ++i) {
        now[i] = state[i];
    }
    for (int step = 0; step < steps; ++step) {
        // Classical Runge-Kutta, fourth order.
        const auto k1 = derivative(now, *gravity);
        const auto k2 = derivative(now + scaled(k1, step_s / 2), *gravity);
        const auto k3 = derivative(now + scaled(k2, step_s / 2), *gravity);
        const auto k4 = derivative(now + scaled(k3, step_s), *gravity);
        now = now + scaled(k1 + scaled(k2 + k3, 2.0) + k4, step_s / 6);
    }
    for (int i = 0; i < 6; ++i) {
        state[i] = now[i];
    }
}

}  // extern "C"
