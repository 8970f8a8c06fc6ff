"""Slopes and batches of laws of reflection, where they are steep and at grazing angles."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from tests.brdf_cases import X, Z, at, flux, numbers, tilted, unit
from torchlc.brdf import MODELS, incidence

GRAZING = [(0.0, 0.0), (30.0, -30.0), (30.0, 10.0), (89.9, -89.8), (89.99, 20.0), (60.0, -61.0)]
WIDTHS_AND_INDICES = [(1e-3, 1.5), (0.01, 1.001), (0.3, 1.33), (1.0, 4.9)]
STEEP = {
    "ashikhmin-shirley": [{"n": n, "r_spec": 0.3, "r_diff": 0.4} for n in (0.0, 1.0, 1e2, 1e4, 1e6)]
    + [{"n_u": 30.0, "n_v": 3e3, "r_spec": 0.3, "r_diff": 0.4}],
    "lambert": [{"albedo": 0.4}],
    "lommel-seeliger-lambert": [{"weight": 0.2, "albedo": 0.4}],
    "phong-mirror": [{"n": n, "r_spec": 0.3, "r_diff": 0.4} for n in (0.0, 1.0, 1e2, 1e4, 1e6)],
    "phong-half": [{"n": n, "r_spec": 0.3, "r_diff": 0.4} for n in (0.0, 1.0, 1e2, 1e4, 1e6)],
    "cook-torrance": [{"m": m, "f0": 0.3, "r_diff": 0.4} for m in (1e-3, 0.01, 0.3, 1.0)],
    "beckmann": [{"alpha": alpha, "f0": 0.3, "r_diff": 0.4} for alpha in (1e-3, 0.01, 0.3, 1.0)],
    "ggx": [{"alpha": alpha, "f0": 0.3, "r_diff": 0.4} for alpha in (1e-3, 0.01, 0.3, 1.0)],
    "ggx-lambert": [{"alpha": alpha, "f0": 0.3, "r_diff": 0.4} for alpha in (1e-3, 0.01, 0.3, 1.0)],
    "ggx-dielectric": [{"alpha": alpha, "ior": ior, "r_diff": 0.4} for alpha, ior in WIDTHS_AND_INDICES],
    "ggx-conductor": [
        {"alpha": a, "eta": n - 0.9, "k": 2.0 * n, "r_diff": 0.1} for a, n in WIDTHS_AND_INDICES
    ],
    "cook-torrance-dielectric": [{"m": m, "ior": ior, "r_diff": 0.4} for m, ior in WIDTHS_AND_INDICES],
    "cook-torrance-conductor": [
        {"m": m, "eta": n - 0.9, "k": 2.0 * n, "r_diff": 0.1} for m, n in WIDTHS_AND_INDICES
    ],
    "oren-nayar": [{"albedo": 0.4, "sigma": sigma} for sigma in (0.0, 1.0, 15.0, 40.0)],
    "eon": [{"albedo": 0.9, "roughness": roughness} for roughness in (0.0, 0.1, 0.6, 1.0)],
}


@pytest.mark.parametrize("name", STEEP)
def test_gradients_match_central_differences(name: str) -> None:
    """Along every value and along a turn of the normal, from h = n to grazing light.

    Steps are 1e-5 of the value, and 1e-4 of the lobe's width for the turn: truncation stays below 1e-7.
    """
    model = MODELS[name]
    for values in STEEP[name]:
        width = min(float(model.lobe_variance(numbers(**values))) ** 0.5, 0.1)
        for angle_i, angle_r in GRAZING:
            s, o = at(angle_i), at(angle_r, 5.0)

            def flux_of(theta: Tensor, values: dict = values, s: Tensor = s, o: Tensor = o) -> Tensor:
                given = dict(zip(values, theta[:-1], strict=True))
                return flux(model, given, *tilted(theta[-1]), s, o).sum()

            theta = torch.tensor([*values.values(), 0.0], dtype=torch.float64)
            steps = torch.tensor([*(1e-5 * max(v, 1e-3) for v in values.values()), 1e-4 * width]).double()
            gradient = torch.autograd.functional.jacobian(flux_of, theta)
            scale = flux_of(theta).abs()
            for k, step in enumerate(steps):
                move = torch.zeros_like(theta)
                move[k] = step
                numeric = (flux_of(theta + move) - flux_of(theta - move)) / (2 * step)
                floor = float(2e-12 * scale / step) + 1e-100  # roundoff of the difference
                assert float(gradient[k]) == pytest.approx(float(numeric), rel=2e-5, abs=floor), (values, k)


@pytest.mark.parametrize("name", STEEP)
def test_pairs_without_weight_leave_no_trace(name: str) -> None:
    """Opposed, tangential, behind, and h = n exactly: finite values and first and second derivatives."""
    model = MODELS[name]
    s = torch.stack([Z, X, -Z, Z, at(90.0), at(120.0), Z]).requires_grad_()
    o = torch.stack([-Z, -X, -Z, Z, at(90.0, 180.0), at(120.0, 180.0), X])
    for values in STEEP[name]:
        given = {k: v.requires_grad_() for k, v in numbers(**values).items()}
        out = flux(model, given, Z, X, s, o)
        gradients = torch.autograd.grad(out.sum(), [s, *given.values()], create_graph=True)
        second = torch.autograd.grad(sum(g.sum() for g in gradients), [s, *given.values()], allow_unused=True)
        assert bool(torch.isfinite(out).all())
        assert all(bool(torch.isfinite(g).all()) for g in (*gradients, *second) if g is not None)
        assert out[[0, 2, 5]].abs().max() == 0
        assert not gradients[0][[0, 2, 5]].any()


@pytest.mark.parametrize("name", STEEP)
def test_batches_agree_with_loops_and_vmap(name: str) -> None:
    model, (s, o) = MODELS[name], (unit(1, 9, seed=3, up=True), unit(1, 9, seed=4, up=True))
    angles = incidence(unit(20, 1, seed=5, up=True), X, s, o)
    table = model.tabulate(angles, angles.lit_and_seen.double())
    rows = [numbers(**values) for values in STEEP[name][:4]]
    batch = {key: torch.stack([row[key] for row in rows]) for key in rows[0]}
    whole = model.parts(table, batch)
    mapped = torch.func.vmap(lambda values: model.parts(table, values))(batch)
    for part in (0, 1):
        assert whole[part].shape == (len(rows), 9)
        torch.testing.assert_close(whole[part], mapped[part], rtol=1e-13, atol=0)
        for k, row in enumerate(rows):
            torch.testing.assert_close(whole[part][k], model.parts(table, row)[part], rtol=1e-13, atol=0)


def test_every_law_is_tried() -> None:
    assert set(STEEP) == set(MODELS)
