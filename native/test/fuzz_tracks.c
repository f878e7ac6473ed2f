// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * fuzz_tracks CORPUS ROUNDS SEED: lists of stars and of anything else, possible and not, to trackers
 * that track, trust and perhaps identify, with any options, in memory without a byte to spare. Exit
 * status 1 where a result is impossible, or one of a whole frame has other bits than the stages. A round that fails is repeated by its number as SEED with one round.
 */

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "kernels.h"
#include "random.h"
#include "sky_file.h"

enum { MOST = 120, FRAMES = 14 };

static const st_sky *sky;
static const int32_t *hip_of; /* catalogue number of each star of the sky file */
static double sky_pixel_rad;

static int one_of(int count) {
    return (int)(random_bits() % (uint64_t)count);
}

static double rarely(double value) {
    static const double odd[] = {NAN, INFINITY, -INFINITY, 0, -1, 1e300, -1e300, 1e-300};
    return one_of(400) ? value : odd[one_of(8)];
}

/* A section of a sky file that st_check_sky has accepted. */
static const void *section(const uint8_t *file, const char *name) {
    uint32_t sections;
    memcpy(&sections, file + 28, sizeof sections);
    for (uint32_t n = 0; n < sections; ++n) {
        const uint8_t *row = file + 64 + 64 * n;
        if (strncmp((const char *)row, name, 24) == 0) {
            uint64_t offset;
            memcpy(&offset, row + 32, sizeof offset);
            return file + offset;
        }
    }
    exit(2);
}

static st_config any_config(void) {
    static const st_abi ABI = ST_ABI;
    st_config config;
    st_defaults(&config, &ABI);
    config.stages = ST_TRACKS | ST_TRUSTS | (one_of(3) ? 0 : ST_IDENTIFIES);
    config.identification.slice_s = one_of(2) ? 0 : within(1e-9, 1e-3);
    config.identification.most_work_s = within(1e-3, 1e-2);
    config.identification.check_period_s = within(0, 1);
    config.capacities.centroids = one_of(3) ? MOST : 1 + one_of(MOST);
    config.capacities.tracks = one_of(2) ? 0 : 1 + one_of(40);
    config.capacities.frames = one_of(2) ? 0 : 1 + one_of(6);
    config.capacities.rates = one_of(2) ? 0 : 1 + one_of(20);
    config.capacities.predictions = one_of(2) ? 0 : 1 + one_of(20);
    st_tracking_options *options = &config.tracking;
    options->model = one_of(3) ? ST_ATTITUDE_MODEL : one_of(ST_MODEL_COUNT);
    options->association = one_of(ST_ASSOCIATION_COUNT);
    options->solver = one_of(4);
    options->sna_confirmation = one_of(2);
    options->roll_by_gyro = one_of(2);
    options->max_stars = 4 + one_of(one_of(2) ? 40 : 497);
    options->min_stars = 3 + one_of(6);
    options->max_missed = one_of(10);
    options->confirm_frames = 1 + one_of(5);
    options->max_bad_frames = 1 + one_of(6);
    options->gate_probability = within(0.5, 0.999999);
    options->detection_probability = within(0.01, 0.999);
    options->max_residual_px = within(0.01, one_of(2) ? 2 : 100);
    options->max_gap_s = within(0.01, one_of(2) ? 2 : 600);
    options->acceleration_deg_s2 = within(1e-6, one_of(2) ? 0.1 : 100);
    options->magnitude_limit = within(0, 11);
    config.gyro.gyro_range_deg_s = within(0.1, 100);
    config.trust.solver = one_of(4);
    config.trust.min_stars = 2 + one_of(6);
    return config;
}

static st_camera any_camera(int identifies) {
    const double focal_px = identifies ? within(0.82, 1.22) / sky_pixel_rad : within(100, 1500);
    st_camera camera = {512, 384, focal_px, focal_px, 255.5, 191.5, {0}, ST_PLUMB_BOB, 0};
    st_fault fault;
    if (one_of(3) == 0) {
        camera.model = ST_EQUIDISTANT;
    }
    return st_check_camera(&camera, &fault) == ST_OK ? camera : any_camera(identifies);
}

static void any_rotation(double q[4]) {
    double square = 0;
    for (int i = 0; i < 4; ++i) {
        q[i] = within(-1, 1);
        square += q[i] * q[i];
    }
    for (int i = 0; i < 4; ++i) {
        q[i] /= sqrt(square);
    }
}

/* Fill in the stars that an attitude shows, with noise, and others; return how many. */
static size_t see(const st_camera *camera, const double q[4], double noise_px,
                  st_centroid *centroids, st_identified *identified) {
    double matrix[9], sensor[3], direction[3], pixel[2];
    const double none[3] = {0, 0, 0};
    int32_t star[400];
    stt_matrix_from_quaternion(q, matrix);
    const double axis[3] = {matrix[2], matrix[5], matrix[8]};
    int32_t found = stt_stars_in_cone(sky, axis, stt_corner_angle(camera), star, 400);
    found = found < 400 ? found : 400;
    size_t count = 0;
    const int spots = one_of(3) ? one_of(10) : one_of(MOST);
    for (int32_t i = 0; i < found + spots && count < MOST; ++i) {
        st_centroid one;
        memset(&one, 0, sizeof one);
        memset(&identified[count], 0, sizeof identified[count]);
        one.u_px = within(-5, camera->width_px + 5);
        one.v_px = within(-5, camera->height_px + 5);
        if (i < found) {
            stt_direction_at(sky, star[i], 0, none, direction);
            stt_sensor_direction(matrix, direction, sensor);
            st_project(camera, sensor, pixel, 1);
            if (!stt_shows(camera, pixel) || one_of(10) == 0) {
                continue;
            }
            one.u_px = pixel[0] + within(-noise_px, noise_px);
            one.v_px = pixel[1] + within(-noise_px, noise_px);
            identified[count].hip = one_of(8) ? hip_of[star[i]] : (int32_t)random_bits();
        }
        one.u_px = rarely(one.u_px);
        one.v_px = rarely(one.v_px);
        one.flux_dn = rarely(within(1, 1e5));
        one.snr = rarely(within(5, 100));
        one.sigma_px = rarely(within(noise_px / 4, noise_px));
        one.cov_uu_px2 = rarely(one.sigma_px * one.sigma_px * within(0.5, one_of(3) ? 2 : 200));
        one.cov_vv_px2 = rarely(one.sigma_px * one.sigma_px);
        one.cov_uv_px2 = rarely(one.sigma_px * one.sigma_px * within(-0.4, 0.4));
        one.common_uu_px2 = one_of(4) ? 0 : rarely(within(0, 0.1));
        one.delay_s = rarely(one_of(2) ? 0 : within(-0.02, 0.02));
        centroids[count++] = one;
    }
    return count;
}

static st_observer any_observer(void) {
    st_observer observer;
    memset(&observer, 0, sizeof observer);
    for (int i = 0; i < 3; ++i) {
        observer.velocity_m_s[i] = rarely(within(-3e4, 3e4));
        observer.heliocentric_au[i] = one_of(3) ? rarely(within(-1, 1)) : NAN;
        observer.zenith[i] = i == 2;
    }
    observer.velocity_sigma_m_s = rarely(within(0, 1e4));
    observer.epoch_sigma_years = rarely(one_of(2) ? 0 : within(0, 10));
    observer.refraction_a_rad = rarely(one_of(2) ? 0 : 2.8e-4);
    observer.max_age_s = rarely(within(0, 100));
    observer.aberration = one_of(3);
    observer.body_count = one_of(3);
    for (int k = 0; k < observer.body_count; ++k) {
        observer.body[k].direction[one_of(3)] = rarely(1);
        observer.body[k].error_rad = rarely(within(0, 0.1));
        observer.body[k].radius_rad = rarely(within(0, 0.1));
        observer.body[k].magnitude = rarely(within(-10, 10));
    }
    return observer;
}

static int is_impossible(const st_attitude *attitude) {
    double square = 0;
    if (!attitude->valid) {
        return 0;
    }
    for (int i = 0; i < 4; ++i) {
        square += attitude->quaternion[i] * attitude->quaternion[i];
    }
    for (int i = 0; i < 3; ++i) {
        if (!(attitude->covariance_rad2[i][i] > 0)) {
            return 1;
        }
    }
    return !(fabs(square - 1) < 1e-9);
}

static int wrong;

static void expect(int holds, uint64_t round, int frame, int line) {
    if (!holds) {
        printf("round %" PRIu64 ", frame %d: line %d\n", round, frame, line);
        wrong = 1;
    }
}

#define EXPECT(condition) expect((condition), round, frame, __LINE__)

/* Return 1 where something is wrong. */
static int try_tracker(uint64_t round) {
    static st_centroid centroids[MOST];
    static st_identified identified[MOST];
    state = round;
    const st_config config = any_config();
    const st_camera camera = any_camera(config.stages & ST_IDENTIFIES);
    st_fault fault = {NULL, 0, 0, 0};
    st_tracker *tracker = NULL;
    size_t bytes = 0, count, tracks = 0;
    int frame = -1;
    wrong = 0;
    EXPECT(st_size(&config, &camera, sky, &bytes) == ST_OK);
    void *memory = aligned_alloc(64, bytes);
    EXPECT(st_create(memory, bytes, &config, &camera, sky, &tracker, &fault) == ST_OK);
    /* Another one, of the same input, for whole frames. */
    st_tracker *whole = NULL;
    void *other = aligned_alloc(64, bytes);
    EXPECT(st_create(other, bytes, &config, &camera, sky, &whole, &fault) == ST_OK);
    const int compares = !(config.stages & ST_IDENTIFIES);
    double q[4], turned[4];
    any_rotation(q);
    const double noise_px = within(0.01, 0.4), jump = one_of(2) ? 0 : 0.1;
    const double speed = one_of(2) ? 0.001 : 0.1;
    const double turn[3] = {within(-speed, speed), within(-speed, speed), within(-speed, speed)};
    int64_t stamp_ns = (int64_t)(random_bits() % 1000000);
    for (frame = 0; frame < FRAMES && !wrong; ++frame) {
        st_tracking tracking;
        st_trusted trusted;
        st_result result;
        stt_turned(q, turn, turned);
        memcpy(q, turned, sizeof q);
        if (within(0, 1) < jump) {
            any_rotation(q);
        }
        stamp_ns += one_of(20) ? 100000000 : (int64_t)(random_bits() % 3000000000U) - 1500000000;
        const double rate[3] = {rarely(10 * turn[0]), rarely(10 * turn[1]), rarely(10 * turn[2])};
        st_add_rate(tracker, stamp_ns - 50000000, rate);
        st_add_rate(tracker, stamp_ns, rate);
        st_add_rate(whole, stamp_ns - 50000000, rate);
        st_add_rate(whole, stamp_ns, rate);
        if (one_of(6) == 0) {
            const st_observer observer = any_observer();
            st_add_observer(tracker, stamp_ns, &observer);
            st_add_observer(whole, stamp_ns, &observer);
        }
        if (one_of(8) == 0) {
            st_hint hint;
            memset(&hint, 0, sizeof hint);
            hint.stamp_ns = stamp_ns;
            memcpy(hint.quaternion, q, sizeof q);
            for (int i = 0; i < 3; ++i) {
                hint.rate_rad_s[i] = rate[i];
                hint.covariance_rad2[i][i] = rarely(1e-6);
                hint.rate_covariance[i][i] = rarely(1e-6);
            }
            st_add_hint(tracker, &hint);
            st_add_hint(whole, &hint);
        }
        count = see(&camera, q, noise_px, centroids, identified);
        const double exposure_s[2] = {0, rarely(0.1)};
        const double *exposed_s = one_of(2) ? exposure_s : NULL;
        const st_status done =
            st_process_centroids(whole, stamp_ns, centroids, count, exposed_s, one_of(2), &result);
        st_status status = st_track(tracker, stamp_ns, centroids, count, exposed_s, &tracking);
        EXPECT(done == (status == ST_NOT_NEWER ? ST_OK : status));
        if (done == ST_OK) {
            EXPECT(!is_impossible(&result.attitude) && result.used == (status == ST_OK));
            EXPECT(!is_impossible(&result.identification.attitude));
        }
        if (status != ST_OK && status != ST_NOT_NEWER) {
            EXPECT(status == ST_BAD_INPUT || status == ST_TOO_MANY);
            continue;
        }
        EXPECT(!is_impossible(&tracking.attitude));
        EXPECT(!is_impossible(&tracking.frame_attitude));
        const st_star_track *list = st_tracks(tracker, &tracks);
        if (compares && result.used) {
            EXPECT(memcmp(&result.tracking.attitude, &tracking.attitude, sizeof(st_attitude)) ==
                   0);
            st_trust(tracker, stamp_ns, list, tracks, &tracking.attitude, &trusted);
            /* It is continuous with attitudes of st_trust_stars, which the other one has not. */
            const int sign = result.attitude.quaternion[0] * trusted.attitude.quaternion[0] < 0;
            for (int i = 0; i < 4 && sign; ++i) {
                trusted.attitude.quaternion[i] = -trusted.attitude.quaternion[i];
            }
            EXPECT(memcmp(&result.attitude, &trusted.attitude, sizeof(st_attitude)) == 0);
        }
        EXPECT(tracks <= 500 && (int32_t)tracks == tracking.tracks);
        status = st_trust(tracker, stamp_ns < 0 ? 0 : stamp_ns, list, tracks,
                          one_of(3) ? &tracking.attitude : NULL, &trusted);
        EXPECT(status == ST_OK || status == ST_TOO_MANY);
        EXPECT(status != ST_OK || !is_impossible(&trusted.attitude));
        if (one_of(2)) {
            st_predictions(tracker, &tracks);
        }
        if (tracking.state != ST_TRACKING || one_of(4) == 0) {
            status =
                st_add_identification(tracker, stamp_ns, centroids, identified, count, &tracking);
            EXPECT(status != ST_OK || !is_impossible(&tracking.attitude));
            if (compares) {
                st_tracking known;
                EXPECT(st_add_identification(whole, stamp_ns, centroids, identified, count,
                                             &known) == status);
            }
            status = st_trust_stars(tracker, stamp_ns, centroids, identified, count, &trusted);
            EXPECT(status != ST_OK || !is_impossible(&trusted.attitude));
        }
        if (one_of(3) == 0) {
            st_prepare(tracker);
        }
        if (one_of(40) == 0) {
            st_reset(tracker);
            st_reset(whole);
        }
    }
    free(other);
    free(memory);
    return wrong;
}

int main(int count, char **arguments) {
    if (count != 4) {
        fprintf(stderr, "usage: fuzz_tracks CORPUS ROUNDS SEED\n");
        return 2;
    }
    uint64_t bytes = 0;
    uint8_t *made = first_sky(arguments[1], &bytes);
    uint8_t *file = sky_copy(made, bytes);
    const st_sky opened = {file, bytes};
    if (st_check_sky(&opened, NULL) != ST_OK) {
        return 2;
    }
    sky = &opened;
    hip_of = section(file, "hip");
    sky_pixel_rad = *(const double *)section(file, "pixel_rad");
    const uint64_t rounds = strtoull(arguments[2], NULL, 10),
                   seed = strtoull(arguments[3], NULL, 10);
    int failures = 0;
    for (uint64_t round = seed; round < seed + rounds; ++round) {
        failures += try_tracker(round);
    }
    printf("%" PRIu64 " rounds, %d failures\n", rounds, failures);
    free(file);
    free(made);
    return failures != 0;
}
