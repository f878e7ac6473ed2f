// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The motion of the body: an interacting multiple model filter of attitude and rate.
//
// The stars of a frame measure the attitude; how the body moves on is not known. Several Kalman
// filters run side by side, one for each mode of motion, and are mixed as by Blom and Bar-Shalom
// (IEEE Trans. Autom. Control 33, 1988). With the probability mu_i of mode i and the probability
// p_ij of a change from i to j:
//
//     c_j = sum p_ij mu_i,  mu_i|j = p_ij mu_i / c_j,  x0_j = sum mu_i|j x_i,
//     P0_j = sum mu_i|j (P_i + (x_i - x0_j) (x_i - x0_j)^T),
//     each is predicted and updated by the frame,  mu_j = c_j L_j / sum c_k L_k,
//
// L_j the likelihood of the frame. p_ij is STAYS if the mode does not change, else by the share
// that mode j had in the frames before: of a body that turns steadily none is left for jumps. Sudden
// modes that show in a frame begin by that share, up to least_next, whatever the mode before.
//
// The error state of a mode is [turn, rate, acceleration, drift] about sensor axes and constants
// that walk at random, as the mounts of several heads on a body do. Modes:
//
//     steady       constant rate, white acceleration
//     torque       constant acceleration, white jerk
//     swing        acceleration' = -w^2 (rate - r), white jerk; w of the whole body by least
//                  squares, r its mean rate
//     jump         as steady, with accelerations that no torque of the others gives
//
// The process noise of torque and swing is in units of what one frame measures: they predict the
// next frame to k sigma of its own attitude. What is smaller does not show, at any camera. That of
// steady and jump is in units of the acceleration of the options.
//
// What is published has the mean and the covariance of the mixture. A normal distribution of these
// moments has no such tails as the mixture: with a mode of the probability p, whose mean is m away
// and whose sigma is s, the sigma of an axis is at least (|m| + c s) / 5, c as of tail_sigmas().
//
// In a frame: predict_motion(), update_motion(), measure_motion() (motion_steps.cpp; one step of a
// mode is in modes.h), then state_of() and with_tails() (motion_published.cpp).

#pragma once

#include <cstdint>

#include "filter/attitude_state.h"
#include "filter/gyro.h"
#include "maths/matrix.h"
#include "maths/rotation.h"

namespace st {

/// Errors beyond so many sigma are wrong.
constexpr double WRONG_SIGMAS = 5.0;

// --- modes ---

enum class Kind { STEADY, TORQUE, SWING, JUMP };

struct Mode {
    Kind kind;
    /// Sigmas of a frame that the prediction is off by; of steady and jump the acceleration in
    /// units of that of the options.
    double size;
    double first_share;  // before the first frame, not normalised: most bodies turn smoothly
    /// Least share in the next frame: when a motion begins is not known before. What is predicted
    /// further ahead is what the body has been seen to do.
    double least_next;
};

constexpr int MODES = 9;
constexpr Mode MODE[MODES] = {
    {Kind::STEADY, 1.0, 1.0, 1e-4},    {Kind::TORQUE, 0.02, 0.1, 1e-4},
    {Kind::TORQUE, 0.2, 0.1, 1e-4},    {Kind::TORQUE, 2.0, 0.05, 0.05},
    {Kind::TORQUE, 20.0, 0.01, 0.02},  {Kind::SWING, 0.1, 0.1, 1e-4},
    {Kind::SWING, 1.0, 0.05, 1e-4},    {Kind::JUMP, 100.0, 0.005, 0.02},
    {Kind::JUMP, 1000.0, 0.005, 0.02},
};

/// Of each mode.
using Weights = Vector<MODES>;

/// A set of modes: bit j is mode j.
using ModeSet = unsigned;

template <class Predicate>
constexpr ModeSet modes_of(Predicate is_one) {
    ModeSet modes = 0;
    for (int j = 0; j < MODES; ++j) {
        modes |= is_one(MODE[j]) ? 1U << j : 0U;
    }
    return modes;
}

constexpr double SUDDEN_SIZE = 20.0;
/// Modes of motions that begin within a frame, and of smooth ones.
constexpr ModeSet SUDDEN = modes_of([](const Mode &mode) { return mode.size >= SUDDEN_SIZE; });
constexpr ModeSet SMOOTH = modes_of([](const Mode &mode) { return mode.size < 2.0; });
constexpr ModeSet ONLY_STEADY = 1U;
/// Modes tried one after the other where a frame is not as the mixture of all has it.
constexpr ModeSet WIDE[] = {1U << 7, 1U << 8};

/// Probability that errors beyond WRONG_SIGMAS come from an improbable mode: of attitude and rate
/// at the frame, and at other times: motions that may begin, which are hardly ever seen, would
/// widen all that is predicted.
constexpr double MISSED = 2e-5, MISSED_AHEAD = 4e-5;
/// The same by a jump within an exposure: most frames have no jump.
constexpr double MISSED_LIGHT = 1e-3;
constexpr double NOISE_MEMORY = 0.95;  // of the size of the noise of a frame

// --- the state ---

/// Elements of the error state of a mode: turn, rate, acceleration, drift, then constants.
constexpr int TURN = 0, RATE = 3, ACCELERATION = 6, DRIFT = 9, CONSTANT = 12;

/// Most constants: coefficients of the mounts of heads.
constexpr int MOST_CONSTANTS = 36;

/// Mean of the error state of a mode about the quaternion of the motion, and covariance.
template <int MOST>
struct ModeState {
    Vector<CONSTANT + MOST> mean;
    Matrix<CONSTANT + MOST, CONSTANT + MOST> covariance;
};

/// What is known of a swing; NaN for what is not known of the frames before.
struct Swing {
    Quaternion last;              // measured in the frame before
    Vector3 turn, change, older;  // from the frame before it, its change, and that before
    /// Sums of a_k-1 (a_k + a_k-2) and of a_k-1^2, a the change, over its variance, less what
    /// noise gives.
    double product, energy;
    double w2;       // rad^2/s^2, 0 without a swing
    double weight;   // frames of which centre is the mean
    Vector3 centre;  // mean rate of the swing, rad/s
};

/// What is known of the motion at a time, but for the modes.
template <int MOST>
struct MotionSummary {
    int64_t stamp_ns;
    Quaternion quaternion;  // mean attitude, q_icrf_from_sensor
    Weights weight;         // probabilities of the modes
    Weights share;          // their means in the frames before,
    double frames;          // of so many
    Vector3 jumps;          // mean squares of sudden turns, over noise_rad2,
    double seen_jumps;      // of so many
    Vector3 noise_rad2;     // variance of the attitude that the stars of a frame measure
    double interval_s;      // of the frames, 0 while unknown
    Swing swing;
    Constants<MOST> constants;
};

/// What is known of the motion at a time.
template <int MOST>
struct MotionWith : MotionSummary<MOST> {
    ModeState<MOST> mode[MODES];

    /// Elements of the error state that are in use.
    int size() const { return CONSTANT + this->constants.count; }
};

/// That of a single tracker: plain data of 12 kB.
using Motion = MotionWith<0>;

/// Return the motion of a state, each mode with its attitude and rate; the constants are null for
/// none. The result is filled in place, as all motions are.
template <int MOST>
void start_motion(const StateWith<MOST> &state, const double *constants, const Vector3 &noise_rad2,
                  double interval_s, MotionWith<MOST> &motion);

/// Let a motion go on from a state, which is known without its modes.
template <int MOST>
void restart_motion(const StateWith<MOST> &state, MotionWith<MOST> &motion);

/// Give a motion that started again what was known of how the body moves.
template <int MOST>
void resume_motion(const MotionWith<MOST> &known, MotionWith<MOST> &motion);

/// The next frame has no neighbour: differences start again.
template <int MOST>
void interrupt_motion(MotionWith<MOST> &motion);

/// Return the weights of some modes, 0 for the others, and their sum.
Weights weights_of(const Weights &weight, ModeSet modes);
double total_weight(const Weights &weight, ModeSet modes);

/// Return the most probable mode.
int most_probable_mode(const Weights &weight);

/// Return attitude, rate and drift of the mixture by weights, not normalised.
template <int MOST>
StateWith<MOST> state_of(const MotionWith<MOST> &motion, const Weights &weight);

template <int MOST>
StateWith<MOST> state_of(const MotionWith<MOST> &motion) {
    return state_of(motion, motion.weight);
}

/// Fill the constants of the mixture.
template <int MOST>
void constants_of(const MotionWith<MOST> &motion, const Weights &weight, double *constants);

/// Return the mean acceleration, rad/s^2.
template <int MOST>
Vector3 acceleration_of(const MotionWith<MOST> &motion);

// --- from frame to frame ---

/// Of the options: acceleration of steady and jump, 1 sigma of each axis, and the spectral
/// densities with which drift and constants walk.
template <int MOST>
struct ProcessNoise {
    Vector3 acceleration_rad_s2;
    Vector<3 + MOST> walk;
};

/// Predict: fill the motion at a later time, each mode updated by rates of a gyro. rates are those
/// from the stamp of before to to_ns.
template <int MOST>
void predict_motion(const MotionWith<MOST> &before, int64_t to_ns, const GyroRates &rates,
                    const ProcessNoise<MOST> &noise, MotionWith<MOST> &after);

/// What the stars of a frame measure of a motion.
///
/// stars is their turn from a quaternion, and with 6 elements their difference from a rate as
/// well. An acceleration a changes what they measure by L a: rows of a rolling shutter, which were
/// brought to one time by the motion that was assumed, moved by its acceleration, and long
/// streaks. So do constants. beside is L of the elements of the error state from the acceleration
/// on, moved is L times what was assumed of them.
template <int MOST>
struct MotionMeasurement {
    Quaternion quaternion;
    Vector3 rate_rad_s;
    Information stars;
    Matrix<6, CONSTANT - ACCELERATION + MOST> beside;
    Vector<6> moved;
};

/// Update the motion by what the stars of a frame measure.
template <int MOST>
void update_motion(const MotionMeasurement<MOST> &measured, MotionWith<MOST> &motion);

/// Let the motion know the noise of a frame and the frequency of a swing, by the attitude that the
/// stars of the frame measure, of covariance R, and the stamp of the frame before.
template <int MOST>
void measure_motion(int64_t before_ns, const Quaternion &quaternion, const Matrix3 &R,
                    MotionWith<MOST> &motion);

/// Return the weights after a frame as what has been seen has them, without the least shares of
/// the next frame.
Weights by_experience(const Weights &weight, const Weights &share);

// --- what is published ---

/// Return the c beyond which such an error lies on one side with no more than a probability.
///
/// The error itself has the probability p: p exp(-c^2 / 2) / 2 = missed, a bound of the normal
/// integral. 0 where no c is needed.
double tail_sigmas(double probability, double missed);

/// Return a covariance of turn and rate that is wide enough for the improbable modes.
template <int MOST>
Matrix<6, 6> with_tails(const MotionWith<MOST> &motion, Matrix<6, 6> covariance);

/// Return the covariance of turn and rate that a vibration adds, zero without.
Matrix<6, 6> vibration_covariance(const Motion &motion);

/// Return what a covariance of the attitude lacks for an error of a probability, zero for nothing;
/// across is the size of the same error on every axis.
Matrix3 covariance_deficit(const Matrix3 &covariance, const Vector3 &error, double across,
                           double probability);

/// How attitude and rate go on after a frame: mean acceleration, its sigma after the frame and
/// before it, and jerk.
struct Course {
    Vector3 acceleration_rad_s2, sigma_rad_s2, jerk_rad_s3, sigma_before_rad_s2;
};

Course course_of(const Motion &motion, const Vector3 &acceleration_rad_s2);

}  // namespace st
