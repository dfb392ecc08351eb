import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mapping.evidence import OCCUPIED_PROBABILITY, EvidenceModel, occupied, probability, to_units

units = st.integers(-(2**31), 2**31 - 1)


def one(value):
    return np.array([value], np.int32)


@given(st.integers(-3000, 3000))
def test_probability_is_equation_7_in_its_right_form(value):
    p = float(probability(one(value))[0])
    assert p == pytest.approx(1 - 1 / (1 + math.exp(value / 100)), abs=1e-15)


@given(st.integers(-700, 700))
def test_probability_undoes_equation_6(value):
    p = float(probability(one(value))[0])
    assert 100 * math.log(p / (1 - p)) == pytest.approx(value, abs=1e-6)


def test_nothing_known_is_one_half():
    assert probability(np.zeros((2, 3), np.int32)).tolist() == [[0.5] * 3] * 2


def test_the_misprinted_equation_7_has_a_pole_where_nothing_is_known():
    """1 - 1 / (1 - exp l), as printed: no probability at l = 0, and none anywhere else."""

    def misprinted(log_odds):
        return 1 - 1 / (1 - math.exp(log_odds))

    with pytest.raises(ZeroDivisionError):
        misprinted(0.0)
    assert misprinted(0.85) > 1
    assert misprinted(-0.40) < 0


@given(units, units)
def test_more_evidence_is_never_less_probable(a, b):
    low, high = probability(np.array(sorted([a, b]), np.int32))
    assert 0 <= low <= high <= 1


@given(units)
def test_evidence_against_is_as_strong_as_evidence_for(value):
    value = max(value, -(2**31) + 1)
    assert probability(one(value))[0] + probability(one(-value))[0] == pytest.approx(1)


def test_the_ends_of_int32_are_certain():
    assert probability(np.array([-(2**31), 2**31 - 1], np.int32)).tolist() == [0, 1]


@given(units)
def test_occupied_is_a_probability_above_the_threshold(value):
    assert occupied(one(value))[0] == (probability(one(value))[0] > OCCUPIED_PROBABILITY)


def test_62_units_are_occupied_and_61_are_not():
    assert occupied(np.array([61, 62], np.int32)).tolist() == [False, True]


def test_the_defaults_are_the_designs():
    assert EvidenceModel() == EvidenceModel(to_units(0.85), to_units(-0.40), to_units(0.0)) == EvidenceModel(85, -40, 0)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"occupied": 0}, "evidence: occupied is 0, expected 1 to 10000"),
        ({"occupied": -1}, "evidence: occupied is -1, expected 1 to 10000"),
        ({"occupied": 10_001}, "evidence: occupied is 10001, expected 1 to 10000"),
        ({"free": 0}, "evidence: free is 0, expected -10000 to -1"),
        ({"free": 40}, "evidence: free is 40, expected -10000 to -1"),
        ({"free": -10_001}, "evidence: free is -10001, expected -10000 to -1"),
        ({"limit": -1}, r"evidence: limit is -1, expected 0 \(none\) to 10000"),
        ({"limit": 10_001}, r"evidence: limit is 10001, expected 0 \(none\) to 10000"),
    ],
)
def test_a_model_of_no_use_is_refused(values, message):
    with pytest.raises(ValueError, match=message + r" .*0\.01 nat" if "free" not in values else message):
        EvidenceModel(**values)


def test_the_extremes_are_models():
    EvidenceModel(1, -1, 0)
    EvidenceModel(10_000, -10_000, 10_000)
