# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Gates of chi-square against SciPy."""

import pytest
from scipy.special import chdtri
from startracker_ros.core.maths.gates import gate


@pytest.mark.parametrize('probability', [0.3, 0.05, 1e-3, 1e-6, 1e-12])
@pytest.mark.parametrize('dof', [1, 2, 3, 4, 16, 17.3, 250, 5000])
def test_a_gate_is_the_quantile_of_chi_square(probability, dof):
    assert gate(probability, dof) == pytest.approx(chdtri(dof, probability), rel=1e-11)
