"""The library of known materials, and the odds that a posterior gives them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from torchlc.brdf import MODELS
from torchlc.errors import InputError
from torchlc.materials.known import LibraryMaterial, load_library, match, preset

TABLE_4 = {  # n, r_spec, r_diff as printed
    "Kapton": (12455.8892, 0.8234, 0.1418),
    "Lambert-plate": (0.0719, 0.0220, 0.6350),
    "GaAs": (2233.3101, 0.6427, 0.2746),
    "Al": (596.9783, 0.5746, 0.3685),
}


def draws(count: int = 4000, seed: int = 0, **values: tuple[float, float]) -> dict[str, np.ndarray]:
    """Posterior draws, each a (mean, sd); the exponent's in ln n."""
    random = np.random.default_rng(seed)
    found = {name: random.normal(mean, sd, count) for name, (mean, sd) in values.items()}
    return {name: np.exp(array) if name.startswith("n") else array for name, array in found.items()}


def test_library_holds_the_papers_table_and_builds() -> None:
    library = load_library()
    for name, (n, r_spec, r_diff) in TABLE_4.items():
        assert library[name].values == {"n": n, "r_spec": r_spec, "r_diff": r_diff}
    for material in library.values():
        MODELS[material.model](learnable=False, **material.values)
        assert material.source
        assert material.meaning


@pytest.mark.parametrize(
    "name", ["kapton", "KAPTON", "lambert plate", "Lambert_Plate", "white-paint-silicate"]
)
def test_presets_are_found_however_they_are_spelt(name: str) -> None:
    model, values = preset(name)
    assert set(values) <= {quantity.name for quantity in MODELS[model].quantities} | set(MODELS[model].shared)


def test_an_unknown_preset_names_its_neighbour() -> None:
    with pytest.raises(InputError, match="Did you mean Kapton"):
        preset("captone")


@pytest.mark.parametrize("name", TABLE_4)
def test_a_posterior_at_a_material_finds_it(name: str) -> None:
    n, r_spec, r_diff = TABLE_4[name]
    matches = match(draws(n=(math.log(n), 0.1), r_spec=(r_spec, 0.01), r_diff=(r_diff, 0.01)))
    assert matches[0].name == name
    assert matches[0].probability > 0.7
    assert matches[0].distance is not None
    assert matches[0].distance < 0.1
    assert sum(one.probability for one in matches) == pytest.approx(1.0)


def test_a_posterior_far_from_all_is_other() -> None:
    matches = match(draws(n=(math.log(20.0), 0.1), r_spec=(0.2, 0.01), r_diff=(0.4, 0.01)))
    assert matches[0].name == "other"
    assert matches[0].probability > 0.95
    assert matches[0].distance is None


def test_a_posterior_that_is_the_prior_leaves_the_odds_even() -> None:
    """Nothing was learnt: each class keeps the probability it had, but for the noise of 200000 draws."""
    random = np.random.default_rng(1)
    r_spec, r_diff, _ = random.dirichlet([1, 1, 1], 200_000).T
    samples = {"n": 10 ** random.uniform(0, 6, 200_000), "r_spec": r_spec, "r_diff": r_diff}
    library = {key: value for key, value in load_library().items() if key in ("Kapton", "GaAs", "Al")}
    for one in match(samples, library):
        assert one.probability == pytest.approx(1 / 4, rel=0.06)


def test_odds_of_two_gaussian_classes_have_their_closed_form() -> None:
    """Over Gaussian draws (m, s) a Gaussian (c, w) averages to one of variance s^2 + w^2."""
    sharp = {"n": 0.2, "r_spec": 0.02, "r_diff": 0.03}
    library = {
        name: LibraryMaterial(name, "ashikhmin-shirley", values, sharp, "", "")
        for name, values in {
            "a": {"n": 100.0, "r_spec": 0.3, "r_diff": 0.4},
            "b": {"n": 140.0, "r_spec": 0.33, "r_diff": 0.36},
        }.items()
    }
    posterior = {"n": (math.log(110.0), 0.3), "r_spec": (0.31, 0.03), "r_diff": (0.4, 0.01)}
    evidence = {"other": 2 / math.log(1e6)}
    for name, material in library.items():
        evidence[name] = 1.0
        for key, (mean, sd) in posterior.items():
            centre = math.log(material.values[key]) if key == "n" else material.values[key]
            total = sd**2 + sharp[key] ** 2
            evidence[name] *= math.exp(-((mean - centre) ** 2) / 2 / total) / math.sqrt(2 * math.pi * total)
    found = {one.name: one for one in match(draws(400_000, **posterior), library)}
    for name, value in evidence.items():
        assert found[name].probability == pytest.approx(value / sum(evidence.values()), rel=0.01)
    squares = [
        (math.log(1.1), 0.3, 0.2),
        (0.01, 0.03, 0.02),
        (0.0, 0.01, 0.03),
    ]
    expected = math.sqrt(sum(away**2 / (sd**2 + width**2) for away, sd, width in squares))
    assert found["a"].distance == pytest.approx(expected, rel=0.01)


def test_only_what_was_fitted_is_judged() -> None:
    """One reflectance alone meets the margin 2 (1 - r) of the triangle; two exponents count as their mean."""
    alone = {one.name: one.probability for one in match({"r_spec": np.full(10, 0.82)})}
    assert alone["Kapton"] > alone["other"] > alone["Al"]
    pair = draws(
        n_u=(math.log(12456 * 2), 0.1),
        n_v=(math.log(12456 / 2), 0.1),
        r_spec=(0.82, 0.01),
        r_diff=(0.14, 0.01),
    )
    assert match(pair)[0].name == "Kapton"


def test_materials_of_another_model_are_no_match() -> None:
    names = {one.name for one in match({"albedo": np.full(10, 0.88)}, model="lambert")}
    assert names == {"white-paint-silicate", "white-paint-silicone", "black-paint", "other"}
    assert match({"albedo": np.full(10, 0.88)}, model="lambert")[0].name == "white-paint-silicate"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ("name", "no name"),
        ('model = "lambertian"', "lambertian"),
        ("values = { albedo = 1.2 }", "0 to 1"),
        ("spread = { albedo = 0.0 }", "positive spread"),
        ("spread = {", "materials.toml"),
    ],
)
def test_a_defective_library_is_refused_with_its_place(change: str, word: str, tmp_path: Path) -> None:
    lines = {
        "name": 'name = "paint"',
        "model": 'model = "lambert"',
        "values": "values = { albedo = 0.5 }",
        "spread": "spread = { albedo = 0.1 }",
        "meaning": 'meaning = "m"',
        "source": 'source = "s"',
    }
    key, _, new = change.partition(" ")
    lines[key] = change if new else ""
    path = tmp_path / "materials.toml"
    path.write_text("\n".join(["[[materials]]", *lines.values()]))
    with pytest.raises(InputError, match=word):
        load_library(path)


def test_a_material_listed_twice_is_refused(tmp_path: Path) -> None:
    text = (Path(__file__).parents[1] / "torchlc" / "materials" / "materials.toml").read_text()
    path = tmp_path / "materials.toml"
    path.write_text(text + text[text.index("[[materials]]") :])
    with pytest.raises(InputError, match="Kapton: listed twice"):
        load_library(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_library(tmp_path / "absent.toml")
