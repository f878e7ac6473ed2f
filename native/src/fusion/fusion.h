// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// Several heads, one attitude of the body: each head is checked against the others and the gyro.
//
// Frames may come late and out of order. States are stored over the horizon; a late frame corrects
// the state of its time, from which the frames after it are used again.
//
// A frame: add_frame() brings it to the time of the body; test() predicts the state to it,
// compares both, and updates the state if the head counts; start_with() starts from heads that
// agree.

#pragma once

#include "fusion/body_motion.h"
#include "fusion/head.h"
#include "fusion/history.h"
#include "fusion/steps.h"
#include "maths/arena.h"

namespace st {

class Fusion {
public:
    /// Return the bytes of memory that start() takes.
    static size_t bytes(const st_fusion_config &config, const st_mount *mounts);

    /// Return how many coefficients the mounts have.
    static int coefficients_of(const st_fusion_config &config, const st_mount *mounts);

    /// Start without frames, with MOST_CONSTANTS coefficients at most.
    void start(const st_fusion_config &config, const st_mount *mounts, Arena &arena);

    /// Forget attitude, gyro and frames; the mounts are those of start() again.
    void reset();

    bool add_rate(int64_t stamp_ns, const Vector3 &rate_rad_s) {
        return motion_.add_rate(stamp_ns, rate_rad_s);
    }

    /// Add a frame of a head; fill the attitude at its stamp, valid if it counts as the newest.
    void add_frame(int head, const HeadFrame &frame, st_fused &fused);

    Head &head(int number) { return heads_[number]; }
    const Head &head(int number) const { return heads_[number]; }
    int heads() const { return count_; }
    const st_reason &trouble() const { return trouble_; }
    const BodyMotion &motion() const { return motion_; }
    const List<st_mount_step> &steps() const { return steps_; }

    /// Whether a head has had no frame that counts for so long that it is silent.
    bool is_missing(int number, int64_t stamp_ns) const;

    /// Fill what a mount differs from its file by, rad, and its covariance.
    void misalignment(int number, int64_t stamp_ns, Vector3 &offset, Matrix3 &covariance) const;

    /// Return the mount of a head as estimated so far.
    st_mount estimated(int number) const;

private:
    /// The attitude of a head minus that of the state, with its variance and the law of its mount.
    struct Offset {
        Vector3 rad, variance;
        Law law;
    };

    // --- from frame to frame ---
    HeadMeasurement measurement(const FusedState &state, const Head &head,
                                const HeadFrame &frame) const;
    HeadInnovation innovation(const FusedState &state, const Head &head,
                              const HeadFrame &frame) const;
    void use(const Head &head, const HeadFrame &frame, int64_t before_ns,
             BodyMotionState &motion) const;
    void test(Head &head, const HeadFrame &frame, st_fused &fused);
    bool gave_up(const FusedState &state);
    bool counts(Head &head, const HeadFrame &frame, const HeadInnovation &found);
    void dispute(Head &head, const HeadFrame &frame, const HeadInnovation &found, st_fused &fused);
    void insert(int index, const Head &head, const HeadFrame &frame);
    void forget_motion();
    void fill(st_fused &fused);
    double lasting_rad2() const;

    // --- heads that count ---
    bool is_live(const Head &head, int64_t stamp_ns) const;
    int live(int64_t stamp_ns, const Head *but = nullptr) const;
    bool is_alone(const Head &head, int64_t stamp_ns) const;
    double least_noise(int64_t stamp_ns, const Head &but) const;

    // --- start ---
    bool start_with(Head &head, const HeadFrame &frame, st_fused &fused);
    int candidates(const Head &head, const HeadFrame &frame, int *found) const;
    bool is_candidate(const Head &other, const HeadFrame &frame) const;
    void begin(const Head &head);
    void add_begun(const Head &head, const HeadFrame &frame);
    void started(st_fused &fused);
    void drop(const st_reason &trouble);

    // --- mounts ---
    void reset_mounts();
    void follow_mounts(const FusedState &state);
    bool has_implausible_mounts(int64_t stamp_ns);
    Offset offset_of(const Head &head, const HeadInnovation &found) const;
    void observe(const Head &head, int64_t stamp_ns, const Offset &offset);

    st_fusion_config config_;
    int count_, coefficient_count_, needed_;
    Head heads_[ST_MOST_HEADS];
    BodyMotion motion_;
    StepDetector detector_;
    List<st_mount_step> steps_;
    st_reason trouble_;
    int untested_;  // frames in a row that no state could be compared with
    bool has_previous_;
    Quaternion previous_;                  // published
    double coefficients_[MOST_CONSTANTS];  // of all mounts, by the newest state or the files
    double *mount_covariance_;             // (coefficients, coefficients)

    History history_, begun_;           // of a start: three frames at most
    BodyMotionState *before_, *after_;  // of a step
    FusedState state_, updated_;        // predicted, and after the update
};

}  // namespace st
