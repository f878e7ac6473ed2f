// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

// The exposure time of the images, estimated from the length of streaks where it is not given.

#pragma once

namespace st {

struct ExposureLimits {
    double least_s, most_s;
};

/// The mean of what 20 images have shown, with their weights; one that differs much begins a new
/// mean, if it has half of the weight of the others.
class Exposure {
public:
    /// Begin with a given time, 0 s while unknown.
    explicit Exposure(double given_s = 0.0) : is_given_(given_s > 0), seconds_(given_s) {}

    double seconds() const { return seconds_; }

    bool is_given() const { return is_given_; }

    /// Return the least and the largest exposure that it may be.
    ExposureLimits limits() const;

    /// Add what the streaks of an image show, with the inverse of its variance as weight.
    void add(double exposure_s, double weight);

private:
    bool is_given_;
    double seconds_, weight_ = 0.0, images_ = 0.0, scatter_ = 0.0;
};

}  // namespace st
