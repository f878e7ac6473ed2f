# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Streaks of smeared stars, and artefacts that used to starve the stars, on simulated images."""

import numpy as np
import pytest
from skies import SMALL_CAMERA as CAMERA
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.centroid.extraction import CentroidExtractor, ExtractionOptions
from startracker_ros.sim.sky.artefacts import ArtefactOptions
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.rows import mean_chi_square_bounds

SMEAR = DetectorOptions(motion_smear=True, exposure_s=0.1)


def taken(rate_deg_s, seed=0, detector=SMEAR, artefacts=ArtefactOptions()):
    motion = motion_from_options(MotionOptions(
        motion='constant_rate', ra_deg=200.0 + 20 * seed, dec_deg=25.0, rate_deg_s=rate_deg_s))
    return SkySimulator(CAMERA, motion, load_catalog(), 2026.5, detector_options=detector,
                        artefact_options=artefacts, seed=seed).frame(1.0)


def true_streak(rate_deg_s, exposure_s=0.1):
    """Return the streak in the middle of the image, and the roll."""
    x, y, z = np.radians(rate_deg_s) * exposure_s
    return np.array([-y, x]) * CAMERA.fx, -z


def residuals(extraction, frame, within_px=3.0):
    """Return the errors (K, 2) of the centroids of catalogue stars."""
    stars = frame.stars.uv[frame.stars.magnitude < 7]
    distance = np.linalg.norm(extraction.centroids.uv[:, None] - stars, axis=-1)
    near = distance.min(axis=1) < within_px
    return near, extraction.centroids.uv[near] - stars[distance.argmin(axis=1)[near]]


@pytest.mark.parametrize('rate_deg_s', [(1.5, 0.5, 0.0), (-2.0, 2.0, 0.5), (3.0, 0.0, -1.0)])
def test_the_image_shows_its_streak(rate_deg_s):
    found = CentroidExtractor().measure(taken(rate_deg_s).image).streak
    assert found is not None
    true, roll = true_streak(rate_deg_s)
    # A streak and its opposite look the same.
    sign = np.sign(true @ [found.u_px, found.v_px])
    assert sign * np.array([found.u_px, found.v_px]) == pytest.approx(true, abs=0.3)
    assert sign * found.roll == pytest.approx(roll, abs=2e-3)


def test_errors_along_and_across_a_streak_are_those_of_its_covariance():
    squares, counts = np.zeros(2), 0
    for seed in range(6):
        frame = taken((2.5, 1.0, 0.0), seed)
        extraction = CentroidExtractor().measure(frame.image)
        near, error = residuals(extraction, frame)
        # The covariance is that of a star whose pixels no other one shares.
        uv = extraction.centroids.uv[near]
        alone = np.sort(np.linalg.norm(uv[:, None] - frame.stars.uv, axis=-1))[:, 1] > 8
        values, axes = np.linalg.eigh(extraction.centroids.covariance[near][alone])
        assert (values[:, 1] > 1.5 * values[:, 0]).mean() > 0.5
        whitened = np.einsum('kji,kj->ki', axes, error[alone]) / np.sqrt(values)
        squares += (whitened ** 2).sum(axis=0)
        counts += len(whitened)
    assert counts > 60
    low, high = mean_chi_square_bounds(1, counts)
    assert (squares / counts > low).all() and (squares / counts < high).all()


def test_a_known_streak_needs_no_search_of_the_image():
    frame = taken((2.0, -1.0, 0.3))
    extractor = CentroidExtractor()
    whole, searched = extractor.search(frame.image)
    predicted = frame.stars.uv[frame.stars.magnitude < 6.5]
    near, _ = extractor.search_near(frame.image, predicted, np.full(len(predicted), 3.0),
                                    searched, whole.streak)
    matched, error = residuals(near, frame)
    assert matched.all() and len(near.centroids) > 0.6 * len(predicted)
    assert np.sqrt((error ** 2).mean()) < 0.5


def test_chance_does_not_reject_faint_streaks():
    seen = visible = 0
    for seed in range(8):
        frame = taken((8.0, -6.0, 0.0), seed, DetectorOptions(motion_smear=True, exposure_s=0.02))
        extraction = CentroidExtractor().measure(frame.image)
        # The light of a streak is spread over its length times 2 sqrt(pi) sigma.
        area_px = 8.5 * 2 * np.sqrt(np.pi) * extraction.psf_sigma_px
        snr = frame.flux_dn / (extraction.noise_dn * np.sqrt(area_px))
        inside = ((frame.stars.uv > 15) & (frame.stars.uv < 496)).all(axis=1)
        stars = frame.stars.uv[inside & (snr > 7) & (snr < 15)]
        distance = np.linalg.norm(stars[:, None] - extraction.centroids.uv, axis=-1)
        seen += np.count_nonzero((distance < 2).any(axis=1))
        visible += len(stars)
    assert visible > 40 and seen > 0.85 * visible


def test_points_near_predictions_are_those_of_the_search():
    frame = taken((0.01, 0.0, 0.0))
    extractor = CentroidExtractor()
    whole, searched = extractor.search(frame.image)
    predicted = whole.centroids.uv + 0.7
    near, _ = extractor.search_near(frame.image, predicted, np.full(len(predicted), 2.5),
                                    searched)
    distance = np.linalg.norm(near.centroids.uv[:, None] - whole.centroids.uv, axis=-1)
    assert len(near.centroids) > 0.9 * len(whole.centroids)
    assert np.median(distance.min(axis=1)) < 0.02
    empty, _ = extractor.search_near(frame.image, np.array([[100.5, 100.5]]), np.ones(1),
                                     searched)
    assert len(empty.centroids) <= 1


@pytest.mark.parametrize('artefacts', [
    {'trails': 3, 'trail_peak_e': 2000.0}, {'saturated_columns': 3, 'saturated_rows': 2},
    {'warm_columns': 10, 'warm_column_dn': 100.0}])
def test_lines_do_not_starve_the_stars(artefacts):
    still = DetectorOptions()
    clean = CentroidExtractor().measure(taken((0.01, 0.0, 0.0), detector=still).image)
    frame = taken((0.01, 0.0, 0.0), detector=still, artefacts=ArtefactOptions(**artefacts))
    found = CentroidExtractor().measure(frame.image)
    distance = np.linalg.norm(clean.centroids.uv[:, None] - found.centroids.uv, axis=-1)
    assert (distance.min(axis=1) < 0.5).mean() > 0.6
    assert found.rejected['line'] > 5 and len(found.rejected_uv) >= found.rejected['line']


def test_a_storm_of_hits_does_not_starve_the_stars():
    image = taken((0.01, 0.0, 0.0), detector=DetectorOptions()).image
    rng, hit = np.random.default_rng(1), image.astype(float)
    u, v = rng.integers(0, 512, (2, 2600))
    hit[v, u] += rng.exponential(800.0, 2600)
    clean = CentroidExtractor().measure(image)
    found = CentroidExtractor().measure(np.minimum(hit, 4095).astype(np.uint16))
    distance = np.linalg.norm(clean.centroids.uv[:, None] - found.centroids.uv, axis=-1)
    assert (distance.min(axis=1) < 0.5).mean() > 0.6
    assert found.rejected['hot_pixel'] > 1500


def test_each_row_has_its_time():
    frame = taken((0.01, 0.0, 0.0), detector=DetectorOptions())
    for direction, sign in (('down', 1), ('up', -1)):
        extractor = CentroidExtractor(ExtractionOptions(
            line_time_us=20.0, readout_direction=direction))
        centroids = extractor.measure(frame.image).centroids
        np.testing.assert_allclose(
            centroids.delay_s, sign * 20e-6 * (centroids.uv[:, 1] - 255.5), atol=1e-12)
