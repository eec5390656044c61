"""Fits find what views were made with, and do not believe what is not there."""

import json
from pathlib import Path

import numpy as np
import pytest

from posed_train import trust
from posed_train.bop import DatasetError


def lines(count: int, factors: dict[str, tuple[float, float]], seed: int = 0) -> list[dict]:
    """Views whose stated sigmas are wrong by exp(constant + weight * hint), and which are right more often where the
    hint is small. `noise` says nothing."""
    rng, made = np.random.default_rng(seed), []
    for view in range(count):
        evidence = {"hint": float(rng.normal()), "noise": float(rng.normal())}
        nees = {}
        for part, degrees in trust.PARTS.items():
            constant, weight = factors[part]
            error = np.exp(constant + weight * evidence["hint"]) * rng.normal(size=degrees)
            nees[part] = {"value": float(error @ error), "degrees": degrees}
        right = bool(rng.random() < 1 / (1 + np.exp(-(1.0 - 2.0 * evidence["hint"]))))
        line = {"object": "cube", "scene": f"{view // 8:06d}", "right": right, "evidence": evidence}
        made.append(line | {"nees": nees, "image_nees": nees})
    return made


def test_the_fit_finds_factors_and_probabilities():
    factors = {"depth": (0.5, 0.4), "lateral": (-0.3, 0.0), "rotation": (0.2, -0.3)}
    by_object, figures = trust.fit_trust(trust.collect(lines(1600, factors)))
    (found,) = by_object.values()
    for part, (constant, weight) in factors.items():
        fitted = found["covariance"][part]
        assert fitted["constant"] == pytest.approx(constant, abs=0.1)
        assert fitted["weights"].get("hint", 0.0) == pytest.approx(weight, abs=0.1)
        assert fitted["weights"].get("noise", 0.0) == pytest.approx(0.0, abs=0.1)
    assert found["probability"]["constant"] == pytest.approx(1.0, abs=0.3)
    assert found["probability"]["weights"]["hint"] == pytest.approx(-2.0, abs=0.4)
    assert figures["ok but wrong"] <= trust.MOST_WRONG * figures["ok"]
    assert 0 < figures["ok"] < figures["views"]


def test_what_says_nothing_gets_no_weight():
    made = lines(60, dict.fromkeys(trust.PARTS, (0.0, 0.0)))
    for line in made:
        line["right"] = int(line["scene"]) % 3 > 0
    views = trust.collect(trust.usable(made))
    ridge, held_out, constant_alone = trust.choose(views, "depth")
    assert np.abs(trust.fit(views, "depth", ridge).weights).max() < 0.2
    assert held_out <= constant_alone


def test_the_uncertainty_of_the_offset_stays_in():
    # The image's own errors are honest; half of the total variance is the offset's, which no factor may take away.
    made = lines(1600, dict.fromkeys(trust.PARTS, (0.0, 0.0)))
    for line in made:
        line["image_nees"] = {part: {"value": 2 * found["value"]} for part, found in line["nees"].items()}
    by_object, _ = trust.fit_trust(trust.collect(made))
    (found,) = by_object.values()
    for part in trust.PARTS:
        assert found["covariance"][part]["constant"] == pytest.approx(0.0, abs=0.15)


def test_the_threshold_leaves_few_wrong():
    probability = np.array([0.99, 0.9, 0.8, 0.7])
    assert trust.threshold(probability, np.array([True, True, False, True])) == 0.9
    assert trust.threshold(probability, np.array([False, True, True, True])) == 1.0


def test_trust_is_stored_beside_the_rest(tmp_path: Path):
    manifest = tmp_path / "object.json"
    manifest.write_text(json.dumps({"name": "cube", "trust": 1, "training": {"steps": 3}}))
    trust.store(manifest, {"ok_probability": 0.9})
    stored = json.loads(manifest.read_text())
    assert stored == {"name": "cube", "trust": {"ok_probability": 0.9}, "training": {"steps": 3}}
    with pytest.raises(DatasetError, match="no view got a pose"):
        trust.collect([])


def test_the_service_means_the_same(tmp_path: Path):
    fixture = json.loads((Path(__file__).parents[2] / "tests/data/trust.json").read_text())
    stated = fixture["trust"]
    names = list(stated["ranges"])
    ends = np.array(list(stated["ranges"].values()))
    evidence = np.array([[view["evidence"][name] for name in names] for view in fixture["views"]])
    count = len(evidence)
    nothing = {part: np.ones(count) for part in trust.PARTS}
    objects = np.full(count, "cube")
    seen = trust.Views(
        names, ends, np.clip(evidence, *ends.T), objects, objects, np.ones(count, bool), nothing, nothing
    )

    def fitted(linear: dict) -> trust.Fit:
        return trust.Fit({"cube": linear["constant"]}, np.array([linear["weights"].get(name, 0.0) for name in names]))

    for place, part in enumerate(trust.PARTS):
        factors = np.exp(fitted(stated["covariance"][part]).of(seen))
        np.testing.assert_allclose(factors, [view["factors"][place] for view in fixture["views"]], rtol=1e-6)
    expected = [view["probability"] for view in fixture["views"]]
    np.testing.assert_allclose(trust.probabilities(seen, fitted(stated["probability"])), expected, atol=1e-6)
