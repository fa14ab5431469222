"""The estimator against published results, the documents' closed forms, and scipy's own optimiser."""

from __future__ import annotations

import csv
from math import cos, radians, sin
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from tiltcal.core.closed_forms import (
    scale_from_tilt,
    sensitivity_from_pair,
    tempco_from_two_temperatures,
)
from tiltcal.core.estimate import Design, Observation, estimate
from tiltcal.core.frames import gravity_from_tilt
from tiltcal.errors import EstimateError

DATA = Path(__file__).parents[2] / "shared" / "data"

needs_recorded_data = pytest.mark.skipif(
    not (DATA / "ferraris_session.csv").exists(), reason="the recorded data are not in ../shared/data"
)


def observe(name: str, gravity: tuple[float, float, float], *mean: float, u: float = 0.1, t: float | None = None):
    return Observation(name, np.array(gravity), np.array(mean), np.full(len(mean), u), t)


@needs_recorded_data
class TestRecordedSession:
    """imucal's six-face session: least squares over all six known faces (data/README.md)."""

    OFFSET = (0.55114, -0.61973, 0.38564)
    SENSITIVITY = (
        (9.77673, -0.14501, -0.07316),
        (0.08434, 9.83353, 0.01813),
        (0.13384, 0.02012, 10.03860),
    )
    TWO_FACE_OFFSET = (0.5371, -0.6162, 0.3989)

    @pytest.fixture
    def observations(self) -> list[Observation]:
        with open(DATA / "ferraris_session.csv") as log:
            rows = np.array([[float(row[f"acc_{axis}"]) for axis in "xyz"] for row in csv.DictReader(log)])
        with open(DATA / "ferraris_segments.csv") as segments:
            return [
                Observation(
                    row["position"],
                    np.array([float(row["gx"]), float(row["gy"]), float(row["gz"])]),
                    (still := rows[int(row["start"]) : int(row["end"])]).mean(axis=0),
                    still.std(axis=0) / np.sqrt(len(still)),
                )
                for row in csv.DictReader(segments)
            ]

    def test_unstated_jig_gives_the_published_least_squares(self, observations) -> None:
        found = estimate(observations, Design(("x", "y", "z"), ("x", "y", "z")))
        np.testing.assert_allclose(found.coefficients.offset, self.OFFSET, atol=5.1e-6)
        np.testing.assert_allclose(found.coefficients.sensitivity, self.SENSITIVITY, atol=5.1e-6)
        assert np.abs(found.residuals).max() == pytest.approx(0.026, abs=5e-4)

    def test_with_a_stated_placement_the_published_offsets_are_inside_the_95_percent_intervals(
        self, observations
    ) -> None:
        """With the angles in doubt the face pair along an axis says its offset, as in imucal's formula."""
        found = estimate(observations, Design(("x", "y", "z"), ("x", "y", "z"), jig=0.2))
        u, factors = found.uncertainty(), found.coverage_factors()
        for axis, offset, published in zip("xyz", found.coefficients.offset, self.TWO_FACE_OFFSET, strict=True):
            assert abs(offset - published) < factors[f"offset.{axis}"] * u[f"offset.{axis}"]
            assert u[f"offset.{axis}"] < 0.001


class TestClosedForms:
    """Where the positions leave no freedom the estimator must give what the documents' formulas give."""

    def test_pair_of_tilts(self) -> None:
        """Cross-axis Compensation, eq. 2, with unequal tilts."""
        readings = {30.0: 2.9, -29.0: 1.1}
        found = estimate(
            [observe(str(tilt), gravity_from_tilt({"x": tilt}), u) for tilt, u in readings.items()],
            Design(("x",), ("x",)),
        )
        expected = sensitivity_from_pair(2.9, 1.1, radians(30.0), radians(29.0))
        assert found.coefficients.sensitivity[0, 0] == pytest.approx(expected, rel=1e-12)

    def test_level_and_45(self) -> None:
        """The tilt meter paper's scale, with the angle actually set."""
        found = estimate(
            [
                observe("level", (0, 0, 1), 1020.0, 1030.0),
                observe("x", gravity_from_tilt({"x": 44.8}), 1600.0, 1033.0),
                observe("y", gravity_from_tilt({"y": 45.1}), 1018.0, 1611.0),
            ],
            Design(("x", "y"), ("x", "y")),
        )
        s = found.coefficients.sensitivity
        assert found.coefficients.offset == pytest.approx([1020.0, 1030.0], rel=1e-12)
        assert s[0, 0] == pytest.approx(scale_from_tilt(1600.0, 1020.0, radians(44.8)), rel=1e-12)
        assert s[1, 1] == pytest.approx(scale_from_tilt(1611.0, 1030.0, radians(45.1)), rel=1e-12)

    def test_two_temperatures(self) -> None:
        """The paper's one linear coefficient per axis."""
        found = estimate(
            [observe("warm", (0, 0, 1), 2510.0, t=24.0), observe("cold", (0, 0, 1), 2450.0, t=5.5)],
            Design(("x",), (), drift=1, reference=24.0),
        )
        assert found.coefficients.thermal is not None
        drift = found.coefficients.thermal.drift[0, 0]
        assert drift == pytest.approx(tempco_from_two_temperatures(2510.0, 2450.0, 24.0, 5.5), rel=1e-12)
        assert drift == pytest.approx(60.0 / 18.5, rel=1e-12)


directions = st.tuples(st.floats(-180, 180), st.floats(-90, 90)).map(
    lambda angles: (
        cos(radians(angles[1])) * cos(radians(angles[0])),
        cos(radians(angles[1])) * sin(radians(angles[0])),
        sin(radians(angles[1])),
    )
)


@settings(max_examples=60, deadline=None)
@given(
    extra=st.lists(directions, max_size=8),
    offset=st.floats(-3000, 3000),
    row=st.tuples(st.floats(200, 2000), st.floats(-60, 60), st.floats(-60, 60)),
    drift=st.floats(-5, 5),
    gain=st.floats(-2e-3, 2e-3),
)
def test_recovers_any_coefficients_from_exact_readings(extra, offset, row, drift, gain) -> None:
    """Without noise the truth is the only minimum, whatever the positions beyond the necessary ones."""
    faces = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    conditions = [(g, 20.0) for g in [*faces, *extra]] + [((1, 0, 0), 45.0), ((-1, 0, 0), 45.0)]
    observations = []
    for number, (g, t) in enumerate(conditions):
        dt = t - 25.0
        reading = (
            offset + drift * dt + (1 + gain * dt) * sum(s * component for s, component in zip(row, g, strict=True))
        )
        observations.append(observe(str(number), g, reading, t=t))
    found = estimate(observations, Design(("x",), ("x", "y", "z"), drift=1, gain=1, reference=25.0))
    assert found.coefficients.thermal is not None
    assert found.coefficients.offset[0] == pytest.approx(offset, rel=1e-9, abs=1e-8)
    assert found.coefficients.sensitivity[0] == pytest.approx(row, rel=1e-9, abs=1e-8)
    assert found.coefficients.thermal.drift[0, 0] == pytest.approx(drift, abs=1e-8)
    assert found.coefficients.thermal.gain[0, 0] == pytest.approx(gain, abs=1e-11)


def test_weights_and_covariance_agree_with_scipy() -> None:
    """Unequal stated uncertainties: scipy's general optimiser finds the same minimum and the same covariance."""
    rng = np.random.default_rng(5)
    gravity = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0.6, 0.8, 0], [0.6, -0.8, 0]], dtype=float)
    sigma = np.array([0.1, 0.2, 0.4, 0.1, 0.3, 0.2])
    mean = 5.0 + gravity @ [9.8, 0.2, 0.0] + sigma * rng.standard_normal(6)
    observations = [Observation(str(i), g, mean[i : i + 1], sigma[i : i + 1]) for i, g in enumerate(gravity)]
    found = estimate(observations, Design(("x",), ("x", "y"), jig=0.0))
    peer = least_squares(lambda p: (p[0] + gravity[:, :2] @ p[1:] - mean) / sigma, [0.0, 1.0, 0.0], xtol=1e-15)
    theta = [found.coefficients.offset[0], *found.coefficients.sensitivity[0]]
    np.testing.assert_allclose(theta, peer.x, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(peer.jac.T @ peer.jac), rtol=1e-6)
    assert found.chi_square == pytest.approx(2 * peer.cost, rel=1e-8)
    assert found.dof == 3


class TestRefused:
    def test_three_faces_only(self) -> None:
        faces = [observe(name, g, 1.0) for name, g in zip("xyz", [(1, 0, 0), (0, 1, 0), (0, 0, 1)], strict=True)]
        with pytest.raises(EstimateError, match=r"cannot tell offset\.x"):
            estimate(faces, Design(("x",), ("x", "y", "z")))

    def test_an_axis_that_no_position_excites_is_named(self) -> None:
        level = [observe("a", (0, 0, 1), 1.0), observe("b", (0, 0, -1), -1.0)]
        with pytest.raises(EstimateError, match=r"nothing|says anything of sensitivity\.x\.x"):
            estimate(level, Design(("x",), ("x", "z")))

    def test_a_missing_temperature_names_its_position(self) -> None:
        with pytest.raises(EstimateError, match="level-cold"):
            estimate(
                [observe("level-warm", (0, 0, 1), 1.0, t=24.0), observe("level-cold", (0, 0, 1), 1.0)],
                Design(("x",), (), drift=1),
            )

    def test_one_temperature_for_a_drift(self) -> None:
        with pytest.raises(EstimateError, match=r"temperature\.offset\.x\.1"):
            estimate(
                [observe("a", (0, 0, 1), 1.0, t=24.0), observe("b", (0, 0, 1), 1.0, t=24.0)],
                Design(("x",), (), drift=1, reference=24.0),
            )
