// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "track/prediction.h"

#include <cmath>

#include "track/motion_models.h"

namespace st {

void visible_stars(const ApparentSky &sky, const Quaternion &attitude, const Vector3 &rate_rad_s,
                   double faintest, StarsInView &view, List<ExpectedStar> &visible) {
    const Matrix3 R = turn_view(sky, attitude, view);
    const Lens &lens = view.lens;
    const double least = -0.5 + BORDER_PX, right = lens.width - 0.5 - BORDER_PX,
                 bottom = lens.height - 0.5 - BORDER_PX;
    const int count = brighter_in_view(*sky.file, faintest, view);
    for (int i = 0; i < count; ++i) {
        const Vector3 sensor = sensor_direction(R, direction_in_view(sky, i, view));
        const Point uv = project(lens, sensor);
        if (least <= uv.x && uv.x <= right && least <= uv.y && uv.y <= bottom &&
            !is_crowded(sky, view.near[i])) {
            visible.add({uv, velocity_of(flow_of(lens, sensor), rate_rad_s)});
        }
    }
}

void predict_stars(const ApparentSky &sky, const Quaternion &attitude, const Matrix3 &covariance,
                   const Vector3 &rate_rad_s, double faintest, StarsInView &view,
                   List<st_prediction> &predicted) {
    const Matrix3 R = turn_view(sky, attitude, view);
    const int count = brighter_in_view(*sky.file, faintest, view);
    StarInView star;
    for (int i = 0; i < count && predicted.count < predicted.capacity; ++i) {
        if (!see(sky, R, i, view, star) || !shows(view.lens, star.uv)) {
            continue;
        }
        const Flow J = flow_of(view.lens, star.sensor);
        const Point velocity = velocity_of(J, rate_rad_s);
        const Covariance2 P = pixel_covariance(J, covariance);
        predicted.add({star.uv.x, star.uv.y, velocity.x, velocity.y, std::sqrt((P.uu + P.vv) / 2),
                       sky.file->hip[star.star], 0});
    }
}

}  // namespace st
