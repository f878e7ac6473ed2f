// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

#include "blind/few_stars.h"

#include <algorithm>
#include <cmath>

#include "blind/sky_triangle.h"
#include "identify/false_alarm.h"
#include "maths/sorting.h"

namespace st {
namespace {

constexpr int MOST_SPOTS = 80;
constexpr int FEWEST = 4;  // matches that P_few is for at least
// Matched stars, the brightest, whose order is tested.
constexpr int ORDERED = 12;
// Cells along one side of the image, of whose matches one counts: two of six stars are soon so close
// as in the coarser cells of other identifications.
constexpr int CELLS = 32;
// The radius in which a spot is looked for, in those of a match: the triangle has errors too.
constexpr double REACH = 2.0;
// The gate of a side, in those radii: of all triangles of true stars one is enough.
constexpr double GATE = 0.7;
// Expected time in ns: of an image triangle, of a triangle of the sky that fits, of a verification.
constexpr double LOOK_UP_NS = 300.0, VOTE_NS = 400.0, VERIFY_NS = 40000.0;

/// Spots by the rows of a grid about as wide as the radius of a search.
class SpotMap {
public:
    SpotMap(const ImageStars &stars, double reach, Arena &work)
        : per_cell_(1 / reach), spot_(work.list<Spot>(static_cast<size_t>(stars.count))) {
        low_ = stars.seen[0];
        for (int i = 1; i < stars.count; ++i) {
            low_ = {std::fmin(low_.x, stars.seen[i].x), std::fmin(low_.y, stars.seen[i].y)};
        }
        low_ = {low_.x - 2 * reach, low_.y - 2 * reach};
        for (int i = 0; i < stars.count; ++i) {
            spot_.add({row_of(stars.seen[i]), column_of(stars.seen[i]), i});
        }
        sort(spot_.item, spot_.count, work.take<Spot>(static_cast<size_t>(stars.count)),
             [](const Spot &a, const Spot &b) { return a.row < b.row; });
    }

    /// Return the brightest spot in the cell of a point and the eight about it, -1 for none.
    int at(const Point &point) const {
        const double row = row_of(point), column = column_of(point);
        const Spot *one = std::partition_point(
            spot_.begin(), spot_.end(), [row](const Spot &spot) { return spot.row < row - 1; });
        int brightest = -1;
        for (; one != spot_.end() && one->row <= row + 1; ++one) {
            if (std::fabs(one->column - column) <= 1 &&
                (brightest < 0 || one->index < brightest)) {
                brightest = one->index;
            }
        }
        return brightest;
    }

private:
    struct Spot {
        double row, column;
        int index;
    };

    double row_of(const Point &point) const { return std::floor((point.x - low_.x) * per_cell_); }
    double column_of(const Point &point) const {
        return std::floor((point.y - low_.y) * per_cell_);
    }

    double per_cell_;
    Point low_{};
    List<Spot> spot_;
};

/// What a search has of an image and of the sky.
struct Search {
    const Verifier &verifier;
    const st_triangle_table &table;
    const ImageStars &stars;
    double radius;  // of a match, in undistorted coordinates
    double gate;    // of the difference of two directions
};

Vector3 direction_of(const Patterns &sky, int32_t star) {
    const double *d = sky.direction[star];
    return {{d[0], d[1], d[2]}};
}

/// Whether a triangle of the sky fits three sides, the longest first, with one scale.
bool fits(const Search &search, int32_t row, const double side[3]) {
    const float *of_sky = search.table.side_rad + 3 * ptrdiff_t{row};
    double product = 0.0, square = 0.0;
    for (int k = 0; k < 3; ++k) {
        product += static_cast<double>(of_sky[k]) * side[k];
        square += side[k] * side[k];
    }
    const double s = product / square;
    for (int k = 0; k < 3; ++k) {
        if (!(std::fabs(static_cast<double>(of_sky[k]) - s * side[k]) <= search.gate)) {
            return false;
        }
    }
    return std::fabs(s - 1) <= search.verifier.scale_error + search.gate / side[0];
}

/// Whether a star about a triangle meets a spot in addition to those of base.
bool has_vote(const Search &search, const SpotMap &spots, const int32_t base[3],
              const int32_t star[3]) {
    const Patterns &sky = search.verifier.sky;
    const Vector3 A = direction_of(sky, star[0]), B = direction_of(sky, star[1]),
                  C = direction_of(sky, star[2]);
    const Vector3 normal[3] = {cross(B, C), cross(C, A), cross(A, B)};
    const double whole = dot(A, normal[0]);
    const int32_t *neighbour =
        search.table.neighbour + ptrdiff_t{star[0]} * search.table.neighbours;
    for (int m = 0; m < search.table.neighbours && neighbour[m] >= 0; ++m) {
        if (neighbour[m] == star[1] || neighbour[m] == star[2]) {
            continue;
        }
        const Vector3 s = direction_of(sky, neighbour[m]);
        Vector3 at{};
        double spread = 1.0;
        for (int k = 0; k < 3; ++k) {
            const double w = dot(s, normal[k]) / whole;
            at = at + scaled(search.stars.direction[base[k]], w);
            spread += w * w;
        }
        if (at[2] <= 0) {
            continue;
        }
        // Where the lens is a plane; the spots of a few degrees of others differ little from it.
        const Point place{at[0] / at[2], at[1] / at[2]};
        const int spot = spots.at(place);
        if (spot < 0 || spot == base[0] || spot == base[1] || spot == base[2]) {
            continue;
        }
        const double da = search.stars.seen[spot].x - place.x;
        const double db = search.stars.seen[spot].y - place.y;
        if (da * da + db * db <=
            search.radius * search.radius * std::fmin(spread, REACH * REACH)) {
            return true;
        }
    }
    return false;
}

/// Return P_few of the chosen ones of the matches, rank (count) that of their stars; matches has what
/// does not depend on the choice.
double probability_of(const Search &search, const StarMatch &found, const bool *chosen,
                      const int32_t *rank, FewMatches matches) {
    const int count = search.stars.count;
    for (int i = 0; i < count; ++i) {
        if (chosen[i]) {
            ++matches.m;
            matches.j = i + 1;
            matches.k = std::max(matches.k, rank[i]);
            matches.square += found.residual[i] * found.residual[i];
        }
    }
    matches.order = order_probability(found.star, chosen, count);
    return few_star_probability(matches, search.verifier.scale_error);
}

/// Verify that image stars base are the catalogue stars star.
void verify_few(const Search &search, const int32_t base[3], const int32_t star[3],
                Verification &result, Arena &work) {
    const Arena::Scope scope(work);
    const Verifier &verifier = search.verifier;
    const Field &field = verifier.field;
    const ImageStars &stars = search.stars;
    StarMatch &found = result.found;
    result.false_alarm = 1.0;
    if (!align(verifier.sky, verifier.equidistant, stars, base, star, 3, search.radius,
               verifier.scale_error, found, work)) {
        return;
    }
    auto *chosen = work.take<bool>(static_cast<size_t>(stars.count));
    auto *rank = work.take<int32_t>(static_cast<size_t>(stars.count));
    occupied_cells(stars, found.star, field.area, CELLS, chosen, work);
    const FewMatches all{stars.count,
                         0,
                         0,
                         0,
                         count_in_image(verifier, found, verifier.sky.stars),
                         0.0,
                         1.0,
                         field.high_a - field.low_a,
                         field.high_b - field.low_b};
    for (int i = 0; i < stars.count; ++i) {
        rank[i] = chosen[i] ? count_in_image(verifier, found, found.star[i] + 1) : 0;
    }
    result.false_alarm = probability_of(search, found, chosen, rank, all);
    // Each choice of matches is a field of its own: one match by chance must not hide the others.
    for (int left_out = 0; left_out >= 0;) {
        left_out = -1;
        for (int i = 0; i < stars.count; ++i) {
            if (!chosen[i]) {
                continue;
            }
            chosen[i] = false;
            const double without = probability_of(search, found, chosen, rank, all);
            chosen[i] = true;
            if (without < result.false_alarm) {
                result.false_alarm = without;
                left_out = i;
            }
        }
        if (left_out >= 0) {
            chosen[left_out] = false;
            found.star[left_out] = -1;
            found.residual[left_out] = NAN;
        }
    }
}

/// Return the first triangle of a cell whose longest side is not below low.
int32_t first_from(const st_triangle_table &table, int cell, double low) {
    int32_t first = table.start[cell], last = table.start[cell + 1];
    while (first < last) {
        const int32_t half = first + (last - first) / 2;
        if (static_cast<double>(table.side_rad[3 * ptrdiff_t{half}]) < low) {
            first = half + 1;
        } else {
            last = half;
        }
    }
    return first;
}

}  // namespace

double few_star_probability(const FewMatches &matches, double scale_error) {
    const auto [n, m, j, k, stars, square, order, width, height] = matches;
    if (m < FEWEST || j < m || k < m) {
        return 1.0;
    }
    const double area = width * height;
    double expected = 4 * M_PI / area * 4 * M_PI * scale_error * m * (m - 1) *
                      (width * width + height * height) / (12 * area);
    double all = 2.0, brightest = 2.0;
    for (int i = 0; i < m; ++i) {
        all *= static_cast<double>(n - i) / (i + 1);
        brightest *= static_cast<double>(j - i) / (i + 1);
        expected *= k - i;
    }
    for (int i = 0; i < m - 2; ++i) {
        expected *= M_PI * square / area / (i + 1);
    }
    double of_spots = 0.0, of_stars = 0.0, orders = 1.0;
    for (int i = m; i <= n; ++i) {
        of_spots += static_cast<double>(m) / i;
    }
    for (int i = m; i <= std::max(k, stars); ++i) {
        of_stars += static_cast<double>(m) / i;
    }
    for (int i = 2; i <= std::min(m, ORDERED); ++i) {
        orders += std::log(i);
    }
    return std::fmin(1.0, expected * std::fmin(all, brightest * of_spots) * order * of_stars *
                              orders * std::ldexp(1.0, m - FEWEST + 1));
}

double find_few_stars(const Verifier &verifier, const st_triangle_table &table,
                      const ImageStars &stars, double false_alarm_max, double most_ns,
                      Verification &best, Arena &work) {
    const Arena::Scope scope(work);
    const int count = std::min(stars.count, MOST_SPOTS);
    best.false_alarm = 1.0;
    if (count < FEWEST) {
        return 0.0;
    }
    const double radius = verifier.tolerance_sigmas * stars.median_sigma;
    const Search search{verifier, table, stars, radius, std::sqrt(2.0) * GATE * radius};
    const SpotMap spots(stars, REACH * radius, work);
    Verification found = verification(stars.count, work);
    double angle[MOST_SPOTS][MOST_SPOTS], spent_ns = 0.0;
    for (int k = 0; k < count; ++k) {
        for (int i = 0; i < k; ++i) {
            angle[i][k] = angle[k][i] = angle_between(stars.direction[i], stars.direction[k]);
        }
        for (int j = 1; j < k; ++j) {
            for (int i = 0; i < j; ++i) {
                const int32_t three[3] = {i, j, k};
                const double opposite[3] = {angle[j][k], angle[i][k], angle[i][j]};
                const Triangle seen = triangle_of(three, opposite);
                const double longest = seen.side[0], slack = search.gate / longest;
                if (!(table.low_rad <= longest && longest <= table.high_rad) || seen.is_flat()) {
                    continue;
                }
                spent_ns += LOOK_UP_NS;
                const bool turned = is_turned(stars.direction, seen.star);
                const double low = longest * (1 - verifier.scale_error) - search.gate;
                const double high = longest * (1 + verifier.scale_error) + search.gate;
                const int last_x = cell_along(seen.shortest() + slack);
                const int last_y = cell_along(seen.middle() + slack);
                for (int x = cell_along(seen.shortest() - slack); x <= last_x; ++x) {
                    for (int y = cell_along(seen.middle() - slack); y <= last_y; ++y) {
                        const int cell = triangle_cell(x, y, turned);
                        for (int32_t row = first_from(table, cell, low);
                             row < table.start[cell + 1] &&
                             static_cast<double>(table.side_rad[3 * ptrdiff_t{row}]) <= high;
                             ++row) {
                            if (!fits(search, row, seen.side)) {
                                continue;
                            }
                            spent_ns += VOTE_NS;
                            const int32_t *star = table.star + 3 * ptrdiff_t{row};
                            if (!has_vote(search, spots, seen.star, star)) {
                                continue;
                            }
                            spent_ns += VERIFY_NS;
                            verify_few(search, seen.star, star, found, work);
                            if (found.false_alarm < best.false_alarm) {
                                copy(found, stars.count, best);
                                if (best.false_alarm <= false_alarm_max) {
                                    return spent_ns;
                                }
                            }
                        }
                    }
                }
                if (spent_ns > most_ns) {
                    return spent_ns;
                }
            }
        }
    }
    return spent_ns;
}

}  // namespace st
