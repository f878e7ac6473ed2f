# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The tables, figures and claims of the five papers, each with the rows that show its state."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """
    One table, figure or claim of a paper.

    rows is a regular expression of the rows that show it, picture a part of the path of its
    picture. state is what holding rows and a drawn picture mean: reproduced, better, differs or
    cannot be; why is its reason.
    """

    item: str
    says: str
    rows: str = ''
    picture: str = ''
    state: str = 'reproduced'
    why: str = ''


@dataclass(frozen=True)
class Paper:
    """A paper, the campaigns that repeat it, the cases of its main figures and its claims."""

    name: str
    source: str
    campaigns: tuple[str, ...]
    headlines: tuple[str, ...]
    claims: tuple[Claim, ...]


_MATLAB = 'MATLAB and an older machine there: times are not comparable'

_JPDAF = Paper(
    'JPDAF star tracking', 'Sadeghi, Sabahi, Saberali: four stars confirmed by the star '
    'neighbourhood approach (SNA) and filtered by JPDAF; TRIAD.', ('jpdaf',),
    # Of both readings of the angle the one with the larger ratio, without and with jitter.
    ('turning, 0 deg/s, 0.02 px^2: whole angle, over SNA',
     'turning, 0.5 deg/s, 0.02 px^2: whole angle, over SNA',
     'linear, 0.5 deg/s, 0.01 px^2: whole angle, over SNA'), (
        Claim('table, turning', 'error of SNA and JPDAF over it, nine cells of jitter and noise',
              r'^turning.*: (SNA|(boresight|whole angle), over SNA)$',
              why='both readings of the angle; jitter measured, as in the paper'),
        Claim('table, linear', 'error of SNA and JPDAF over it, nine cells of jitter and noise',
              r'^linear.*: (SNA|(boresight|whole angle), over SNA)$',
              why='both readings of the angle; jitter measured, as in the paper'),
        Claim('figures 2, 5, 6', 'path of a star under jitter, 400 frames; tracks of four stars, '
              'linear and turning', picture='jpdaf_tracks',
              why='one run of each motion; 400 frames turn the image by 2.7 deg, drawn ten '
                  'times as far'),
        Claim('figures 7, 8', 'attitude error over 400 frames', picture='jpdaf_run',
              why='one run of each motion; the mean of all runs is the picture jpdaf'),
        Claim('figures 9, 10', 'distance of estimated and true position of a star',
              picture='jpdaf_run', why='the first star of the same runs'),
        Claim('position table', 'mean square position error', 'mean square position error',
              why='announced by the paper and not printed: ours stands alone'),
        Claim('variants', 'association normalised by rows and columns, confirmation by SNA',
              'of the frames', why='each of the six holds the ratios of the paper; confirmation '
              'costs some frames'),
        Claim('claim', 'beyond the paper: jitter that is not measured', 'jitter unknown',
              state='differs', why='harder than the experiment of the paper: the coupled filter '
              'meets its ratios of the boresight, and the star-by-star filters miss some of the '
              'whole angle, as the bounds of the rows tell'),
        Claim('claim', 'beyond the paper: attitude and rate in one filter', 'Cramer-Rao bound',
              state='better', why='within a tenth of the bound; filters of single stars are '
              'not'),
        Claim('claim', 'beyond the paper: covariance of the attitude', 'normalised error squared',
              state='differs', why='without jitter that of the coupled filter is up to three '
              'times as large as its errors squared: six rows do not hold'),
    ))

_HAUSDORFF = Paper(
    'Hausdorff distance', 'Zahednamazi, Toloei, Ghasemi 2023: five bright stars by one number, '
    'the Hausdorff distance of two sets; pivot and segmentation approach.', ('hausdorff',),
    ('pivot, V 6: correct, 0.0005 px, at pivots', 'segment, V 6: correct, 0.0005 px, at pivots',
     'pivot, V 6: time', 'pivot, V 6: time of the Pyramid on the same frames'), (
        Claim('database', 'sets of both approaches at four magnitude limits', r': sets$',
              why='within 1 %: our magnitudes put some stars more within a limit'),
        Claim('table, pivot', 'none, correct and wrong at four limits',
              r'^pivot, V .*: (none|correct|wrong), (no noise|0\.0005)',
              why='the paper states no noise: 0.0005 px give its figures within the chance of '
                  'its 200 draws, none gives fewer wrong answers'),
        Claim('table, segmentation', 'none, correct and wrong at four limits; 10.15 and 0.15 are '
              'misprints', r'^segment, V .*: (none|correct|wrong), (no noise|0\.0005)',
              why='as for the pivots'),
        Claim('noise', 'not in the paper: 0.1 px at pivots and anywhere, verified by the field',
              r': (correct|wrong), 0\.1 px', state='better', why='as published, it fails there; '
              'beyond, no answer is wrong'),
        Claim('table, times', '37.4, 64.6, 36.4 and 63.4 ms', r': time$',
              picture='figures_10_11_12', state='differs', why=_MATLAB),
        Claim('figures 10, 11', 'faster than the Pyramid, more than 1.3 s at V 6',
              r'time of the Pyramid', picture='figures_10_11_12', state='differs',
              why='our Pyramid is compiled and faster than the nearest set, whose time is that of '
                  'a few NumPy calls: the order of the paper is that of its MATLAB programs'),
        Claim('claim', 'the Pyramid identifies 95.8 % at V 6', r'^pyramid, V 6: correct',
              state='better', why='ours is verified by all stars of the field'),
        Claim('figure 12', 'far faster than geometric structures of five stars, > 15 s at V 4',
              r'20 deg, V 4: time', picture='figures_10_11_12', why='a structure of the same '
              'authors, of 2018, stands for the three of 2020, which are not printed'),
        Claim('claim', 'database built in less than an hour and a few hours; Pyramid up to a '
              'week, five stars weeks', r'build of the database', state='differs',
              why='seconds and less with ours for all but five stars, on another machine; the '
                  'Pyramid in no more time than the others'),
        Claim('claim', 'limits: a star at the centre, the width of the segments',
              r': (none|correct), 0\.1 px, anywhere', state='better',
              why='every star is a pivot, several points about the centre are'),
    ))

_GRID_WHY = "at the paper's scale of 28.1 arcsec a pixel, by the grid alone and verified"

_GRID = Paper(
    'Extended grid', 'Qian, Sun, Cai, Huang: grid patterns in an image that gyro and catalogue '
    'extend, for fields of 4 deg.', ('extended-grid',),
    ('success, 1 px, 0.2 mag, 1 s, V <= 7.4, as few stars as in the paper',
     'success, 0.35 px, 0.2 mag, 1 s, V <= 7.4, as few stars as in the paper'), (
        Claim('claim', 'success > 97.4 % at 1 px', r'^success, 1 px, 0\.2 mag, 1 s(, none falsely'
              r')?$', why=_GRID_WHY),
        Claim('claim', '98.2 % at 0.35 px, period 1 s',
              r'^success, 0\.35 px, 0\.2 mag, 1 s(, none falsely)?$', why=_GRID_WHY),
        Claim('claim', '97.6 % with a period of 10 s', r'^success, 0\.3 px, 0\.2 mag, 10 s',
              why=_GRID_WHY),
        Claim('claim', '99.4 % without noise: 0.6 % of the frames hold fewer than two stars',
              r'^success, no noise', why='with Hipparcos to V 7.5 fewer frames are that '
              'poor; rows of V 7.4 have as few stars as the paper'),
        Claim('claim', '79.71 % of the frames hold six stars, the bound of the plain grid',
              r'^frames of 6 stars or more, .*V <= 7\.4',
              why='at V 7.4 in Hipparcos; at V 7.5 ours has more stars'),
        Claim('claim', 'success at 0.35 and 1 px with as few stars as in the paper',
              r'^success, .*V <= 7\.4', why='at V 7.4, the share of poor frames as printed'),
        Claim('claim', 'nearest neighbour right in 86.7 %, plain grid 52.2 %',
              r'^nearest neighbour',
              why='both shares are those of frames of fewer than six stars, where the plain grid '
                  'is in question; over all frames that of the plain image is larger'),
        Claim('figure 9', 'separations of stars: 0.17, 0.67 and 1.02 %', r'^separations',
              picture='figure_09', why='within 0.15 %: the closest doubles are one star or two, '
              'by the catalogue'),
        Claim('figure 10', 'success over position noise, compared with the extended-image method',
              r'^success (of triangles|lost).*(1 px|0\.35 px)', picture='figures_10_11',
              why='the paper prints curves: ours lose less than those of the triangles'),
        Claim('figure 11', 'success over magnitude noise',
              r'^success (of triangles|lost).*(0\.5 mag)', picture='figures_10_11',
              why='the paper prints curves: ours lose less than those of the triangles'),
        Claim('figures 12, 13', 'success over noise and number of stars',
              picture='figures_12_13', why='the paper prints a curve without figures'),
        Claim('figure 14', 'nearest neighbour over the number of stars', picture='figure_14',
              why='the paper prints a curve without figures'),
        Claim('figures 15, 16', 'success and drift over the period, 0.54 px in 10 s', r'^drift',
              picture='figures_15_16', why='the mean of draws, within a tenth'),
        Claim('figure 17', 'time over the number of stars; 6 ms a frame', r'^time of a frame$',
              picture='figure_17', state='differs', why=_MATLAB),
        Claim('claim', 'a sensor of low sensitivity gives similar results',
              r'low sensitivity', why='8 deg and V 6.2 are ours: the paper prints neither'),
        Claim('claim', 'beyond the paper: verified, no false star', r'^frames with a false star',
              state='better', why='the predicted attitude verifies what the patterns say'),
    ))

_TARGET = Paper(
    'Target by two satellites', 'Gao, Cui 2016: centroids with four weights; a target located by '
    'two satellites in one orbit.', ('centroid', 'two-satellite'),
    ('draws of images that confirm: right threshold: binary is the most accurate',
     'attitude alone, 500 draws', 'all four, 500 draws',
     'all four on one satellite, 500 draws'), (
        Claim('claim', 'right threshold: the binary centroid is the most accurate',
              r': scatter, 1 times|confirm: right', picture='thresholds', state='differs',
              why='on our real images it is the least accurate: the paper shows one image and '
                  'three stars, and the rows how few draws of images confirm it'),
        Claim('claim', 'wrong threshold (1.5 and 2 times): the weighted kinds win',
              r': scatter, (1\.5|2) times|confirm: wrong', picture='thresholds', state='differs',
              why='at twice the threshold all are alike: hardly more than a pixel is left'),
        Claim('claim', 'the thresholded centroid is the least sensitive',
              r': worst over right|confirm: thresholded',
              picture='thresholds', state='differs', why='the binary one is, on our images'),
        Claim('claim', 'model error < 1e-5 m', r'^no noise',
              why='the rounding of floating-point numbers'),
        Claim('table 5', 'position alone < 20 m, velocity < 3.5, attitude < 95, centroid < 15, '
              'all < 100, on one satellite < 75', r'500 draws(, RMS)?$',
              why='orbit, target and camera are ours: the paper does not print them'),
        Claim('table 4', 'Y is the worst axis, X the best', r'axis [XYZ]$', picture='axes',
              why='in an orbit whose orientation is ours'),
        Claim('claim', 'attitude makes 0.90 to 0.95 of the total error, position a quarter and '
              'velocity a thirtieth of the attitude', r'target nearer',
              why="with the target nearer. Where the errors are as large as the paper's, its own "
                  'bounds give a larger share, as does ours: see share below'),
        Claim('claim', 'linear over scales of 0.1 to 10', r'(scale \d|straight line)',
              picture='scales', why='within 1 % of a straight line'),
        Claim('claim', 'near Gaussian on each axis', r'(normal \(|skewness|kurtosis)',
              picture='axes', why='no departure that the draws could show'),
        Claim('claim', 'beyond the paper: weighted, with a covariance that holds',
              r'(normalised error|ellipsoid|over sigma|second attitude)', state='better',
              why='the paper has no covariance'),
    ))

_QUAD = Paper(
    'K-vector and quads', 'Yuan, Zhang, Shi 2017: quads of bright stars by k-vector, triangles '
    'over the field, QUEST.', ('quad',),
    ('orbit: identified, initial mode', 'orbit: time, initial mode, mean',
     'real images, night-sky-11deg: identified of 8, initial mode',
     'real images, night-sky-6deg: identified of 4, initial mode'), (
        Claim('database', '2827 stars, 269421 pairs', r'^database',
              why='within a tenth: other rules for doubles and variables'),
        Claim('table, initial mode', '300 simulated images identified to 100 %, 14 to 23 stars',
              r'^orbit: (identified|wrong|stars i|stars m).*(initial|identified|misnamed)',
              why='as published and verified; the orbit crosses a sky as rich as that of the '
                  'paper'),
        Claim('table, tracking mode', 'the same with the field predicted',
              r'^orbit: (identified|wrong), tracking', why='the frame before predicts the field'),
        Claim('times, simulated', '72.6 ms, 128.6 ms at most; 13 Hz',
              r'^orbit: (time|output)', state='differs', why=_MATLAB),
        Claim('real images', '100 downlinked images identified to 100 %, 89.9 ms, 206.5 ms at '
              'most; 11 Hz', r'^real images.*initial', state='differs',
              why='twelve photographs of two cameras stand in; the downlinked images are not '
                  'public. As published, two of the four of few stars come out wrong; '
                  'verified, none'),
        Claim('figure 5', 'the angles of QUEST run smoothly', r'error of QUEST',
              picture='figure_5', state='differs',
              why='those of the simulated images: the real ones at hand do not follow each '
                  'other'),
        Claim('real images, tracking mode', 'the downlinked images with the field predicted',
              r'^real images.*tracking', state='differs', why='no sequence of real images at hand '
              'may be published: the same twelve, the place before 0.3 deg off'),
        Claim('tolerance', '1e-6 of a cosine', state='cannot be',
              why='an arcsecond at 10 deg, with 0.5 px of noise, 36 arcsec: tolerances follow '
                  'from the noise instead'),
        Claim('claim', 'beyond the paper: verified, over the whole sky', r'^whole sky: (wrong|'
              r'identified)', state='better', why='as published, some of these frames are wrong; '
              'verified, none'),
    ))

PAPERS = (_JPDAF, _HAUSDORFF, _GRID, _TARGET, _QUAD)
