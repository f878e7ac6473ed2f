// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "filter/motion.h"

#include <cmath>

#include "filter/modes.h"

namespace st {

namespace {

constexpr double FIRST_FRAMES = 5.0;  // that the shares are the means of
constexpr double FIRST_JUMP = SUDDEN_SIZE * SUDDEN_SIZE;
constexpr double FIRST_ACCELERATION = M_PI / 180;  // rad/s^2, 1 sigma, before the first frame

}  // namespace

template <int MOST>
void start_motion(const StateWith<MOST> &state, const double *constants, const Vector3 &noise_rad2,
                  double interval_s, MotionWith<MOST> &motion) {
    motion.stamp_ns = state.stamp_ns;
    motion.quaternion = state.quaternion;
    motion.constants = state.constants;
    motion.noise_rad2 = noise_rad2;
    motion.interval_s = interval_s;
    motion.frames = FIRST_FRAMES;
    motion.jumps = {{FIRST_JUMP, FIRST_JUMP, FIRST_JUMP}};
    motion.seen_jumps = 1.0;
    motion.swing = {};
    interrupt_motion(motion);
    for (int j = 0; j < MODES; ++j) {
        motion.share[j] = MODE[j].first_share;
        ModeState<MOST> &mode = motion.mode[j];
        mode = {};
        for (int k = 0; k < 3; ++k) {
            mode.mean[RATE + k] = state.rate_rad_s[k];
            mode.mean[DRIFT + k] = state.drift_rad_s[k];
        }
        for (int k = 0; k < state.constants.count; ++k) {
            mode.mean[CONSTANT + k] = constants[k];
        }
        for (int i = 0; i < state.size(); ++i) {
            for (int k = 0; k < state.size(); ++k) {
                mode.covariance[of_mode(i)][of_mode(k)] = state.covariance[i][k];
            }
        }
        if (MODE[j].kind == Kind::TORQUE || MODE[j].kind == Kind::SWING) {
            for (int k = ACCELERATION; k < DRIFT; ++k) {
                mode.covariance[k][k] = FIRST_ACCELERATION * FIRST_ACCELERATION;
            }
        }
    }
    motion.weight = motion.share = normalised(motion.share);
}

template <int MOST>
void restart_motion(const StateWith<MOST> &state, MotionWith<MOST> &motion) {
    double constants[MOST + 1] = {};
    for (int k = 0; k < motion.constants.count; ++k) {
        for (int j = 0; j < MODES; ++j) {
            constants[k] += motion.weight[j] * motion.mode[j].mean[CONSTANT + k];
        }
    }
    for (ModeState<MOST> &mode : motion.mode) {
        for (int k = 0; k < 3; ++k) {
            mode.mean[TURN + k] = 0.0;
            mode.mean[RATE + k] = state.rate_rad_s[k];
            mode.mean[DRIFT + k] = state.drift_rad_s[k];
        }
        for (int k = 0; k < motion.constants.count; ++k) {
            mode.mean[CONSTANT + k] = constants[k];
        }
        for (int i = 0; i < state.size(); ++i) {
            for (int k = 0; k < 3; ++k) {
                mode.covariance[ACCELERATION + k][of_mode(i)] = 0.0;
                mode.covariance[of_mode(i)][ACCELERATION + k] = 0.0;
            }
            for (int k = 0; k < state.size(); ++k) {
                mode.covariance[of_mode(i)][of_mode(k)] = state.covariance[i][k];
            }
        }
    }
    motion.stamp_ns = state.stamp_ns;
    motion.quaternion = state.quaternion;
    motion.weight = motion.share;
}

template <int MOST>
void resume_motion(const MotionWith<MOST> &known, MotionWith<MOST> &motion) {
    motion.weight = known.weight;
    motion.share = known.share;
    motion.noise_rad2 = known.noise_rad2;
    motion.interval_s = known.interval_s;
    motion.frames = known.frames;
    motion.jumps = known.jumps;
    motion.seen_jumps = known.seen_jumps;
    motion.swing = known.swing;
}

template <int MOST>
void interrupt_motion(MotionWith<MOST> &motion) {
    motion.swing.last = {NAN, NAN, NAN, NAN};
    motion.swing.turn = motion.swing.change = motion.swing.older = {{NAN, NAN, NAN}};
}

template <int MOST>
StateWith<MOST> state_of(const MotionWith<MOST> &motion, const Weights &weight) {
    ModeState<MOST> mixture;
    mix(weight, motion.mode, motion.size(), mixture);
    StateWith<MOST> state;
    state.stamp_ns = motion.stamp_ns;
    state.constants = motion.constants;
    state.quaternion = turned(motion.quaternion, part(mixture.mean.element, TURN));
    state.rate_rad_s = part(mixture.mean.element, RATE);
    state.drift_rad_s = part(mixture.mean.element, DRIFT);
    for (int i = 0; i < state.size(); ++i) {
        for (int k = 0; k < state.size(); ++k) {
            state.covariance[i][k] = mixture.covariance[of_mode(i)][of_mode(k)];
        }
    }
    return state;
}

template <int MOST>
void constants_of(const MotionWith<MOST> &motion, const Weights &weight, double *constants) {
    const double total = sum(weight);
    for (int k = 0; k < motion.constants.count; ++k) {
        constants[k] = 0.0;
        for (int j = 0; j < MODES; ++j) {
            if (weight[j] > 0) {
                constants[k] += weight[j] / total * motion.mode[j].mean[CONSTANT + k];
            }
        }
    }
}

template <int MOST>
Vector3 acceleration_of(const MotionWith<MOST> &motion) {
    Vector3 acceleration{};
    for (int j = 0; j < MODES; ++j) {
        acceleration = acceleration +
                       scaled(part(motion.mode[j].mean.element, ACCELERATION), motion.weight[j]);
    }
    return acceleration;
}

// --- for a single tracker, and for several heads ---

#define ST_MOTION_OF(MOST)                                                                       \
    template void start_motion(const StateWith<MOST> &, const double *, const Vector3 &, double, \
                               MotionWith<MOST> &);                                              \
    template void restart_motion(const StateWith<MOST> &, MotionWith<MOST> &);                   \
    template void resume_motion(const MotionWith<MOST> &, MotionWith<MOST> &);                   \
    template void interrupt_motion(MotionWith<MOST> &);                                          \
    template StateWith<MOST> state_of(const MotionWith<MOST> &, const Weights &);                \
    template void constants_of(const MotionWith<MOST> &, const Weights &, double *);             \
    template Vector3 acceleration_of(const MotionWith<MOST> &);

ST_MOTION_OF(0)
ST_MOTION_OF(MOST_CONSTANTS)

}  // namespace st
