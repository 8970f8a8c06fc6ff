"""The paper's equations 2 to 11 in NumPy, for one walker at a time: all faces and epochs in one expression.

Two forms, both given the geometry: ``Equations`` evaluates them as they stand for every face, ``Prepared``
goes as far as NumPy can: what is free of the materials is tabulated beforehand for the faces that are lit and
seen, wings that share a normal are one face, every power is one exponential, and buffers are reused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from torchlc.inference.likelihood import Likelihood
from torchlc.pairs.facet_pairs import pair_table

MATERIALS = ("body", "panel")
SMALLEST_EXPONENT = -690.0


@dataclass(frozen=True)
class Equations:
    """Cosines (F, T) of incidence, view, half the phase angle and glint; weight (F, T) area / range^2;
    ``material`` (F,) index of the face's; observed magnitudes, errors and the Sun's
    magnitude (T,)."""

    cos_i: np.ndarray
    cos_r: np.ndarray
    cos_half: np.ndarray
    cos_glint: np.ndarray
    weight: np.ndarray
    material: np.ndarray
    observed: np.ndarray
    error: np.ndarray
    sun_magnitude: np.ndarray

    @classmethod
    def of(cls, likelihood: Likelihood) -> Equations:
        model = likelihood.model
        view = model.view(model.values())
        rows: list[tuple[np.ndarray, ...]] = []
        material: list[int] = []
        for patch in view.patches:
            to_sun, to_observer = view.to_sun[0], view.to_observer[0]
            if patch.pose is not None:
                pose = patch.pose[0]
                to_sun, to_observer = ((pose.mT @ v[..., None])[..., 0] for v in (to_sun, to_observer))
            half = to_sun + to_observer
            length = half.norm(dim=-1)
            for normal, area in zip(patch.normal, patch.area, strict=True):
                cosines = (to_sun @ normal, to_observer @ normal, 0.5 * length, half @ normal / length)
                rows.append(tuple(one.numpy() for one in (*cosines, area / view.range_m[0] ** 2)))
                material.append(MATERIALS.index(patch.material))
        return cls(
            *(np.array(column) for column in zip(*rows, strict=True)),
            np.array(material),
            likelihood.observed.numpy(),
            likelihood.error.numpy(),
            model.assembly.sun_magnitude.numpy(),
        )

    def log_likelihood(self, theta: np.ndarray) -> float:
        """Of theta (6,): n, r_spec, r_diff of the body, then of the panels."""
        n, r_spec, r_diff = theta.reshape(2, 3)[self.material].T[..., None]
        fresnel = r_spec + (1 - r_spec) * (1 - self.cos_half) ** 5
        lobe = (n + 1) / (8 * math.pi) * np.maximum(self.cos_glint, 0.0) ** n
        lobe *= fresnel / (self.cos_half * np.maximum(self.cos_i, self.cos_r))
        diffuse = 28 * r_diff / (23 * math.pi) * (1 - r_spec)
        diffuse = diffuse * (1 - (1 - self.cos_i / 2) ** 5) * (1 - (1 - self.cos_r / 2) ** 5)
        seen = (self.cos_i > 0) & (self.cos_r > 0)
        light = np.where(seen, (lobe + diffuse) * self.cos_i * self.cos_r * self.weight, 0.0)
        magnitude = self.sun_magnitude - 2.5 * np.log10(light.sum(0))
        return _normal(self.observed - magnitude, self.error)


class Prepared:
    """Tables of each material by its pairs of lit and seen faces, (K, T), and buffers of their size."""

    def __init__(self, likelihood: Likelihood) -> None:
        model = likelihood.model
        view = model.view(model.values())
        self.tables = []
        for name in MATERIALS:
            found = pair_table(view, [one for one in view.patches if one.material == name], compact=True)
            assert found is not None
            table = [found[key].numpy() for key in ("log_half", "normal", "grazing", "diffuse")]
            self.tables.append((*table, np.empty_like(table[0])))
        self.observed = (likelihood.observed - model.assembly.sun_magnitude).numpy()
        self.error = likelihood.error.numpy()
        self.flux = np.empty_like(self.observed)

    def log_likelihood(self, theta: np.ndarray) -> float:
        """Of theta (6,): n, r_spec, r_diff of the body, then of the panels."""
        self.flux[:] = 0.0
        for (n, r_spec, r_diff), (log_half, normal, grazing, diffuse, lobe) in zip(
            theta.reshape(2, 3), self.tables, strict=True
        ):
            np.multiply(log_half, n, out=lobe)
            np.maximum(lobe, SMALLEST_EXPONENT, out=lobe)
            np.exp(lobe, out=lobe)
            lobe *= normal * r_spec + grazing
            self.flux += (n + 1) * lobe.sum(0)
            self.flux += r_diff * (1 - r_spec) * diffuse
        np.log10(self.flux, out=self.flux)
        self.flux *= 2.5
        self.flux += self.observed
        return _normal(self.flux, self.error)


def _normal(delta: np.ndarray, error: np.ndarray) -> float:
    u = delta / error
    return float(-0.5 * (u @ u) - np.log(error).sum() - 0.5 * len(u) * math.log(2 * math.pi))
