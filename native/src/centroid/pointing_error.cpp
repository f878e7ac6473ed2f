// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "centroid/pointing_error.h"

#include <cmath>
#include <cstring>

#include "maths/sorting.h"

namespace st {
namespace {

constexpr int MOST_STARS = 8, LEAST_STARS = 3;
// What the noise of faint stars has made, brighter ones do not show: those of so much of the flux
// of the third, and so many standard deviations.
constexpr double FAINTEST = 1.0 / 3, CONFIRMED_SIGMAS = 3.0;
constexpr int REACH_PX = 10;  // beyond the ends of a streak
constexpr int MARGIN_PX = 2;  // for what is between pixels
constexpr int MOST_REACH_PX = 24, MOST_SIZE = 2 * MOST_REACH_PX + 1;
constexpr int MOST_WIDE = MOST_SIZE + 2 * MARGIN_PX;
constexpr int QUANTILE_PERCENT = 65;                     // of the stars
constexpr double SHARED_SHARE = 0.7, SHARED_PART = 0.3;  // of the bright stars with so much of it
constexpr double SMOOTHING_PX = 0.8;
constexpr double LOWEST = -1e300;  // before the first value
constexpr int TAPS = 5, MIDDLE_TAP = 2;
// Standard deviations of the noise: some images in a thousand have it by chance.
constexpr double SIGNIFICANT = 7.0;
constexpr double EXCESS_SIGMAS = 4.0;  // the same of a pixel, if it also exceeds
constexpr double EXCESS_SHARE = 0.15;  // of the most significant one
// Correlation of the odd parts of two stars below which their parts are exchanged.
constexpr double EXCHANGED = 0.15;
constexpr double UNCERTAIN = 0.15;
constexpr double MODEL_ERROR = 0.015;  // of a star's flux, by which a Gaussian may be wrong

/// Return how many of the largest values there are from the quantile on, its rank rounded.
constexpr int kept_of(int stars) {
    return stars - (QUANTILE_PERCENT * (stars - 1) + 50) / 100;
}

constexpr int MOST_KEPT = kept_of(MOST_STARS);
static_assert(kept_of(LEAST_STARS) <= MOST_KEPT && MOST_WIDE <= MOST_COLUMNS);

struct Figure {
    double value[MOST_SIZE * MOST_SIZE];
};

struct Work {
    Figure left, smooth, half, first, largest[MOST_KEPT];
    double own[MOST_WIDE * MOST_WIDE], between[MOST_WIDE];  // a star with its margin
    Profile<double> columns, rows;
};

int rounded(double value) {
    return static_cast<int>(std::rint(value));
}

/// Fill the indices of the stars used: bright, alone with fainter ones, not saturated; return how
/// many there are.
int choose(const Image &image, const StreakStar *stars, int count, int reach, double full_scale_dn,
           int *chosen) {
    const int far = reach + MARGIN_PX;
    int used = 0;
    for (int i = 0; i < count && used < MOST_STARS; ++i) {
        const int u = rounded(stars[i][U]), v = rounded(stars[i][V]);
        bool good = far <= u && u < image.width - far && far <= v && v < image.height - far;
        for (int j = 0; good && j < i; ++j) {
            good = std::fabs(stars[j][U] - u) > reach || std::fabs(stars[j][V] - v) > reach;
        }
        for (int y = v - reach; good && y <= v + reach; ++y) {
            const uint16_t *row = image.row(y);
            for (int x = u - reach; x <= u + reach; ++x) {
                good &= row[x] < full_scale_dn;
            }
        }
        if (good) {
            chosen[used++] = i;
        }
    }
    return used;
}

/// Weights of pixels -1, 0, 1, 2 for the value at a part 0 .. 1 of a pixel. Cubic convolution, Keys,
/// IEEE Trans. Acoust. Speech Signal Process. 29, 1981, equation 15.
struct Cubic {
    double weight[4];

    explicit Cubic(double part)
        : weight{((1 - 0.5 * part) * part - 0.5) * part, (1.5 * part - 2.5) * part * part + 1,
                 ((2 - 1.5 * part) * part + 0.5) * part, (0.5 * part - 0.5) * part * part} {}

    /// Return the value between four pixels that are a step apart.
    double between(const double *pixel, int step) const {
        return weight[0] * pixel[0] + weight[1] * pixel[step] + weight[2] * pixel[2 * step] +
               weight[3] * pixel[3 * step];
    }
};

/// Fill own with what the fit of a star leaves over its flux, about its pixel.
void own_left(const Image &image, const Mesh &mesh, const StreakStar &star, bool streaked,
              int reach, Work &work) {
    const int size = 2 * reach + 1, u = rounded(star[U]), v = rounded(star[V]);
    const int left = u - reach, top = v - reach;
    const double level = background_at(mesh, u, v).level, per_flux = 1 / star[FLUX];
    const Slope slope = slope_at(mesh, u, v, reach);
    const StreakShape shape(star);
    profile(star[U], star[SIGMA], left, size, work.columns);
    profile(star[V], star[SIGMA], top, size, work.rows);
    for (int y = 0; y < size; ++y) {
        const uint16_t *seen = image.row(top + y) + left;
        const double sky = level + slope.down * (y - reach), share_of_row = work.rows.share[y];
        double *own = work.own + y * size;
        for (int x = 0; x < size; ++x) {
            const double share = streaked ? shape.share_at(left + x, top + y)
                                          : share_of_row * work.columns.share[x];
            own[x] = (seen[x] - sky - slope.across * (x - reach)) * per_flux - share;
        }
    }
}

/// Fill left with the part of own that is reach about the centre of a star, resampled about it.
void resample(double u, double v, int reach, Work &work) {
    const int size = 2 * reach + 1, wide = size + 2 * MARGIN_PX;
    const Cubic across(u - std::floor(u)), down(v - std::floor(v));
    // The first one of four pixels that are weighted.
    const int first_x = static_cast<int>(std::floor(u)) - rounded(u) + MARGIN_PX - 1;
    const int first_y = static_cast<int>(std::floor(v)) - rounded(v) + MARGIN_PX - 1;
    for (int y = 0; y < size; ++y) {
        const double *own = work.own + (first_y + y) * wide;
        for (int x = 0; x < wide; ++x) {
            work.between[x] = down.between(own + x, wide);
        }
        double *left = work.left.value + y * size;
        for (int x = 0; x < size; ++x) {
            left[x] = across.between(work.between + first_x + x, 1);
        }
    }
}

/// Put A(d) of a star, with the sign of that of the first one, among the largest values of each
/// pixel so far, which ascend.
void add_odd(const Image &image, const Mesh &mesh, const StreakStar &star, bool streaked,
             int reach, int kept, bool is_first, Work &work) {
    const int area = (2 * reach + 1) * (2 * reach + 1);
    own_left(image, mesh, star, streaked, reach + MARGIN_PX, work);
    resample(star[U], star[V], reach, work);
    const double *left = work.left.value;
    double *odd = work.half.value, *first = work.first.value;
    double inner = 0.0, square = 0.0, square_of_first = 0.0;
    for (int d = 0; d < area; ++d) {
        odd[d] = left[d] - left[area - 1 - d];
        first[d] = is_first ? odd[d] : first[d];
        inner += odd[d] * first[d];
        square += odd[d] * odd[d];
        square_of_first += first[d] * first[d];
    }
    const double sign = inner < -EXCHANGED * std::sqrt(square * square_of_first) ? -1.0 : 1.0;
    for (int d = 0; d < area; ++d) {
        odd[d] *= sign;
    }
    // The smaller of two values goes on to the next place.
    for (int k = kept - 1; k >= 0; --k) {
        double *largest = work.largest[k].value;
        for (int d = 0; d < area; ++d) {
            const double value = odd[d], before = largest[d];
            largest[d] = value > before ? value : before;
            odd[d] = value > before ? before : value;
        }
    }
}

/// Fill smooth with left after a Gaussian filter; there is nothing beyond the borders.
void smooth(int size, Work &work) {
    double weight[TAPS], total = 0.0;
    for (int k = 0; k < TAPS; ++k) {
        const double z = (k - MIDDLE_TAP) / SMOOTHING_PX;
        weight[k] = std::exp(-0.5 * (z * z));
        total += weight[k];
    }
    for (double &one : weight) {
        one /= total;
    }
    work.half = {};
    work.smooth = {};
    const double *left = work.left.value;
    double *half = work.half.value, *full = work.smooth.value;
    for (int k = 0; k < TAPS; ++k) {
        const int shift = k - MIDDLE_TAP;
        for (int y = shift < 0 ? -shift : 0; y < size && y + shift < size; ++y) {
            for (int x = 0; x < size; ++x) {
                half[y * size + x] += weight[k] * left[(y + shift) * size + x];
            }
        }
    }
    for (int y = 0; y < size; ++y) {
        for (int k = 0; k < TAPS; ++k) {
            const int shift = k - MIDDLE_TAP;
            for (int x = shift < 0 ? -shift : 0; x < size && x + shift < size; ++x) {
                full[y * size + x] += weight[k] * half[y * size + x + shift];
            }
        }
    }
}

/// Fill left with A(d) of the chosen stars, and smooth; return the noise of the latter.
double odd_part(const Image &image, const Mesh &mesh, const StreakStar *stars, const int *chosen,
                int count, bool streaked, int reach, Work &work) {
    const int size = 2 * reach + 1, area = size * size, kept = kept_of(count);
    for (int k = 0; k < kept; ++k) {
        for (int d = 0; d < area; ++d) {
            work.largest[k].value[d] = LOWEST;
        }
    }
    for (int i = 0; i < count; ++i) {
        add_odd(image, mesh, stars[chosen[i]], streaked, reach, kept, i == 0, work);
    }
    double *deviation = work.half.value;
    std::memcpy(deviation, work.largest[0].value, static_cast<size_t>(area) * sizeof(double));
    const double middle = median(deviation, area);
    for (int d = 0; d < area; ++d) {
        work.left.value[d] = work.largest[0].value[d] - middle;
    }
    smooth(size, work);
    for (int d = 0; d < area; ++d) {
        deviation[d] = std::fabs(work.smooth.value[d]);
    }
    return SIGMA_PER_MAD * median(deviation, area);
}

}  // namespace

Matrix2 pointing_error(const Image &image, const Mesh &mesh, double full_scale_dn,
                       const StreakStar *stars, int count, bool streaked, Arena &arena) {
    const Arena::Scope scope(arena);
    double longest = 0.0;
    for (int i = 0; streaked && i < count; ++i) {
        longest = longest < stars[i][LENGTH] ? stars[i][LENGTH] : longest;
    }
    const double beyond = REACH_PX + std::ceil(longest / 2);
    const int reach = beyond < MOST_REACH_PX ? static_cast<int>(beyond) : MOST_REACH_PX;
    int chosen[MOST_STARS];
    const int used = choose(image, stars, count, reach, full_scale_dn, chosen);
    if (used < LEAST_STARS) {
        return {};
    }
    Work &work = *arena.take<Work>(1);
    double noise = odd_part(image, mesh, stars, chosen, used, streaked, reach, work);
    const int size = 2 * reach + 1;
    // In a streak the flux, and with it the error of the model, is spread over its length.
    const double sigma = stars[chosen[0]][SIGMA];
    const double width2 = sigma * sigma + SMOOTHING_PX * SMOOTHING_PX;
    // What is not significant as it is will not be so with the error of the model.
    double highest = work.smooth.value[0];
    for (int d = 1; d < size * size; ++d) {
        highest = work.smooth.value[d] > highest ? work.smooth.value[d] : highest;
    }
    if (!(highest > SIGNIFICANT * noise)) {
        return {};
    }
    // Nothing but the pixels of an excess is needed after the next figure.
    Figure &ratio = *arena.take<Figure>(1), &left = *arena.take<Figure>(1);
    double most = 0.0;
    int place = 0;
    for (int y = -reach; y <= reach; ++y) {
        for (int x = -reach; x <= reach; ++x) {
            const int d = (y + reach) * size + x + reach;
            const double core = streaked
                                    ? 0.0
                                    : MODEL_ERROR * std::exp(-(x * x + y * y) / (2 * width2)) /
                                          (2 * M_PI * width2);
            ratio.value[d] = work.smooth.value[d] / std::sqrt(noise * noise + core * core);
            left.value[d] = work.left.value[d];
            if (ratio.value[d] > most) {
                most = ratio.value[d];
                place = d;
            }
        }
    }
    if (!(most > SIGNIFICANT)) {
        return {};
    }
    int bright = 0;
    const double third = stars[chosen[LEAST_STARS - 1]][FLUX];
    for (int i = 0; i < used; ++i) {
        if (stars[chosen[i]][FLUX] >= FAINTEST * third) {
            chosen[bright++] = chosen[i];
        }
    }
    noise = odd_part(image, mesh, stars, chosen, bright, streaked, reach, work);
    const double seen = work.smooth.value[place];
    if (!(seen > CONFIRMED_SIGMAS * noise)) {
        return {};
    }
    int shared = 0;
    for (int i = 0; i < bright; ++i) {
        odd_part(image, mesh, stars, chosen + i, 1, streaked, reach, work);
        shared += std::fabs(work.smooth.value[place]) > SHARED_PART * seen ? 1 : 0;
    }
    if (shared < SHARED_SHARE * bright) {
        return {};
    }
    double total = 1.0, b_u = 0.0, b_v = 0.0, uu = 0.0, uv = 0.0, vv = 0.0;
    const double least = EXCESS_SHARE * most > EXCESS_SIGMAS ? EXCESS_SHARE * most : EXCESS_SIGMAS;
    for (int y = -reach; y <= reach; ++y) {
        for (int x = -reach; x <= reach; ++x) {
            const int d = (y + reach) * size + x + reach;
            const double flux = left.value[d];
            if (ratio.value[d] > least && flux > 0) {
                total += flux;
                b_u += flux * x;
                b_v += flux * y;
                uu += flux * x * x;
                uv += flux * x * y;
                vv += flux * y * y;
            }
        }
    }
    const double of_flux = UNCERTAIN * UNCERTAIN / total, of_shift = 1 / (total * total);
    const double cross = of_flux * uv + of_shift * b_u * b_v;
    return {{{of_flux * uu + of_shift * b_u * b_u, cross},
             {cross, of_flux * vv + of_shift * b_v * b_v}}};
}

size_t pointing_error_bytes() {
    return Arena::padded<Work>(1) + 2 * Arena::padded<Figure>(1);
}

}  // namespace st
