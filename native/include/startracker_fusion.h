// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Several star trackers, one attitude of the body: each head is checked against the others and a
 * gyro, and the mounts of all but the first are estimated.
 *
 * A mount is q_body_from_sensor: v_body = R(q) v_sensor. The true one is exp([m]x) R(q) with the
 * misalignment m(t) = sum_k phi_k(t) c_k about body axes: phi is 1, the temperature of the head
 * above its reference, cosine and sine of the orbit, as far as these are estimated. The mount of
 * the first head defines the body.
 *
 * Memory, errors and threads are as in startracker.h. Frames may come late and out of order.
 */

#ifndef STARTRACKER_FUSION_H
#define STARTRACKER_FUSION_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ST_MOST_HEADS 13
#define ST_MOST_COEFFICIENTS 36 /* of all mounts: 3, and 3 more for each term of a law */

/* ---- options: names, defaults and ranges are those of docs/parameters.md ------------------ */

typedef struct {
    double horizon_s, max_gap_s, max_gyro_gap_s;
    double acceleration_deg_s2, correlation_s;
    int32_t start_heads, agree_frames, exclude_frames;
    int32_t reserved;
} st_fusion_options;

typedef struct {
    double mount_sigma_arcsec, mount_walk_arcsec_sqrt_h;
    double mount_temperature_arcsec_k, mount_orbit_arcsec, orbit_period_s;
} st_mount_options;

typedef struct {
    st_fusion_options fusion;
    st_mount_options mount;
    st_gyro_options gyro;
    int32_t heads;
    int32_t frames; /* of all heads within horizon_s; 0: derived, of frames each 50 ms */
    int32_t rates;  /* of a gyro, the newest; 0: derived */
    int32_t reserved;
} st_fusion_config;

/* law: rad/K, rad of cosine, rad of sine, about body axes; law_covariance is that of
 * misalignment and law. temperature_c is where the first of the law is zero, NaN where it is
 * unknown. The stamps of the head are time_offset_s late. */
typedef struct {
    double quaternion[4];
    double covariance_rad2[3][3];
    double law[3][3];
    double law_covariance[12][12];
    double time_offset_s, temperature_c;
    int32_t has_covariance, has_law, has_law_covariance; /* 0: unknown, the numbers are not used */
    int32_t reserved;
} st_mount;

/* ---- results ------------------------------------------------------------------------------- */

/* Reasons, in addition to those of startracker.h. Heads are numbers from 0. */
typedef enum {
    /* there is no attitude */
    ST_FUSION_WAITING = 700, /* for frames */
    ST_FUSION_NO_PAIR,       /* no frames of two heads at a time */
    ST_FUSION_DISAGREE,      /* head, other head, deg between them */
    ST_FUSION_UNCONFIRMED,   /* no head that another one confirms */
    ST_FUSION_NONE_LEFT,     /* head, deg from what is predicted, and no other head counts */
    ST_FUSION_NOT_POSITIVE,  /* diagonal of the covariance of attitude, rate and drift */
    ST_FUSION_MOUNTS_WRONG,  /* sum of 2^head: further from their files than these allow */
    /* a head does not count */
    ST_HEAD_NO_FRAMES = 720,
    ST_HEAD_REPEATS,       /* stamps */
    ST_HEAD_LATE,          /* s behind the other heads */
    ST_HEAD_AHEAD,         /* s ahead of the other heads */
    ST_HEAD_AHEAD_OF_GYRO, /* s ahead of the other heads, and ahead of the gyro */
    ST_HEAD_UNCHECKED,     /* no other head or prediction to check it */
    ST_HEAD_RETURNS,       /* is checked after a time without frames */
    ST_HEAD_DIFFERS,       /* deg from what other heads and the motion give */
    /* a gyro that is not used, in addition to ST_REASON_GYRO_AT_RANGE */
    ST_FUSION_GYRO_BEHIND = 740, /* s behind the heads */
    ST_FUSION_GYRO_TURNS,        /* rate of the gyro rad/s x y z; head that does not turn so */
    ST_FUSION_GYRO_RATE,         /* rate of the gyro rad/s x y z, of the heads x y z */
    ST_FUSION_GYRO_HEADS         /* the heads agree with each other and not with the gyro */
} st_fusion_reason;

/* On body axes. */
typedef struct {
    double quaternion[4]; /* q_icrf_from_body, sign-continuous */
    double covariance_rad2[3][3];
    double rate_rad_s[3], rate_covariance[3][3];
    double drift_rad_s[3], drift_covariance[3][3];
    int64_t stamp_ns;
    int32_t valid; /* 0: there is no attitude, and the numbers are NaN */
    int32_t reserved;
} st_fused;

typedef enum {
    ST_HEAD_WAITING = 0,
    ST_HEAD_CHECKED,
    ST_HEAD_USED,
    ST_HEAD_EXCLUDED
} st_head_state;

typedef struct {
    st_reason reason;   /* why it does not count, ST_NO_REASON where it does */
    double noise_scale; /* of its covariance */
    int32_t state;      /* st_head_state */
    int32_t silent;     /* 1: no frame that counts for so long that it is checked again */
    int32_t stands_out; /* 1: errors so large that a user should know */
    int32_t needs_temperature;
    int32_t used, repeated, late, ahead, disagreeing, not_counted_yet; /* frames */
} st_head;

/* A step of a mount against that of the first head, about body axes. */
typedef struct {
    int64_t stamp_ns;
    double size_rad[3], sigma_rad[3];
    int32_t head;
    int32_t reserved;
} st_mount_step;

/* ---- functions ----------------------------------------------------------------------------- */

typedef struct st_fusion st_fusion;

/* Fill in all options with their defaults, for so many heads. */
ST_API st_status st_fusion_defaults(st_fusion_config *config, int32_t heads);

/* Bytes of memory that st_fusion_create needs; mounts (heads) decide what is estimated. */
ST_API st_status st_fusion_size(const st_fusion_config *config, const st_mount *mounts,
                                size_t *bytes);

/* Make a fusion in memory that the caller owns, aligned to 64 bytes. Everything is copied. */
ST_API st_status st_fusion_create(void *memory, size_t bytes, const st_fusion_config *config,
                                  const st_mount *mounts, st_fusion **fusion, st_fault *fault);

/* Forget attitude, gyro and frames; the mounts are those of st_fusion_create again. */
ST_API st_status st_fusion_reset(st_fusion *fusion);

/* The mean rate about body axes up to a stamp. */
ST_API st_status st_fusion_add_rate(st_fusion *fusion, int64_t stamp_ns,
                                    const double rate_rad_s[3]);

/* The attitude of a head, q_icrf_from_sensor, and its covariance about sensor axes. fused is
 * that of the body at its stamp, valid if the frame counts as the newest. */
ST_API st_status st_fusion_add_frame(st_fusion *fusion, int32_t head, int64_t stamp_ns,
                                     const double quaternion[4], const double covariance[9],
                                     st_fused *fused);

/* The temperature of a head in degrees Celsius; ST_BAD_INPUT for one that no head has. */
ST_API st_status st_fusion_add_temperature(st_fusion *fusion, int32_t head, double celsius);

/* Why there is no attitude, and why a gyro is not used; ST_NO_REASON where there is one, or
 * where it is used or there is none. *uses_gyro is 1 where it is. Each may be null. */
ST_API st_status st_fusion_state(const st_fusion *fusion, st_reason *trouble,
                                 st_reason *gyro_trouble, int32_t *uses_gyro);

/* What is known of a head at a stamp. */
ST_API st_status st_fusion_head(const st_fusion *fusion, int32_t head, int64_t stamp_ns,
                                st_head *state);

/* q_body_from_sensor of a head at a stamp, bent as estimated; what that differs from its file
 * by, rad about body axes, and the covariance of it. */
ST_API st_status st_fusion_mount(const st_fusion *fusion, int32_t head, int64_t stamp_ns,
                                 double quaternion[4], double misalignment_rad[3],
                                 double covariance[9]);

/* The mount as estimated so far, for the next st_fusion_create. */
ST_API st_status st_fusion_learnt(const st_fusion *fusion, int32_t head, st_mount *mount);

/* The steps of mounts that the last frame has shown, until the next call for the fusion. */
ST_API const st_mount_step *st_fusion_steps(const st_fusion *fusion, size_t *count);

#ifdef __cplusplus
}
#endif

#endif /* STARTRACKER_FUSION_H */
