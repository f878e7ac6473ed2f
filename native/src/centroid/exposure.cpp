// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/exposure.h"

#include <cmath>

namespace st {
namespace {

constexpr double DOUBT = 0.06;   // of an exposure that the streaks of an image show
constexpr double IMAGES = 20.0;  // that an estimated exposure is the mean of
constexpr double CHANGED = 0.2;  // by which an image shows that the exposure is another one

}  // namespace

ExposureLimits Exposure::limits() const {
    double doubt = 0.0;
    if (!is_given_) {
        const double scatter = 2 * std::sqrt(scatter_);
        doubt = (scatter > DOUBT ? scatter : DOUBT) / std::sqrt(images_);
    }
    return {(1 - doubt) * seconds_, (1 + doubt) * seconds_};
}

void Exposure::add(double exposure_s, double weight) {
    if (is_given_) {
        return;
    }
    const double change = seconds_ > 0 ? exposure_s / seconds_ - 1 : INFINITY;
    if (std::fabs(change) > CHANGED) {
        if (weight >= weight_ / (images_ > 1.0 ? images_ : 1.0) / 2) {
            seconds_ = exposure_s;
            weight_ = weight;
            images_ = 1.0;
            scatter_ = 0.0;
        }
        return;
    }
    const double kept = 1 - 1 / IMAGES;
    images_ = kept * images_ + 1;
    weight_ = kept * weight_ + weight;
    const double share = weight / weight_;
    seconds_ *= 1 + share * change;
    scatter_ += share * (change * change - scatter_);
}

}  // namespace st
