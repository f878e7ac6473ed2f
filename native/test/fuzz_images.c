// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * fuzz_images ROUNDS SEED: images of any content, size and order, with any predictions, to trackers
 * that extract, in memory without a byte to spare. Meant for a build with sanitizers, which end the
 * program; exit status 1 where an answer is wrong.
 */

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "random.h"
#include "startracker_ground.h"

enum { MOST_SIDE = 160, IMAGES = 5, MOST_PREDICTIONS = 40 };

static int one_of(int count) {
    return (int)(random_bits() % (uint64_t)count);
}

/* Options that may change from image to image. */
static void set_live(st_extraction_options *options) {
    options->threshold = one_of(3);
    options->method = one_of(5);
    options->threshold_sigma = within(3, one_of(2) ? 8 : 100);
    options->threshold_dn = within(0.1, one_of(2) ? 100 : 65535);
    options->search_period_s = one_of(2) ? 1 : within(0, 3600);
    options->max_stars = 1 + one_of(one_of(2) ? 40 : 5000);
    options->max_stars_lost = 1 + one_of(5000);
}

static st_config any_config(void) {
    static const st_abi ABI = ST_ABI;
    st_config config;
    st_defaults(&config, &ABI);
    config.stages = ST_EXTRACTS;
    st_extraction_options *options = &config.extraction;
    set_live(options);
    options->psf_sigma_px = one_of(3) ? 0 : within(0, 5);
    options->exposure_s = one_of(3) ? 0 : within(0, 0.2);
    options->line_time_us = one_of(3) ? 0 : within(0, 1000);
    options->readout_up = one_of(2);
    if (one_of(3) == 0) {
        config.capacities.peaks = one_of(200);
        config.capacities.centroids = one_of(30);
        config.capacities.rejected = one_of(30);
    }
    config.capacities.predictions = MOST_PREDICTIONS;
    return config;
}

static void set_pixel(unsigned char *row, int u, int wide, double value) {
    const double most = wide ? 65535 : 255;
    value = value < 0 ? 0 : value < most ? value : most;
    if (wide) {
        const uint16_t dn = (uint16_t)value;
        memcpy(row + 2 * u, &dn, 2);
    } else {
        row[u] = (unsigned char)value;
    }
}

/* Level, noise, slope, stars or streaks, something large, hits. */
static void fill(unsigned char *pixels, const st_image *image) {
    const double scale = image->type == ST_GREY16 ? 1000 : 10;
    const double level = within(0, one_of(4) ? scale : 60 * scale), noise = within(0, scale / 10);
    const double slope = one_of(2) ? 0 : within(-scale, scale);
    const double hits = one_of(3) ? 0 : within(0, 0.2), sigma = within(0.3, one_of(2) ? 1.5 : 6);
    const double radius = one_of(3) ? 0 : within(1, 60);
    const int stars = one_of(30), streaks = one_of(2);
    double u[30], v[30], flux[30], along = within(0, 40), across = within(-20, 20);
    for (int i = 0; i < stars; ++i) {
        u[i] = within(-3, image->width_px + 3);
        v[i] = within(-3, image->height_px + 3);
        flux[i] = within(0, 30 * scale);
    }
    for (int y = 0; y < image->height_px; ++y) {
        unsigned char *row = pixels + y * image->stride_bytes;
        for (int x = 0; x < image->width_px; ++x) {
            double value = level + slope * x / image->width_px + within(-noise, noise);
            for (int i = 0; i < stars; ++i) {
                double du = x - u[i], dv = y - v[i];
                if (streaks) {
                    double t = (du * along + dv * across) / (along * along + across * across + 1);
                    t = t < -0.5 ? -0.5 : t < 0.5 ? t : 0.5;
                    du -= t * along;
                    dv -= t * across;
                }
                const double square = (du * du + dv * dv) / (2 * sigma * sigma);
                value += square < 30 ? flux[i] * exp(-square) : 0;
            }
            const double far = hypot(x - image->width_px / 2.0, y - image->height_px / 2.0);
            value += far < radius ? 40 * scale : 0;
            value += within(0, 1) < hits ? within(0, 60 * scale) : 0;
            set_pixel(row, x, image->type == ST_GREY16, value);
        }
    }
}

static double maybe_nan(double value) {
    return one_of(2000) ? value : NAN;
}

static size_t predict(st_prediction *predictions, const st_image *image) {
    const int count = one_of(3) ? one_of(MOST_PREDICTIONS + 1) : 0;
    const int stars = count ? one_of(count + 1) : 0;
    const double u_rate = within(-300, 300), v_rate = within(-300, 300);
    for (int i = 0; i < count; ++i) {
        const double far = one_of(50) ? 1 : 1e15;
        predictions[i].u_px = maybe_nan(far * within(-20, image->cell * image->width_px + 20));
        predictions[i].v_px = maybe_nan(far * within(-20, image->cell * image->height_px + 20));
        predictions[i].u_rate_px_s = u_rate + within(-1, 1);
        predictions[i].v_rate_px_s = v_rate + within(-1, 1);
        predictions[i].sigma_px = within(0, one_of(5) ? 1 : 50);
        predictions[i].hip = i < stars ? i + 1 : 0;
        predictions[i].reserved = 0;
    }
    return (size_t)count;
}

static int is_wrong(const st_tracker *tracker, const st_extraction *found, const st_config *config,
                    const st_image *image) {
    size_t count = 0, rejected = 0;
    const st_centroid *stars = st_centroids(tracker, &count);
    st_rejections(tracker, &rejected);
    int wrong =
        count != (size_t)found->centroids || found->rejected_listed > found->rejected ||
        (config->capacities.centroids > 0 && count > (size_t)config->capacities.centroids) ||
        (found->reason.code == ST_NO_REASON) != (count + (size_t)found->centroids_left_out > 0) ||
        rejected != (size_t)found->rejected_listed;
    for (size_t i = 0; i < count; ++i) {
        const double margin = 40.0 * image->cell;
        wrong |= !(stars[i].u_px > -margin && stars[i].v_px > -margin &&
                   stars[i].u_px < image->cell * image->width_px + margin &&
                   stars[i].v_px < image->cell * image->height_px + margin);
        wrong |= !(stars[i].sigma_px > 0) || !(stars[i].flux_dn > 0) || !(stars[i].snr > 0);
        wrong |= !isfinite(stars[i].common_uu_px2) || !isfinite(stars[i].cov_uv_px2);
    }
    return wrong;
}

/* The tools on the ground, with what an image before has left, or none: *left, 64 bytes aligned. */
static int is_wrong_on_ground(st_tracker *tracker, const st_image *image, const st_config *config,
                              const st_prediction *predictions, size_t count, void *left,
                              int *has_left) {
    const st_search_options options = {within(0.1, 3), one_of(3) * one_of(100), one_of(2),
                                       one_of(2), 0};
    const st_streak streak = {within(-50, 50), maybe_nan(within(-50, 50)), within(-0.1, 0.1),
                              within(0, MOST_SIDE), within(0, MOST_SIDE)};
    double places[2 * MOST_PREDICTIONS], radius_px[MOST_PREDICTIONS], widths[3 * 20], full;
    st_extraction found;
    int32_t kept = 0;
    size_t widths_count = 0;
    const st_streak *motion = one_of(2) ? &streak : NULL;
    st_status status =
        st_search(tracker, image, &options, motion, *has_left ? left : NULL, left, &kept, &found);
    int wrong = status != ST_OK && status != ST_BAD_IMAGE && status != ST_BAD_INPUT;
    if (status == ST_OK) {
        wrong |= is_wrong(tracker, &found, config, image);
        *has_left |= kept;
    }
    for (size_t i = 0; i < count; ++i) {
        places[2 * i] = predictions[i].u_px;
        places[2 * i + 1] = predictions[i].v_px;
        radius_px[i] = maybe_nan(within(0, 20));
    }
    if (*has_left) {
        status =
            st_search_near(tracker, image, places, radius_px, count, motion, left, left, &found);
        wrong |= status != ST_OK && status != ST_BAD_IMAGE && status != ST_BAD_INPUT;
        wrong |= status == ST_OK && is_wrong(tracker, &found, config, image);
        status =
            st_measure_widths(tracker, image, left, widths, (size_t)one_of(20), &widths_count);
        wrong |= status != ST_OK && status != ST_BAD_IMAGE && status != ST_TOO_MANY;
    }
    status = st_find_spots(tracker, image, within(0.1, 8), one_of(2));
    wrong |= status != ST_OK && status != ST_BAD_IMAGE;
    status = st_find_highest_peaks(tracker, image);
    wrong |= status != ST_OK && status != ST_BAD_IMAGE;
    status = st_full_scale(tracker, image, within(0, 1000), &full);
    wrong |= status == ST_OK && !(full > 0);
    return wrong;
}

static int tracker_round(void) {
    st_config config = any_config();
    st_camera camera;
    memset(&camera, 0, sizeof camera);
    camera.width_px = 1 + one_of(MOST_SIDE);
    camera.height_px = 1 + one_of(MOST_SIDE);
    camera.fx_px = camera.fy_px = 1000;
    camera.cx_px = camera.width_px / 2.0;
    camera.cy_px = camera.height_px / 2.0;
    size_t bytes = 0;
    st_tracker *tracker = NULL;
    if (st_size(&config, &camera, NULL, &bytes) != ST_OK) {
        printf("no size\n");
        return 1;
    }
    void *memory = aligned_alloc(64, bytes);
    memset(memory, one_of(256), bytes);
    int wrong = st_create(memory, bytes, &config, &camera, NULL, &tracker, NULL) != ST_OK;
    int64_t stamp_ns = 1000000000;
    unsigned char *before = NULL;
    size_t left_bytes = 0;
    wrong |= st_searched_size(tracker, &left_bytes) != ST_OK;
    void *left = aligned_alloc(64, left_bytes);
    int has_left = 0;
    for (int i = 0; i < IMAGES && !wrong; ++i) {
        if (one_of(3) == 0) {
            set_live(&config.extraction);
            config.extraction.readout_up ^= 1;
            wrong |= st_change_options(tracker, &config, NULL) != ST_READ_ONLY;
            config.extraction.readout_up ^= 1;
            wrong |= st_change_options(tracker, &config, NULL) != ST_OK;
        }
        st_image image;
        memset(&image, 0, sizeof image);
        image.cell = one_of(4) ? 1 : 1 + one_of(3);
        image.width_px = camera.width_px / image.cell;
        image.height_px = camera.height_px / image.cell;
        image.exposure_s = one_of(4) ? 0 : maybe_nan(within(0, 1));
        image.type = one_of(4) ? ST_GREY16 : ST_GREY8;
        const int pixel = image.type == ST_GREY16 ? 2 : 1;
        image.stride_bytes = pixel * (image.width_px + one_of(3));
        unsigned char *pixels = malloc((size_t)(image.stride_bytes * image.height_px) + 1);
        image.pixels = pixels;
        memset(pixels, 0, (size_t)(image.stride_bytes * image.height_px));
        if (image.width_px > 0 && image.height_px > 0) {
            fill(pixels, &image);
        }
        st_prediction *predictions = malloc(sizeof(st_prediction) * MOST_PREDICTIONS);
        const size_t count = predict(predictions, &image);
        st_extraction found;
        const st_status status = st_extract(tracker, stamp_ns, &image, predictions, count,
                                            stamp_ns - one_of(2000) * 1000000, one_of(2), &found);
        wrong |= (status != ST_OK && status != ST_BAD_INPUT && status != ST_BAD_IMAGE) ||
                 (status == ST_OK && is_wrong(tracker, &found, &config, &image)) ||
                 is_wrong_on_ground(tracker, &image, &config, predictions, count, left, &has_left);
        if (wrong) {
            size_t stars = 0;
            const st_centroid *star = st_centroids(tracker, &stars);
            printf("image %d of %d x %d px: status %d, %d stars, %d rejected, reason %d\n", i,
                   image.width_px, image.height_px, (int)status, found.centroids, found.rejected,
                   (int)found.reason.code);
            for (size_t k = 0; k < stars; ++k) {
                printf("%g %g px, %g DN, %g, %g px\n", star[k].u_px, star[k].v_px, star[k].flux_dn,
                       star[k].snr, star[k].sigma_px);
            }
        }
        stamp_ns += one_of(20) * 10000000;
        free(before);
        before = pixels;
        free(predictions);
    }
    free(before);
    free(left);
    free(memory);
    return wrong;
}

int main(int count, char **arguments) {
    if (count != 3) {
        fprintf(stderr, "usage: fuzz_images ROUNDS SEED\n");
        return 2;
    }
    const uint64_t rounds = strtoull(arguments[1], NULL, 10),
                   seed = strtoull(arguments[2], NULL, 10);
    for (uint64_t round = seed; round < seed + rounds; ++round) {
        state = round * 0x2545f4914f6cdd1du;
        if (tracker_round() != 0) {
            printf("fuzz_images: 1 %" PRIu64 " repeats it\n", round);
            return 1;
        }
    }
    printf("fuzz_images: %" PRIu64 " rounds, 0 failures\n", rounds);
    return 0;
}
