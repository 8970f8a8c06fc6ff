"""A law of reflection as a torch module: its bounds, its training, its storage, and what it refuses."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from tests.brdf_cases import SHORT, X, Z, any_values, at, unit
from torchlc import brdf
from torchlc.brdf import MODELS
from torchlc.errors import InputError


@pytest.mark.parametrize("name", MODELS)
@SHORT
@given(data=st.data())
def test_values_survive_storage(name: str, data: st.DataObject) -> None:
    """Fixed values to the last digit, learnable ones to the nudge off a bound."""
    values = data.draw(any_values(MODELS[name]))
    fixed, learnable = (MODELS[name](**values, learnable=flag).values() for flag in (False, True))
    for quantity in MODELS[name].quantities:
        assert float(fixed[quantity.name]) == values[quantity.name]
        spread = (
            (quantity.high - quantity.low)
            if quantity.prior != "loguniform"
            else 20 * (values[quantity.name] + 1)
        )
        assert float(learnable[quantity.name].detach()) == pytest.approx(
            values[quantity.name], rel=1e-12, abs=2.1e-9 * spread
        )


def test_paper_values_on_the_bound() -> None:
    for sums in ((0.8, 0.2), (0.7, 0.3), (0.1, 0.9), (1.0, 0.0), (0.0, 1.0)):
        model = MODELS["ashikhmin-shirley"](n=0.0, r_spec=sums[0], r_diff=sums[1], learnable=False)
        assert (float(model.n), float(model.r_spec), float(model.r_diff)) == (0.0, *sums)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("optimiser", [torch.optim.SGD, torch.optim.Adam])
def test_no_step_leaves_the_bounds(name: str, optimiser: type[torch.optim.Optimizer]) -> None:
    values = {q.name: 0.3 * (1 if q.high <= 1 else q.high) for q in MODELS[name].quantities}
    model = MODELS[name](**values)
    steps = optimiser(model.parameters(), lr=3.0)  # type: ignore[call-arg]
    generator = torch.Generator().manual_seed(8)
    for _ in range(200):
        for parameter in model.parameters():
            parameter.grad = 10 * torch.randn((), generator=generator, dtype=torch.float64)
        steps.step()
        now = model.values()
        for quantity in model.quantities:
            assert quantity.low <= float(now[quantity.name].detach()) <= quantity.high
        assert float(sum(now[part].detach() for part in model.simplex)) <= 1.0


def test_module_works_in_a_training_script() -> None:
    """state_dict, deepcopy, functional_call, jacfwd, vmap over parameters, and Adam finding its way back."""
    s, o = at(20.0).expand(30, 3), torch.stack([at(float(a), 180.0) for a in np.linspace(0, 60, 30)])
    truth = MODELS["ashikhmin-shirley"](n=300.0, r_spec=0.4, r_diff=0.2)
    target = truth(Z, X, s, o).detach()
    model = MODELS["ashikhmin-shirley"](n=50.0, r_spec=0.1, r_diff=0.5)
    assert "n=50" in repr(model)
    assert "learnable" in repr(model)

    other = copy.deepcopy(model)
    other.load_state_dict(truth.state_dict())
    torch.testing.assert_close(other(Z, X, s, o), target, rtol=0, atol=0)

    state = {name: p.detach() for name, p in truth.named_parameters()}

    def call(parameters: dict[str, Tensor]) -> Tensor:
        return torch.func.functional_call(model, parameters, (Z, X, s, o))

    torch.testing.assert_close(call(state), target, rtol=0, atol=0)
    forward = torch.func.jacfwd(call)(state)
    reverse = torch.func.jacrev(call)(state)
    for name in state:
        torch.testing.assert_close(forward[name], reverse[name], rtol=1e-10, atol=1e-14)
    many = {name: p + torch.linspace(0, 1, 3, dtype=torch.float64) for name, p in state.items()}
    mapped = torch.func.vmap(call)(many)
    torch.testing.assert_close(mapped[0], target, rtol=1e-12, atol=0)

    adam = torch.optim.Adam(model.parameters(), lr=0.05)
    for _ in range(1500):
        adam.zero_grad()
        torch.log(model(Z, X, s, o) / target).square().mean().backward()
        adam.step()
    assert float(model.n.detach()) == pytest.approx(300.0, rel=1e-3)
    assert float(model.r_spec.detach()) == pytest.approx(0.4, rel=1e-3)


def test_batch_of_materials_and_single_precision() -> None:
    n = torch.tensor([1.0, 100.0, 1e4], dtype=torch.float32)
    model = MODELS["ashikhmin-shirley"](n=n, r_spec=0.3, r_diff=0.3, dtype=torch.float32)
    s, o = unit(5, 2, seed=9, up=True).float(), unit(2, seed=10, up=True).float()
    out = model(Z.float(), X.float(), s, o)
    assert out.shape == (3, 5, 2)
    assert out.dtype == torch.float32
    for k in range(3):
        single = MODELS["ashikhmin-shirley"](n=float(n[k]), r_spec=0.3, r_diff=0.3)
        expected = single(Z, X, s.double(), o.double())
        torch.testing.assert_close(out[k].double(), expected, rtol=1e-2, atol=1e-6)
    assert model(Z.float(), X.float(), Z.float(), Z.float()).shape == (3,)


@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"n": 10.0, "r_spec": 0.5}, "missing"),
        ({"n": 10.0, "r_spec": 0.6, "r_diff": 0.6}, "at most 1"),
        ({"n": -1.0, "r_spec": 0.5, "r_diff": 0.5}, "0 to 1e+06"),
        ({"n": float("nan"), "r_spec": 0.5, "r_diff": 0.5}, "nan"),
        ({"n": 1.0, "r_spec": 0.5, "r_diff": 0.5, "gloss": 1.0}, "unknown"),
    ],
)
def test_impossible_values_are_refused_with_a_reason(values: dict[str, float], word: str) -> None:
    with pytest.raises(InputError, match=word.replace("+", r"\+")):
        MODELS["ashikhmin-shirley"](**values)


def test_models_are_found_without_a_list() -> None:
    """The scene format's seven names, and those beyond it; a class of one's own joins by being defined."""
    promised = {"ashikhmin-shirley", "lambert", "lommel-seeliger-lambert", "phong-mirror", "phong-half"}
    assert promised | {"beckmann", "cook-torrance", "ggx", "ggx-lambert"} | {"oren-nayar", "eon"} | {
        f"{law}-{kind}" for law in ("ggx", "cook-torrance") for kind in ("dielectric", "conductor")
    } == set(MODELS)
    mine = type("Mine", (MODELS["lambert"],), {"model": "mine"})
    assert brdf.MODELS.pop("mine") is mine
    assert all(
        quantity.meaning and quantity.low < quantity.high
        for m in MODELS.values()
        for quantity in m.quantities
    )
