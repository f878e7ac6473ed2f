// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// One head: its mount in the state of the fusion, its frames, and whether it counts.

#pragma once

#include <cstdint>

#include "fusion/fused_state.h"
#include "startracker_fusion.h"

namespace st {

constexpr double ARCSEC = M_PI / 648000;

/// A measured attitude of a head.
struct HeadFrame {
    int64_t stamp_ns;
    Quaternion quaternion;  // q_icrf_from_sensor
    Matrix3 covariance;     // about sensor axes
};

/// Whether quaternion and covariance are an attitude: of length 1, and positive definite.
bool is_attitude(const HeadFrame &frame);

/// The scale by which the covariance of a head is multiplied.
///
/// It matches the normalised innovation squared (NIS) with its expectation (covariance matching,
/// Mehra, IEEE Trans. Autom. Control 17, 1972). Only a head that stands out from the best of the
/// others is scaled: a manoeuvre or a wrong gyro enlarges the innovations of all heads.
struct HeadNoise {
    double scale, nis;

    bool stands_out() const;

    /// Use the NIS of a frame; least is the smallest mean NIS of the other heads that count, NaN
    /// without any.
    void add(double frame_nis, double least);
};

/// A head and its share of the state.
class Head {
public:
    int number;
    st_mount mount;
    bool is_reference;  // its mount defines the body: it has no coefficients
    Columns columns;
    bool needs_temperature;  // its mount bends with a temperature that has not come

    st_head_state state;
    st_reason reason;
    st_head counts;  // frames by what became of them
    int disagreed;   // frames in a row
    bool has_used;
    int64_t used_ns;      // of the newest frame that counted
    double stepped_rad2;  // square of the steps of its mount that were found
    HeadNoise noise;
    HeadFrame recent[2];  // the newest, the last one last
    int recent_count;

    /// agreed is memory for agree_frames of the options.
    void start(int index, const st_mount &of, const st_fusion_config &config, int first_column,
               double *agreed);

    /// Forget the frames.
    void reset();

    /// Return how many coefficients a mount has by these options.
    static int coefficients_of(int index, const st_mount &of, const st_mount_options &options);

    // --- the mount ---

    /// Mean of the coefficients by file and options, and their covariance.
    const double *prior_mean() const { return prior_mean_; }
    const Matrix<MOST_OWN, MOST_OWN> &prior_covariance() const { return prior_covariance_; }

    /// Whether a mount may have come to these coefficients from what its file has. Frame by frame
    /// a head that is wrong by less than its gate could bend its mount to fit.
    bool is_plausible(const double *coefficients, int64_t stamp_ns);

    /// Return the spectral density rad^2/s of a coefficient.
    double walk(int coefficient) const;

    /// Use a temperature; false for one that no head has: NaN, or one in kelvin.
    bool set_temperature(double celsius);

    Sensitivity sensitivity(int64_t stamp_ns) const;

    /// Return the mount with these coefficients and their covariance, rows of `stride` numbers.
    st_mount estimated(const double *coefficients, const double *covariance, int stride) const;

    // --- frames ---

    /// Bring a frame to the time of the body and make it the next of recent; false if it is
    /// repeated.
    ///
    /// Frames whose errors are correlated by rho = exp(-dt / correlation_s) have the information
    /// of independent ones of (1 + rho) / (1 - rho) times their covariance (mean of an AR(1)).
    bool accept(HeadFrame &frame);

    /// Return the attitude of the body by a frame; coefficients are its own.
    HeadMeasurement measurement(const HeadFrame &frame, const double *coefficients) const;

    /// Whether the last frame that counted is too old for one that counts.
    bool is_silent(int64_t stamp_ns, double gap_s) const;

    /// Whether its last frame is no further than gap_s from a time.
    bool has_frames(int64_t stamp_ns, double gap_s) const;

    void enter(st_head_state next, const st_reason &why);

    /// Add the NIS of a frame that agrees; the mean is of at most agree_frames.
    void add_agreed(double nis);
    void clear_agreed() { agreed_count_ = 0; }
    int agreed_count() const { return agreed_count_; }
    double agreed_sum() const;

private:
    static constexpr int REMEMBERED = 64;  // stamps

    int terms_[MOST_TERMS], term_count_;
    st_mount_options options_;
    double correlation_s_;
    Quaternion sensor_from_body_;
    Matrix3 body_from_sensor_;
    double temperature_k_;
    double prior_mean_[MOST_OWN];
    Matrix<MOST_OWN, MOST_OWN> prior_covariance_;

    double *agreed_;
    int agree_frames_, agreed_count_, agreed_at_;
    int64_t first_ns_;
    int64_t stamps_[REMEMBERED];
    int stamp_count_, stamp_at_;
    double interval_s_;
};

}  // namespace st
