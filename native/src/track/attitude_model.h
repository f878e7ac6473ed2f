// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// One rotation moves all stars: one filter of attitude and rate, updated by all of them.
//
// Predicts every star by attitude and body rate, or with a gyro by attitude and gyro drift.

#pragma once

#include "filter/motion.h"
#include "integrity/gyro_agreement.h"
#include "integrity/lens_error.h"
#include "integrity/stamp_jitter.h"
#include "track/bank.h"
#include "track/correction.h"
#include "track/frame.h"
#include "track/start.h"
#include "track/systematic.h"

namespace st {

/// Ratio of the residuals to the sigma of the centroids: above 1 for a lens that is not calibrated.
///
/// value is 1 where the ratio is not significant. It is below 1 only when the precise stars, which
/// have the weight, have smaller residuals as well.
struct ErrorScale {
    double value, ratio, precise;
    int frames;
};

/// What a jump has moved the attitude by, after a rate; left counts frames.
struct Jump {
    bool any;
    Vector3 rate_rad_s, moved_rad;
    int left;
};

class AttitudeModel {
public:
    AttitudeModel() = default;
    AttitudeModel(const st_config &config, const Lens &lens);

    /// Use live options; the others must be those of before.
    void set_limits(const st_tracking_options &options) { options_ = options; }

    /// Forget all: before the next start.
    void clear();

    /// Begin at the identified frame of a start with its rate.
    void start(const Start &start, const Gyro &gyro);

    /// Use what was known of the motion before a start.
    void resume(const Motion &before);

    /// Predict the tracks to the time of a newer frame, of this sky, associate its centroids, update
    /// the state, check it. What update has is in memory of the arena.
    void update(int64_t stamp_ns, const CentroidFrame &frame, const ApparentSky &sky,
                const Gyro &gyro, TrackList &bank, FrameUpdate &update, Arena &arena);

    /// Return the errors of an attitude of the last frame: that of the filter, of covariance own, or
    /// that of the stars of the frame alone; without those that last from frame to frame.
    st_budget budget(const Matrix3 &own, bool of_frame) const;

    /// What is known of errors that last from frame to frame.
    LastingErrors lasting_errors() const;

    /// The lens that the stars are predicted with.
    Lens lens() const { return corrected_lens(lens_, lens_error_); }

    /// Fill in attitude and rate that predict the next frame; false where after a jump no smooth
    /// motion does.
    bool predicted(st_hint &hint) const;

    const Motion &motion() const { return motion_; }
    const Vector3 &rate_rad_s() const { return state_.rate_rad_s; }
    Matrix3 rate_covariance() const;
    Matrix3 cross_covariance() const;
    Course course() const;

    bool has_measured() const { return has_measured_; }
    const Quaternion &measured_quaternion() const { return measured_quaternion_; }
    const Matrix3 &measured_covariance() const { return measured_covariance_; }

    double stamp_sigma_s() const { return jitter_.sigma_s; }
    bool uses_gyro() const { return uses_gyro_; }
    const st_reason &gyro_trouble() const { return gyro_trouble_; }
    const st_reason &failure() const { return failure_; }

    /// Bytes of memory of an update.
    static size_t work_bytes(int tracks, int centroids);

private:
    /// A predicted state, by a gyro or not.
    ///
    /// motion is what it is the mixture of, or a part of it, null where the gyro alone propagates the
    /// state. The innovation of the frame is to be within a gate.
    struct Hypothesis {
        bool uses_gyro;
        AttitudeState state;
        const Motion *motion;
        double gate;

        /// The mean angular acceleration, zero where it is not known.
        Vector3 acceleration() const {
            return motion == nullptr ? Vector3{} : acceleration_of(*motion);
        }
    };

    /// A hypothesis with the correction of its state by a frame.
    struct Explanation {
        bool any = false;
        Hypothesis hypothesis;
        Correction correction;
    };

    /// A frame as the model takes it: errors scaled, and the error that all stars share.
    struct Measured {
        int64_t stamp_ns;
        CentroidFrame frame;
        bool sparse, rolling;
        int tracks;
        const Vector3 *icrf;       // of the tracks
        const bool *confirmed;     // the tracks
        const double *variance;    // px^2 per axis, of the centroids
        const Covariance2 *error;  // of the centroids, unscaled,
        const Covariance2 *scaled;
        const double *delay_s;  // null without a rolling shutter
        Matrix3 correlated;     // rad^2
        bool has_correlated;
        const SkyFile *sky;
        Arena *work;
    };

    Measured measured(int64_t stamp_ns, const CentroidFrame &frame, const ApparentSky &sky,
                      const TrackList &bank, Arena &arena, Arena &work) const;
    void explain(const Measured &measured, const Gyro &gyro, Explanation &nominal,
                 Explanation &confirmed, Arena &arena);
    bool hypothesis(int number, bool with_gyro, const Measured &measured, const Gyro &gyro,
                    Hypothesis &made);
    void predict(int64_t stamp_ns, bool with_gyro, const Gyro &gyro, Motion &motion) const;
    Correction corrected(const Hypothesis &hypothesis, const Measured &measured,
                         Arena &arena) const;
    bool is_consistent(const Correction &correction, double gate) const;

    void use(const Explanation &confirmed, const Measured &measured, const Gyro &gyro,
             TrackList &bank, FrameUpdate &update, Arena &arena);
    void go_without(const Explanation &nominal, const Measured &measured, const Gyro &gyro,
                    TrackList &bank, FrameUpdate &update, Arena &arena);
    void update_by(const Explanation &confirmed, const Measured &measured);
    void set_motion(bool uses_gyro);
    Matrix3 by_streaks(const CentroidFrame &frame, const Vector3 &rate_rad_s) const;
    void doubt_jump(const AttitudeState &before, const Hypothesis &hypothesis,
                    const CentroidFrame &frame);
    void doubt_shutter(const Correction &correction);
    void follow_tracks(const Correction &correction, const Measured &measured,
                       const Vector3 &acceleration_rad_s2, bool used, TrackList &bank,
                       FrameUpdate &update, Arena &arena);
    void check_covariance();
    void compare_gyro(int64_t before_ns, bool was_used, const TrackList &bank, const SkyFile &sky,
                      const Gyro &gyro, Arena &arena);
    bool is_saturated(int64_t stamp_ns, const Gyro &gyro) const;

    st_tracking_options options_{};
    Lens lens_{};
    double pixel_rad_ = 0.0;
    DetectionModel detection_{};
    ProcessNoise<0> noise_{};
    double drift_sigma_rad_s_ = 0.0;

    Motion motion_{}, next_{}, predicted_[2]{};
    AttitudeState state_{};
    Matrix<6, 6> covariance_{};  // of turn and rate, with errors outside the filter
    bool uses_gyro_ = false, has_measured_ = false;
    Quaternion measured_quaternion_{};
    Matrix3 measured_covariance_{}, correlated_{};
    Vector3 shutter_rad_{};
    int frames_ = 0, diverged_ = 0;
    ErrorScale scale_{};
    Jump jump_{};
    GyroAgreement agreement_{};
    StampJitter jitter_{};
    LensError lens_error_{};
    st_reason gyro_trouble_{}, failure_{};
};

}  // namespace st
