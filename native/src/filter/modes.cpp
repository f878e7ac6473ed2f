// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "filter/modes.h"

namespace st {

namespace {

double square(double x) {
    return x * x;
}

}  // namespace

double sum(const Weights &weight) {
    double total = 0.0;
    for (double one : weight.element) {
        total += one;
    }
    return total;
}

Weights normalised(Weights weight) {
    const double total = sum(weight);
    for (double &one : weight.element) {
        one /= total;
    }
    return weight;
}

Weights least_shares(bool in_next_frame) {
    Weights least;
    for (int j = 0; j < MODES; ++j) {
        least[j] = in_next_frame ? MODE[j].least_next : LEAST_SHARE;
    }
    return least;
}

Weights weights_of(const Weights &weight, ModeSet modes) {
    Weights some;
    for (int j = 0; j < MODES; ++j) {
        some[j] = (modes >> j & 1U) != 0 ? weight[j] : 0.0;
    }
    return some;
}

double total_weight(const Weights &weight, ModeSet modes) {
    return sum(weights_of(weight, modes));
}

int most_probable_mode(const Weights &weight) {
    int best = 0;
    for (int j = 1; j < MODES; ++j) {
        best = weight[j] > weight[best] ? j : best;
    }
    return best;
}

Weights by_experience(const Weights &weight, const Weights &share) {
    const Weights next = least_shares(true);
    Weights seen;
    for (int j = 0; j < MODES; ++j) {
        seen[j] = weight[j] * (share[j] + LEAST_SHARE) / (share[j] + next[j]);
    }
    return normalised(seen);
}

double sigmas_of(const Mode &mode, const Vector3 &noise_rad2, double interval_s,
                 const Vector3 &acceleration) {
    if (mode.kind != Kind::STEADY && mode.kind != Kind::JUMP) {
        return mode.size;
    }
    const double largest = larger(larger(acceleration[0], acceleration[1]), acceleration[2]);
    return mode.size * largest * square(interval_s) / std::sqrt(3 * noise_rad2[0]);
}

Vector3 noise_of(const Mode &mode, const Vector3 &noise_rad2, const Vector3 &jumps) {
    Vector3 noise = noise_rad2;
    if (mode.kind == Kind::TORQUE && mode.size >= SUDDEN_SIZE) {
        const double largest = larger(larger(jumps[0], jumps[1]), jumps[2]);
        for (int axis = 0; axis < 3; ++axis) {
            noise[axis] *= larger(jumps[axis] / largest, LEAST_SPREAD * LEAST_SPREAD);
        }
    }
    return noise;
}

Transition transition_of(const Mode &mode, double tau_s, double w2, const Vector3 &noise_rad2,
                         double interval_s, const Vector3 &acceleration) {
    Transition step{identity<3>(), {}};
    Matrix3 &F = step.F;
    const double t = std::fabs(tau_s), t2 = t * t, t3 = t2 * t;
    F[0][1] = tau_s;
    if (mode.kind == Kind::STEADY || mode.kind == Kind::JUMP) {
        F[2][2] = 0.0;
        for (int axis = 0; axis < 3; ++axis) {
            Matrix3 &Q = step.Q[axis];
            const double a2 = square(mode.size * acceleration[axis]), q = a2 * interval_s;
            Q[0][0] = q * t3 / 3;
            Q[0][1] = Q[1][0] = q * tau_s * t / 2;
            Q[1][1] = q * t;
            // It may go on at any of these accelerations.
            Q[2][2] = mode.kind == Kind::JUMP ? a2 : 0.0;
        }
        return step;
    }
    F[0][2] = tau_s * tau_s / 2;
    F[1][2] = tau_s;
    if (mode.kind == Kind::SWING && w2 > 0) {
        const double w = std::sqrt(w2), sine = std::sin(w * tau_s), cosine = std::cos(w * tau_s);
        F = {{{1.0, sine / w, (1 - cosine) / w2},
              {0.0, cosine, sine / w},
              {0.0, -w * sine, cosine}}};
    }
    const double interval2 = interval_s * interval_s;
    for (int axis = 0; axis < 3; ++axis) {
        Matrix3 &Q = step.Q[axis];
        const double q =
            mode.size * mode.size * noise_rad2[axis] * 20 / (interval2 * interval2 * interval_s);
        Q[0][0] = q * t3 * t2 / 20;
        Q[1][1] = q * t3 / 3;
        Q[2][2] = q * t;
        Q[0][1] = Q[1][0] = q * t3 * tau_s / 8;
        Q[0][2] = Q[2][0] = q * t3 / 6;
        Q[1][2] = Q[2][1] = q * t * tau_s / 2;
    }
    return step;
}

Vector3 turn_of(const double *mean, Kind kind, double tau_s, const Swing &swing) {
    const Vector3 rate = part(mean, RATE), acceleration = part(mean, ACCELERATION);
    if (kind == Kind::STEADY || kind == Kind::JUMP) {
        return scaled(rate, tau_s);
    }
    if (kind == Kind::TORQUE || swing.w2 == 0) {
        return scaled(rate + scaled(acceleration, tau_s / 2), tau_s);
    }
    const double w = std::sqrt(swing.w2);
    return scaled(swing.centre, tau_s) + scaled(rate - swing.centre, std::sin(w * tau_s) / w) +
           scaled(acceleration, (1 - std::cos(w * tau_s)) / swing.w2);
}

void carry_mean(double *mean, const Matrix3 &F, Kind kind, const Swing &swing) {
    const bool swings = kind == Kind::SWING && swing.w2 > 0;
    for (int i = 0; i < 3; ++i) {
        const double middle = swings ? swing.centre[i] : 0.0;
        const double rate = mean[RATE + i] - middle, more = mean[ACCELERATION + i];
        mean[TURN + i] = 0.0;
        mean[RATE + i] = F[1][1] * rate + F[1][2] * more + middle;
        mean[ACCELERATION + i] = F[2][1] * rate + F[2][2] * more;
    }
}

}  // namespace st
