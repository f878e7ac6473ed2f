// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * Star images, or lists of centroids, to spacecraft attitude: the whole interface of the library.
 *
 *     static const st_abi abi = ST_ABI;
 *     st_config config;                                 every option with its default,
 *     st_defaults(&config, &abi);                       to be changed before st_create
 *     st_size(&config, &camera, &sky, &bytes);          memory is yours, none is taken later
 *     st_create(memory, bytes, &config, &camera, &sky, &tracker, &fault);
 *     st_process_image(tracker, stamp_ns, &image, &result);
 *     if (result.attitude.valid) use(result.attitude.quaternion);   else log(result.reason)
 *
 * Memory    The library has no heap, no lock, no thread, no file, no clock and no global that
 *           changes. A tracker lives in the memory given to st_create, which must stay in place.
 *           Calls for one tracker must not overlap; trackers are independent of each other.
 * Capacity  Every list has a capacity in st_capacities. What does not fit is counted in the
 *           result and left out; nothing is written past a capacity.
 * Errors    A call that is used wrongly returns an st_status and changes nothing. A frame without
 *           a trusted attitude is not an error: the call returns ST_OK, with an st_reason.
 * Frames    Sensor frame: x right, y down in the image, z along the boresight out of the lens.
 *           Pixel (0, 0) is the centre of the top-left pixel. Inertial frame: ICRF.
 * Attitude  Hamilton quaternion in the order x, y, z, w, q_icrf_from_sensor: v_icrf = R(q) v_sensor,
 *           continuous in sign. Covariances are of a rotation vector about sensor axes, row-major.
 * Units     In the names. Angles are radians, but degrees in options. NaN is a number that is not
 *           known. Stamps are int64 ns of any clock that counts steadily; for a frame it is the
 *           middle of the exposure, for a rate the end of the interval of which it is the mean.
 * Same bits The same input gives the same output, bit for bit, on one build.
 */

#ifndef STARTRACKER_H
#define STARTRACKER_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__GNUC__)
#define ST_API __attribute__((visibility("default")))
#else
#define ST_API
#endif

/* Raised with every change of a struct, an enumeration or a function. */
#define ST_VERSION 3

#define ST_REASON_FIGURES 9
#define ST_MOST_BODIES 16

/* ---- wrong use ---------------------------------------------------------------------------- */

typedef enum {
    ST_OK = 0,
    ST_NULL_POINTER,
    ST_WRONG_VERSION,   /* caller and library differ in ST_VERSION or in the size of a struct */
    ST_WRONG_PROCESSOR, /* the library was built for a later processor than this one */
    ST_OUT_OF_RANGE,    /* an option or a number of the camera; st_fault has its name */
    ST_BAD_CAMERA,      /* no lens has such terms: the image folds, or the field is too wide */
    ST_BAD_SKY,         /* no sky file, damaged, of another version, or not of this camera */
    ST_TOO_LITTLE_MEMORY,
    ST_MISALIGNED,  /* memory or sky file is not aligned to 64 bytes */
    ST_BAD_IMAGE,   /* size, stride or type is not that of the camera */
    ST_BAD_INPUT,   /* a rate, observer, hint or list that is not finite or not possible */
    ST_NOT_NEWER,   /* the stamp is not newer than that of the call before */
    ST_TOO_MANY,    /* more elements than the capacity of the list */
    ST_READ_ONLY,   /* an option that only st_create takes */
    ST_NO_STAGE,    /* the tracker was created without this stage */
    ST_STATUS_COUNT /* also the size of anything that is indexed by a status */
} st_status;

/* The number that a call refuses, by name; the string stays. */
typedef struct {
    const char *name;
    double value, least, most;
} st_fault;

/* Versions and sizes as the caller was compiled with; ST_ABI makes one. */
typedef struct {
    uint32_t version;
    uint32_t config, camera, image, sky, observer, hint, centroid, identified, track, prediction;
    uint32_t rejected, result, attitude, fault;
} st_abi;

/* ---- camera and image --------------------------------------------------------------------- */

/* Distortion models, as OpenCV and sensor_msgs/CameraInfo define them. Terms in this order: */
typedef enum {
    ST_PLUMB_BOB = 0,       /* k1 k2 p1 p2 k3             fields up to 170 deg */
    ST_RATIONAL_POLYNOMIAL, /* k1 k2 p1 p2 k3 k4 k5 k6    fields up to 170 deg */
    ST_EQUIDISTANT,         /* k1 k2 k3 k4 (fisheye)      fields up to 350 deg */
    ST_LENS_MODEL_COUNT
} st_lens_model;

typedef struct {
    int32_t width_px, height_px; /* 1 .. 65536 */
    double fx_px, fy_px, cx_px, cy_px;
    double distortion[8]; /* terms that a model does not have are 0 */
    int32_t model;        /* st_lens_model */
    int32_t reserved;     /* 0 */
} st_camera;

typedef enum { ST_GREY8 = 0, ST_GREY16 /* byte order of the processor */ } st_pixel_type;

typedef struct {
    const void *pixels;          /* row after row, not changed */
    int64_t stride_bytes;        /* from one row to the next */
    int32_t width_px, height_px; /* those of the camera, divided by cell */
    int32_t type;                /* st_pixel_type */
    int32_t cell;                /* each pixel is the sum of cell x cell of the camera; or 1 */
    double exposure_s; /* as the camera says; 0: it says nothing, what it said last holds */
} st_image;

/* ---- sky and observer ---------------------------------------------------------------------- */

/* A sky file, of `startracker sky`, in memory or mapped, aligned to 64 bytes and unchanged while a
 * tracker uses it; several may share it. */
typedef struct {
    const void *file;
    uint64_t bytes;
} st_sky;

typedef enum {
    ST_ABERRATION_NONE = 0,
    ST_ABERRATION_EARTH_ONLY,
    ST_ABERRATION_FULL
} st_aberration;

/* Planet, Moon or Sun as the observer sees it: no star, and no error of the attitude. */
typedef struct {
    double direction[3]; /* unit vector on ICRF axes, off by error_rad at most */
    double error_rad, radius_rad;
    double magnitude; /* V */
} st_body;

/*
 * How the observer moves, from the stamp on until the next one; older than max_age_s its velocity
 * counts as unknown.
 */
typedef struct {
    double velocity_m_s[3];    /* about the barycentre of the solar system, on ICRF axes */
    double velocity_sigma_m_s; /* 1 sigma per axis of what is not known of it */
    double heliocentric_au[3]; /* position, for the deflection of light by the Sun; or NaN */
    double epoch_sigma_years;  /* 1 sigma of the epoch of the star places */
    double zenith[3];          /* of a camera in air, on ICRF axes, with refraction */
    double refraction_a_rad, refraction_b_rad; /* A tan z + B tan^3 z; 0 in space */
    double max_age_s;
    st_body body[ST_MOST_BODIES];
    int32_t body_count;
    int32_t aberration; /* st_aberration: what the velocity contains */
} st_observer;

/* An attitude from elsewhere: one identified frame that agrees with it starts the tracking. */
typedef struct {
    int64_t stamp_ns;
    double quaternion[4];
    double covariance_rad2[3][3];
    double rate_rad_s[3];
    double rate_covariance[3][3]; /* rad^2/s^2 */
} st_hint;

/* ---- options: names, defaults and ranges are those of docs/parameters.md ------------------ */
/* Band of the magnitudes and magnitude limit of the pairs are options of the sky file; the orbit is
 * the caller's, who gives the observer. Of the methods of papers this library has models of the
 * motion of stars. */

typedef enum { ST_THRESHOLD_SIGMA = 0, ST_THRESHOLD_FIXED, ST_THRESHOLD_ITERATIVE } st_threshold;

typedef enum {
    ST_GAUSSIAN = 0, /* fit of the point spread function; the others are means of pixels with */
    ST_BINARY,       /* weight 1, */
    ST_GREY,         /* their flux, */
    ST_SQUARED,      /* its square, */
    ST_THRESHOLDED   /* or the flux above the threshold */
} st_centroid_method;

typedef struct {
    double threshold_sigma, threshold_dn;
    double psf_sigma_px;    /* 0: estimated from each image */
    double exposure_s;      /* 0: that of the images, without it estimated from streaks */
    double line_time_us;    /* rolling shutter, delay from row to row; 0: global shutter */
    double search_period_s; /* between images searched as a whole while tracking; 0: all */
    int32_t threshold;      /* st_threshold */
    int32_t method;         /* st_centroid_method */
    int32_t max_stars, max_stars_lost;
    int32_t readout_up; /* 1: rows further up are exposed later */
    int32_t reserved;
} st_extraction_options;

typedef struct {
    double tolerance_sigmas, sigma_floor_px, fov_error_percent, false_alarm_max;
    double most_work_s;    /* of a search: expected time on one core of 3 GHz, no clock is read */
    double check_period_s; /* between checks of the tracks; 0: never */
    double slice_s;        /* of most_work_s, in one st_process_image; 0: all of it */
    int32_t max_image_stars;
    int32_t reserved;
} st_identification_options;

/* How the stars move: one rotation moves all of them, or, as papers have it, each has a filter of its
 * own (JPDAF), or none: it is where it was measured (star neighbourhood approach). */
typedef enum {
    ST_ATTITUDE_MODEL = 0,
    ST_CONSTANT_VELOCITY,
    ST_COORDINATED_TURN,
    ST_SNA,
    ST_MODEL_COUNT
} st_motion_model;

/* Factors of the false centroids in a joint event of a filter for each star: lambda^phi of a known
 * density, phi! / V^phi of an unknown one, or none, with the sums of all events normalised. */
typedef enum { ST_POISSON = 0, ST_DIFFUSE, ST_NORMALISED, ST_ASSOCIATION_COUNT } st_association;

typedef enum { ST_QUEST = 0, ST_DAVENPORT, ST_SVD, ST_TRIAD } st_solver;

typedef struct {
    double magnitude_limit;
    double acceleration_deg_s2, roll_acceleration_deg_s2;
    double sigma_floor_px, detection_probability, gate_probability;
    double magnitude_tolerance, max_residual_px, max_rate_deg_s, max_gap_s;
    int32_t max_stars, min_stars, max_missed, confirm_frames, max_bad_frames;
    int32_t model;            /* st_motion_model: the options below are not of ST_ATTITUDE_MODEL */
    int32_t solver;           /* st_solver, of the attitude */
    int32_t association;      /* st_association, of a filter for each star; as the next two */
    int32_t sna_confirmation; /* 1: only centroids that the star neighbourhood approach confirms */
    int32_t roll_by_gyro;     /* 1: the image rolls as a gyro says */
} st_tracking_options;

typedef struct {
    double gyro_drift_deg_h, gyro_noise_deg_sqrt_h, gyro_range_deg_s, gyro_rate_change_deg_s2;
} st_gyro_options;

typedef struct {
    double max_residual_px;
    double misleading_probability, false_star_probability;
    int32_t solver; /* st_solver, of stars of single frames */
    int32_t min_stars;
} st_trust_options;

/* Which stages a tracker has memory for. st_process_image needs all, st_process_centroids all but
 * the first; nodes in separate processes need one each. Without ST_IDENTIFIES frames are identified
 * by the caller, who gives the stars to st_add_identification. */
enum { ST_EXTRACTS = 1, ST_IDENTIFIES = 2, ST_TRACKS = 4, ST_TRUSTS = 8, ST_ALL_STAGES = 15 };

/* Elements of the lists; 0 in st_config: derived from the image size and the options. */
typedef struct {
    int32_t peaks;     /* of an image that are fitted, the highest */
    int32_t centroids; /* of a frame, found or given, the brightest */
    int32_t rejected;  /* detections listed with the reason; all are counted */
    int32_t tracks;
    int32_t predictions; /* of stars and targets, for windowed extraction */
    int32_t candidates;  /* of an identification, verified in turn */
    int32_t frames;      /* stored for an identification that comes late: 64 are 6 s at 10 Hz */
    int32_t rates;       /* of a gyro, the newest */
} st_capacities;

typedef struct {
    st_abi abi; /* st_defaults sets it, st_create compares it: options of another version fail */
    int32_t stages;
    double epoch_year; /* Julian year of the star places; NaN: that of the sky file */
    st_capacities capacities;
    st_extraction_options extraction;
    st_identification_options identification;
    st_tracking_options tracking;
    st_gyro_options gyro;
    st_trust_options trust;
} st_config;

/* ---- reasons ------------------------------------------------------------------------------- */

/* Why something is not there, or was done. The comment names figure[0], figure[1], ... */
typedef enum {
    ST_NO_REASON = 0,
    /* the whole frame is not used */
    ST_REASON_NOT_NEWER,   /* ns older than the frame before */
    ST_REASON_NOT_STAMPED, /* stamp 0 after others */
    /* extraction */
    ST_REASON_TOO_SMALL = 100,  /* width px, height px, least side px */
    ST_REASON_BLANK,            /* DN of all pixels */
    ST_REASON_SATURATED,        /* full scale DN */
    ST_REASON_TOO_MANY_PEAKS,   /* peaks */
    ST_REASON_NOTHING_ABOVE,    /* threshold in sigma, in DN (0: not in DN) */
    ST_REASON_ALL_REJECTED,     /* detections; rejected_by_kind of st_extraction has which */
    ST_REASON_TORN,             /* first and last row of the image before */
    ST_REASON_REPEATED_NOISE,   /* image of before, with its noise */
    ST_REASON_REPEATED_MOVED,   /* image of before, but stars have moved by px */
    ST_REASON_READOUT_TOO_LONG, /* read-out s, s since the frame before */
    ST_REASON_STREAK_ASTRAY,    /* length px of streaks across the motion of the stars */
    /* identification */
    ST_REASON_IDENTIFIED = 200, /* stars */
    ST_REASON_TOO_FEW_USABLE,   /* usable stars, stars needed */
    ST_REASON_NO_CANDIDATE,     /* stars, candidates tested, catalogue stars of a mean field */
    ST_REASON_AMBIGUOUS,        /* stars of one attitude, of the other */
    ST_REASON_MOST_WORK,        /* most_work_s, candidates tested */
    ST_REASON_STOPPED,          /* candidates tested until the caller stopped it */
    /* state of the tracking: the last transition */
    ST_REASON_WAITING = 300,       /* for an identified frame */
    ST_REASON_TIME_BACK,           /* s */
    ST_REASON_NO_SECOND,           /* max_gap_s without a second identification */
    ST_REASON_MISFIT,              /* identified stars, rms px, max_residual_px */
    ST_REASON_FIRST,               /* stars of the first identification */
    ST_REASON_TOO_FAST,            /* deg/s between two identifications */
    ST_REASON_IDENTIFIED_TWICE,    /* stars */
    ST_REASON_HINT_AGREES,         /* stars */
    ST_REASON_PREDICTION_AGREES,   /* stars */
    ST_REASON_STARS_ELSEWHERE,     /* frames that were not used, stars identified in the last */
    ST_REASON_CHECK_CONTRADICTS,   /* deg between an identification and the tracks */
    ST_REASON_NO_STARS,            /* s */
    ST_REASON_DIVERGED,            /* frames in a row, limit in sigma, last innovation in sigma */
    ST_REASON_GYRO_AT_RANGE_BLIND, /* no stars while the gyro is saturated */
    ST_REASON_NOT_POSITIVE,        /* diagonal of a covariance that is not positive definite */
    ST_REASON_BAD_FRAMES,          /* frames, stars that agreed in the last, rms px */
    /* contradictions: stars agree on an attitude, others show that it is wrong */
    ST_REASON_ROWS_LATE = 400,    /* row, s by which the rows beyond it are late: a torn frame */
    ST_REASON_LINE_TIME,          /* us by which line_time_us is off */
    ST_REASON_SECOND_IMAGE,       /* stars, of stars, px from where the others have them */
    ST_REASON_STARS_ABSENT,       /* stars seen, of stars, centroids that are not stars */
    ST_REASON_REPEATED_CENTROIDS, /* those of the frame before, with their noise */
    /* gyro that is not used */
    ST_REASON_GYRO_AT_RANGE = 500,
    ST_REASON_GYRO_DISAGREES, /* rate of the gyro rad/s x y z, of the stars x y z */
    ST_REASON_ROLL_DISAGREES, /* a filter for each star: stars are not where the roll has them */
    ST_REASON_NO_ROLL,        /* no rates: roll_by_gyro has no effect */
    /* attitude that is not trusted */
    ST_REASON_TRUSTED = 600,
    ST_REASON_NOT_TRACKED,        /* the tracking has no attitude */
    ST_REASON_TOO_FEW_STARS,      /* stars, min_stars, 1: tracked, 0: identified ones */
    ST_REASON_RESIDUAL,           /* rms px of solved stars, max_residual_px */
    ST_REASON_TRACKS_ASIDE,       /* rms px of tracks from the attitude, max_residual_px */
    ST_REASON_ERRORS_UNKNOWN,     /* diagonal of a covariance that is not positive definite */
    ST_REASON_STARS_NOT_FINITE,   /* NaN or infinity among directions or sigma */
    ST_REASON_SIGMA_NOT_POSITIVE, /* least sigma rad */
    ST_REASON_ZERO_LENGTH,        /* a direction of length zero */
    ST_REASON_SAME_STAR,          /* indices of two identical directions */
    ST_REASON_PARALLEL            /* the rotation about the stars is not observable */
} st_reason_code;

typedef struct {
    int32_t code; /* st_reason_code */
    int32_t reserved;
    double figure[ST_REASON_FIGURES];
} st_reason;

/* ---- lists --------------------------------------------------------------------------------- */

/* A star image, brightest first. common is the error that all stars of the image share. */
typedef struct {
    double u_px, v_px;
    double flux_dn, snr;
    double sigma_px; /* 1 sigma per axis, root mean square of both */
    double cov_uu_px2, cov_uv_px2, cov_vv_px2;
    double common_uu_px2, common_uv_px2, common_vv_px2;
    double delay_s; /* from the stamp to the middle of the exposure of the star's own row */
} st_centroid;

typedef struct {
    double magnitude, residual_px; /* NaN where not identified */
    double residual_rad;           /* angle to the star by the attitude */
    int32_t hip;                   /* catalogue number, 0 where not identified */
    int32_t reserved;
} st_identified; /* one for each centroid, in their order */

typedef struct {
    double u_px, v_px, u_rate_px_s, v_rate_px_s; /* filtered */
    double cov_uu_px2, cov_uv_px2, cov_vv_px2;
    double magnitude;               /* of the catalogue; NaN where hip is 0 */
    double flux_dn, snr, sigma_px;  /* of the centroid; NaN when missed */
    double residual_px;             /* centroid from prediction; NaN when missed or just started */
    double distance_px;             /* from the star by the attitude; NaN without one */
    double association_probability; /* of the most probable centroid */
    int32_t hip;                    /* 0 while not confirmed */
    uint32_t track_id;
    int32_t age, missed; /* frames since the start, since the last detection */
} st_star_track;

/* Where a star, or a target with hip 0, is expected; stars first, brightest first. */
typedef struct {
    double u_px, v_px, u_rate_px_s, v_rate_px_s, sigma_px;
    int32_t hip;
    int32_t reserved;
} st_prediction;

typedef enum {
    ST_REJECTED_EDGE = 0,
    ST_REJECTED_SATURATED,
    ST_REJECTED_HOT_PIXEL,
    ST_REJECTED_COSMIC_RAY,
    ST_REJECTED_ELONGATED,
    ST_REJECTED_TOO_WIDE,
    ST_REJECTED_NOT_FITTED,
    ST_REJECTED_FAINT,
    ST_REJECTED_NOT_STREAKED,
    ST_REJECTED_DISC, /* of something large: Moon, lamp, cloud */
    ST_REJECTED_LINE, /* of a trail or a saturated column */
    ST_REJECTED_COUNT
} st_rejection;

typedef struct {
    double u_px, v_px;
    int32_t kind; /* st_rejection */
    int32_t reserved;
} st_rejected;

/* ---- results: plain data, may be copied, stored and sent ---------------------------------- */

typedef struct {
    double quaternion[4];
    double covariance_rad2[3][3];
    double rate_rad_s[3];          /* of the sensor with respect to ICRF, on sensor axes */
    double rate_covariance[3][3];  /* rad^2/s^2 */
    double cross_covariance[3][3]; /* rad^2/s, attitude by rate; NaN where not known */
    double acceleration_rad_s2[3], jerk_rad_s3[3];
    double acceleration_sigma_rad_s2[3];        /* after the stamp, */
    double acceleration_sigma_before_rad_s2[3]; /* and before it */
    double protection_rad[3]; /* bounds that errors exceed with misleading_probability, or inf */
    double chi2, residual_px; /* of its stars, rms */
    int64_t stamp_ns;
    int32_t valid; /* 0: there is no attitude, and the numbers are NaN */
    int32_t stars;
} st_attitude;

/* Covariances that add up to covariance_rad2 of the attitude, rad^2. */
typedef struct {
    double stars[3][3], motion[3][3], exposure[3][3], stamps[3][3], shutter[3][3], lens[3][3];
    double observer[3][3], epoch[3][3];
} st_budget;

typedef struct {
    double background_dn, noise_dn, psf_sigma_px;     /* NaN where not measured */
    double exposure_least_s, exposure_most_s;         /* by streaks and points; 0 and infinity */
    double streak_u_px, streak_v_px, streak_roll_rad; /* motion fitted with; NaN for points */
    double streak_at_u_px, streak_at_v_px;            /* pixel about which it rolls */
    int32_t centroids, centroids_left_out;            /* listed, beyond capacity */
    int32_t rejected, rejected_listed;
    int32_t rejected_by_kind[ST_REJECTED_COUNT];
    int32_t windowed; /* 1: only predicted stars were measured */
    st_reason reason; /* ST_NO_REASON where there are stars */
} st_extraction;

typedef enum {
    ST_NOT_DUE = 0, /* the frame needed no identification */
    ST_IDENTIFIED,
    ST_TOO_FEW_STARS,
    ST_NO_CANDIDATE,
    ST_AMBIGUOUS,
    ST_TIME_LIMIT,
    ST_SEARCHING /* not finished: st_identify_on() continues */
} st_identification_status;

typedef struct {
    st_attitude attitude;
    double focal_ratio;             /* fitted focal length over that of the camera */
    double false_alarm_probability; /* of the best candidate */
    double work_s;                  /* expected time of the search so far, as most_work_s */
    int32_t status;                 /* st_identification_status */
    int32_t stars;
    int32_t body_centroids; /* that are planets, Moon or Sun */
    int32_t candidates;     /* tested */
    st_reason reason;
} st_identification;

typedef enum { ST_LOST = 0, ST_ACQUIRING, ST_TRACKING } st_state;
typedef enum { ST_GYRO_NONE = 0, ST_GYRO_USED, ST_GYRO_UNUSED } st_gyro_use;

typedef struct {
    st_attitude attitude;       /* filtered; not valid unless the stars of the frame agree */
    st_attitude frame_attitude; /* by the stars of this frame alone */
    double residual_px;         /* rms of the inliers of the last frame */
    double stamp_sigma_s;       /* 1 sigma of the stamps, 0 where not known */
    int32_t state;              /* st_state */
    int32_t gyro;               /* st_gyro_use */
    int32_t tracks, tracks_left_out, predictions;
    int32_t stars_matched, frames_since_fix, late_frames, rejected_centroids, checks_passed;
    st_budget budget, frame_budget; /* of attitude and frame_attitude */
    st_reason reason, contradiction, gyro_trouble;
} st_tracking;

typedef struct {
    st_attitude attitude; /* valid only if it can be trusted */
    st_reason reason;
} st_trusted; /* of st_trust and st_trust_stars */

/*
 * One frame. What it has of lists are counts: st_centroids, st_rejections, st_tracks, st_residuals,
 * st_identified_stars, st_searched_centroids and st_predictions give them until the next call.
 */
typedef struct {
    st_attitude attitude; /* valid only if it can be trusted; its budget is tracking.budget */
    st_reason reason;     /* ST_REASON_TRUSTED, or why attitude is not valid */
    st_extraction extraction;
    st_identification identification; /* of the frame at attitude.stamp_ns */
    st_tracking tracking; /* of the frame; state, reason, counts after its identification */
    int64_t stamp_ns;
    int32_t aberration; /* st_aberration: what the attitude is corrected for */
    int32_t used;       /* 0: the stamp is not newer than that of the frame before */
} st_result;

#define ST_ABI              \
    {ST_VERSION,            \
     sizeof(st_config),     \
     sizeof(st_camera),     \
     sizeof(st_image),      \
     sizeof(st_sky),        \
     sizeof(st_observer),   \
     sizeof(st_hint),       \
     sizeof(st_centroid),   \
     sizeof(st_identified), \
     sizeof(st_star_track), \
     sizeof(st_prediction), \
     sizeof(st_rejected),   \
     sizeof(st_result),     \
     sizeof(st_attitude),   \
     sizeof(st_fault)}

/* ---- functions ----------------------------------------------------------------------------- */

/* Whether caller and library are of one version, and the processor has its instructions. */
ST_API st_status st_check_abi(const st_abi *caller);

/* Compiler, instruction set and version of the library, in one line. */
ST_API const char *st_build_text(void);

/* What is wrong, in words; never null. */
ST_API const char *st_status_text(st_status status);

/* Fill in all options with their defaults, all stages and derived capacities. */
ST_API st_status st_defaults(st_config *config, const st_abi *caller);

/* Whether all options are within their ranges; fault (may be null) names the one that is not. */
ST_API st_status st_check_config(const st_config *config, st_fault *fault);

/* Whether such a camera is possible; fault (may be null) names the number that is not. */
ST_API st_status st_check_camera(const st_camera *camera, st_fault *fault);

/* Directions (count, 3) on sensor axes, of any length, to pixels (count, 2); NaN for those that
 * have none: behind the camera, or outside the image circle of a fisheye. */
ST_API st_status st_project(const st_camera *camera, const double *direction, double *pixel,
                            size_t count);

/* Pixels (count, 2) to unit vectors (count, 3); NaN where no direction has such a pixel, as outside
 * the image circle of a fisheye. */
ST_API st_status st_unproject(const st_camera *camera, const double *pixel, double *direction,
                              size_t count);

/* How directions (count, 3) move in the image per turn of the sensor: d(u, v)/d(angle about each
 * sensor axis), (count, 2, 3) in px/rad, which is px/s per rad/s. NaN as in st_project. */
ST_API st_status st_image_flow(const st_camera *camera, const double *direction, double *flow,
                               size_t count);

/* Whether a sky file is complete and of this library, so that no damage to it can do harm; fault
 * (may be null) names the part that is wrong. Reads all of it: once, before the first st_create. */
ST_API st_status st_check_sky(const st_sky *sky, st_fault *fault);

/* ---- trackers ------------------------------------------------------------------------------ */

/* Several heads and their mounts are to have a header of their own. */
typedef struct st_tracker st_tracker;

/* Bytes of memory that st_create needs. sky may be null for trackers that only extract; else it is
 * one that st_check_sky() has found sound. */
ST_API st_status st_size(const st_config *config, const st_camera *camera, const st_sky *sky,
                         size_t *bytes);

/* Make a tracker in memory that the caller owns, aligned to 64 bytes. Everything is copied but
 * the sky file. No function frees anything: the memory is free when the tracker is not used. */
ST_API st_status st_create(void *memory, size_t bytes, const st_config *config,
                           const st_camera *camera, const st_sky *sky, st_tracker **tracker,
                           st_fault *fault);

/* Forget all frames, rates and hints: LOST, as after st_create. */
ST_API st_status st_reset(st_tracker *tracker);

/* Other options from the next frame on, without loss of lock; ST_READ_ONLY where one differs that
 * docs/parameters.md does not mark as live, which fault names (may be null). Memory stays: more
 * stars than there is room for since st_create are left out and counted. */
ST_API st_status st_change_options(st_tracker *tracker, const st_config *config, st_fault *fault);

/* predictions, of predicted_ns, may be null: the image is searched as a whole; lost 1: more stars
 * the longer there are none. */
ST_API st_status st_extract(st_tracker *tracker, int64_t stamp_ns, const st_image *image,
                            const st_prediction *predictions, size_t count, int64_t predicted_ns,
                            int32_t lost, st_extraction *extraction);

/* Lists of the last call, in the memory of the tracker, until the next call for it. */
ST_API const st_centroid *st_centroids(const st_tracker *tracker, size_t *count);
ST_API const st_rejected *st_rejections(const st_tracker *tracker, size_t *count);

/* Which stars a list of centroids shows, lost in space, by the sky file of st_create. Those of a
 * rolling shutter (delay_s) are moved to the time of the frame, by the list before where that helps;
 * planets, Moon and Sun of the observer are not stars. The attitude is that of a sky without
 * aberration: up to 26 arcsec off, which the tracking and st_trust_stars are not. The search
 * does most_work_s of work at most, and slice_s of it in this call (infinity: all); it is then
 * ST_SEARCHING, and st_identify_on() continues it, with the same result as in one call. A thread of
 * the caller may set *stop, not zero, to end it; null: nothing stops it. No content of a list is
 * wrong use: centroids that cannot be used are left out. */
ST_API st_status st_identify(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                             size_t count, double slice_s, const volatile uint32_t *stop,
                             st_identification *identification);

/* Continue a search by another slice; ST_BAD_INPUT where none is waiting. */
ST_API st_status st_identify_on(st_tracker *tracker, double slice_s, const volatile uint32_t *stop,
                                st_identification *identification);

/* One for each centroid, in their order, of the last call; empty without an attitude. */
ST_API const st_identified *st_identified_stars(const st_tracker *tracker, size_t *count);

/* The centroids of that list, where they were at the time of their frame. */
ST_API const st_centroid *st_searched_centroids(const st_tracker *tracker, size_t *count);

/* The mean rate about sensor axes up to a stamp, before the frame that follows it. */
ST_API st_status st_add_rate(st_tracker *tracker, int64_t stamp_ns, const double rate_rad_s[3]);

/* Without any the observer is at rest and star places are those of the catalogue. */
ST_API st_status st_add_observer(st_tracker *tracker, int64_t stamp_ns,
                                 const st_observer *observer);

ST_API st_status st_add_hint(st_tracker *tracker, const st_hint *hint);

/* The attitude at a time near its own, by rate and acceleration, with its covariance. */
ST_API st_status st_attitude_at(const st_attitude *attitude, int64_t stamp_ns, st_attitude *at);

/* 1 where the next frame needs an identification: not while tracking unless a check is due. */
ST_API int32_t st_identification_is_due(const st_tracker *tracker, int64_t stamp_ns,
                                        st_state state, int32_t windowed);

/* exposure_s (2) are the least and the largest exposure, null where unknown. ST_NOT_NEWER for a stamp
 * that is not newer than the one before: the frame is not used, but counted in late_frames. One that
 * is older by more than 1 s restarts the tracking. */
ST_API st_status st_track(st_tracker *tracker, int64_t stamp_ns, const st_centroid *centroids,
                          size_t count, const double *exposure_s, st_tracking *tracking);

/* Start tracks of stars that came into view, which the next st_track would do first: called
 * between two frames it saves that time. */
ST_API st_status st_prepare(st_tracker *tracker);

/* An identification made elsewhere, for the tracking, whose state is then tracking; it may come some
 * frames late. */
ST_API st_status st_add_identification(st_tracker *tracker, int64_t stamp_ns,
                                       const st_centroid *centroids,
                                       const st_identified *identified, size_t count,
                                       st_tracking *tracking);

/* What the tracking knows now, with the list of tracks: also of a whole frame whose identification
 * restarted it, of which st_result has the tracks that were trusted. */
ST_API st_status st_known(st_tracker *tracker, st_tracking *tracking);

/* Lists of the last call, as st_centroids. Predictions are computed when they are asked for, null
 * where there is no attitude. */
ST_API const st_star_track *st_tracks(const st_tracker *tracker, size_t *count);
ST_API const st_prediction *st_predictions(st_tracker *tracker, size_t *count);

/* tracked is that of the tracking; null: solved from the tracks. */
ST_API st_status st_trust(st_tracker *tracker, int64_t stamp_ns, const st_star_track *tracks,
                          size_t count, const st_attitude *tracked, st_trusted *trusted);

ST_API st_status st_trust_stars(st_tracker *tracker, int64_t stamp_ns,
                                const st_centroid *centroids, const st_identified *identified,
                                size_t count, st_trusted *trusted);

/* Angles, rad, between the stars of the last st_trust or st_trust_stars and the catalogue, in the
 * order in which they were given; the list of the last call, as st_centroids. */
ST_API const double *st_residuals(const st_tracker *tracker, size_t *count);

/* ---- whole frames ------------------------------------------------------------------------ */

/*
 * One image to an attitude: extraction near the predictions of the tracking, tracking, trust, and
 * identification where st_identification_is_due says so. An identification does slice_s of work in
 * a call. Where it takes several, the frames between are tracked as far as they can be, and its
 * stars are those of the frame that it began with.
 *
 * ST_OK also where there is no attitude: the reason of the result says why. A stamp that is older
 * than the one before by more than 1 s restarts the tracker, as st_reset; a frame that is not newer
 * is not used, and counted in late_frames. Rates and the observer are given before the frame.
 */
ST_API st_status st_process_image(st_tracker *tracker, int64_t stamp_ns, const st_image *image,
                                  st_result *result);

/* The same of centroids. exposure_s (2) are the least and largest exposure, null where unknown;
 * windowed: only predicted stars were measured, which is not a check of the tracks. */
ST_API st_status st_process_centroids(st_tracker *tracker, int64_t stamp_ns,
                                      const st_centroid *centroids, size_t count,
                                      const double *exposure_s, int32_t windowed,
                                      st_result *result);

#ifdef __cplusplus
}
#endif

#endif /* STARTRACKER_H */
