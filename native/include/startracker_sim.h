// Copyright 2026 the startracker_ros authors
// SPDX-License-Identifier: Apache-2.0

/*
 * The image sensor of the simulator: light of stars and trails, charge, noise. It is in the library
 * of the Python package only, not in flight builds (CMakeLists.txt).
 *
 * light (height, width) is in electrons, response (height, width) a factor, both by rows. Light
 * outside the image is lost. The same key of random numbers gives the same bits on every machine
 * and in every version.
 */

#ifndef STARTRACKER_SIM_H
#define STARTRACKER_SIM_H

#include "startracker.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Amplifier and converter; top_dn is the largest digital number. */
typedef struct {
    float full_well_e, read_noise_e, dn_per_e, bias_dn, top_dn;
} st_readout;

/* Alias tables (rows, 256) of probabilities (rows, 256) times 256, which are overwritten. */
ST_API void st_alias_tables(double *probability, size_t rows, uint32_t *table);

/* The digital numbers (count) of expected electrons mean (count): Poisson noise, saturation, normal
 * read noise. normal (256) and poisson (256, 256) are alias tables: of cells of 1/16 sigma from
 * -8 sigma on, and of counts for the means 0, 1/4, 2/4 and so on. offset_e (count), or null, is
 * added before the conversion. */
ST_API void st_read_out(const float *mean, size_t count, uint64_t key, const st_readout *readout,
                        const uint32_t *normal, const uint32_t *poisson, const float *offset_e,
                        uint16_t *image);

/* The digital numbers (count) of electrons (count) without noise. */
ST_API void st_digitise(const float *electrons, size_t count, const st_readout *readout,
                        uint16_t *image);

/* Add Gaussians (count) at uv (count, 2), integrated over square pixels up to 5 sigma; those of a
 * sigma above 100 px are omitted. */
ST_API void st_add_starlight(const double *uv, const double *electrons, const double *sigma_px,
                             size_t count, const float *response, int32_t width, int32_t height,
                             float *light);

/* Add trails (count, 4): u, v, du, dv of a point and a unit direction. */
ST_API void st_add_trails(const double *trails, size_t count, double peak_e, double sigma_px,
                          const float *response, int32_t width, int32_t height, float *light);

/* Add electrons, spread evenly over tracks (count, 5): u, v of the start, azimuth in rad from +u
 * towards +v, length in px, electrons. */
ST_API void st_add_tracks(const double *tracks, size_t count, int32_t width, int32_t height,
                          float *light);

/* Move the charge above full_well_e along its column. */
ST_API void st_bloom(float *light, int32_t width, int32_t height, double full_well_e);

#ifdef __cplusplus
}
#endif

#endif /* STARTRACKER_SIM_H */
