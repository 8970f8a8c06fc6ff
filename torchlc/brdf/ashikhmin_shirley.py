"""Ashikhmin and Shirley (2000): the paper's model, eqs. 2 to 6, isotropic or anisotropic."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchlc.brdf.angles import Incidence, coupled_diffuse, lobe, per_epoch, per_pair, schlick_weight, weighed
from torchlc.brdf.base import Brdf
from torchlc.parameters import EXPONENT, LOBE_REFLECTANCE, REFLECTANCE, Quantity
from torchlc.tensors.autodiff_state import transformed

GRID_STEP = 0.08
"""In log(1 + n): the cubic between errs by step^4 / 384 of n ln(n.h), 1e-6 where a lobe has fallen to exp(-10)."""
COLUMNS_AT_ONCE = 48
"""Rows condensed at once: their pairs stay in the cache."""
DEEP = -60.0
"""Logarithm of a pair's share in the lobe sum of a row below which it is left out of the larger exponents' sums."""
SORTED_FROM = 64
"""Pairs a row from which it pays to look for those."""
STEPS_BETWEEN = 4
"""Steps of the grid after which pairs that no longer count are looked for anew."""
GRID_STEPS = math.ceil(math.log1p(1e6) / GRID_STEP)
"""Of the grid in log(1 + n) on which condensed tables stand, up to n = 1e6."""
FINER = 4
"""Steps for one where a source has an extent: the slope in log(1 + n) jumps by as much as 1 at the exponent at which
the extent stops a pair's lobe from narrowing, which costs a 16th of a step."""


class AshikhminShirley(Brdf):
    """Half-vector cosine-power lobe with Schlick's Fresnel factor, and a diffuse part coupled to it.

    ``n`` sets n_u = n_v. The factor mu0 mu / max(mu0, mu) of eqs. 3, 8 and 9 is taken as min(mu0, mu),
    which has no 0/0 at the limb; the pair min(mu0, mu) / (h.s) is at most 1. Neglected: light scattered
    more than once between microfacets.
    """

    model: ClassVar[str] = "ashikhmin-shirley"
    quantities: ClassVar[tuple[Quantity, ...]] = (
        Quantity(
            "n_u", "", 0.0, 1e6, "lobe exponent along the facet's u axis", prior="loguniform", role=EXPONENT
        ),
        Quantity(
            "n_v", "", 0.0, 1e6, "lobe exponent along the facet's v axis", prior="loguniform", role=EXPONENT
        ),
        Quantity(
            "r_spec", "", 0.0, 1.0, "mirror-like reflectance at normal incidence", role=LOBE_REFLECTANCE
        ),
        Quantity("r_diff", "", 0.0, 1.0, "diffuse reflectance", role=REFLECTANCE),
    )
    simplex: ClassVar[tuple[str, ...]] = ("r_spec", "r_diff")
    coupled: ClassVar[bool] = True
    shared: ClassVar[Mapping[str, tuple[str, ...]]] = {"n": ("n_u", "n_v")}
    along_axes: ClassVar[tuple[str, ...]] = ("n_u", "n_v")
    condensed_over: ClassVar[str] = "n"
    rivals: ClassVar[Mapping[str, Mapping[str, float]]] = {
        "ggx": {"alpha": 0.2, "f0": 0.2},
        "cook-torrance": {"m": 0.2, "f0": 0.2},
        "beckmann": {"alpha": 0.2, "f0": 0.2},
        "ggx-lambert": {"alpha": 0.2, "f0": 0.2},
    }

    @staticmethod
    def tabulate(angles: Incidence, weight: Tensor) -> dict[str, Tensor]:
        """Eq. 6 summed over K; eq. 3 as two weights, F = r_spec (1 - p) + p with p = (1 - h.s)^5."""
        fresnel = schlick_weight(angles.cos_half)
        base = (
            weight * torch.minimum(angles.cos_i, angles.cos_r).clamp(min=0) / (8 * math.pi * angles.cos_half)
        )
        return {
            "log_u": angles.log_u,
            "log_v": angles.log_v,
            "log_half": angles.log_half,
            "normal": base * (1 - fresnel),
            "grazing": base * fresnel,
            "diffuse": (weight * coupled_diffuse(angles)).sum(-2),
        }

    @staticmethod
    def condense(table: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """The sums over K of an isotropic lobe as functions of log(1 + n), for cubic Hermite interpolation of
        their logarithms (relative error 1e-7 per unit of n log(n.h); where a source has an extent 1.5e-3, and 4e-3 per
        unit of n log(n.h) in the one cell in which the lobe becomes as narrow as its source): a call
        then costs the same however many facets, instants or lights there are. ``lobes`` (2 G, 2 T) has a row for
        the values and one for the slopes at each of G exponents; the normal sums of all T and then the grazing
        ones.
        """
        columns = range(0, table["diffuse"].shape[-1], COLUMNS_AT_ONCE)
        cuts = [slice(start, start + COLUMNS_AT_ONCE) for start in columns]
        finer, smooth = _fine_steps(table)
        pieces = [
            _condensed({name: tensor[..., cut] for name, tensor in table.items()}, finer, smooth)
            for cut in cuts
        ]
        return {"diffuse": table["diffuse"], "lobes": torch.cat(pieces, -1).flatten(2).flatten(0, 1)}

    @staticmethod
    def parts(table: Mapping[str, Tensor], values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Eqs. 3 and 6 summed over K."""
        if "lobes" in table:
            r_spec, r_diff = per_epoch(values["r_spec"]), per_epoch(values["r_diff"])
            normal, grazing = interpolated(table, exponents(values)[0])
            return r_spec * normal + grazing, r_diff * (1 - r_spec) * table["diffuse"]
        return AshikhminShirley.parts_of_lobe(table, values, cosine_power(table, *exponents(values)))

    @staticmethod
    def parts_of_lobe(
        table: Mapping[str, Tensor], values: Mapping[str, Tensor], distribution: Tensor
    ) -> tuple[Tensor, Tensor]:
        """`parts` with any ``distribution`` (..., K, T) of h about n, whose integral over the hemisphere is 2
        pi.
        """
        r_spec, r_diff = per_epoch(values["r_spec"]), per_epoch(values["r_diff"])
        normal, grazing = (weighed(distribution, table[name]) for name in ("normal", "grazing"))
        return r_spec * normal + grazing, r_diff * (1 - r_spec) * table["diffuse"]

    @staticmethod
    def lobe_variance(values: Mapping[str, Tensor]) -> Tensor:
        """1 / n of the narrower axis: cos^n is a Gaussian of variance 1/n in its core."""
        return 1 / torch.maximum(*exponents(values))

    @staticmethod
    def broadened(values: Mapping[str, Tensor], variance: Tensor) -> dict[str, Tensor]:
        """1/n grows by the variance."""
        n_u, n_v = exponents(values)
        wider = n_u / (1 + n_u * variance)
        if "n" in values:
            return {**values, "n": wider}
        return {**values, "n_u": wider, "n_v": wider if n_u is n_v else n_v / (1 + n_v * variance)}


def _widest_exponent(table: Mapping[str, Tensor]) -> Tensor:
    """The exponent from which on a pair's lobe is as wide as the extent of its source, (P, T)."""
    if "spread" not in table:
        return torch.full_like(table["log_half"][:1], math.inf)
    return 1 / table["spread"].clamp(min=1e-12)


def _fine_steps(table: Mapping[str, Tensor]) -> tuple[int, int]:
    """Grid steps per unit of the table, and how many of them lie below the first exponent at which any pair's lobe
    reaches its source's extent: there the sums are smooth and every finer step follows from its neighbours."""
    finer = FINER if "spread" in table else 1
    idle = (table["normal"] == 0) & (table["grazing"] == 0)
    most = _widest_exponent(table)
    first_jump = float(torch.log1p(torch.where(idle, math.inf, most).min()))
    return finer, finer * math.floor(min(first_jump / GRID_STEP, GRID_STEPS))


def _condensed(table: Mapping[str, Tensor], finer: int, smooth: int) -> Tensor:
    """Logarithms of the normal and grazing sums and their derivatives per grid step, (G, 2, 2, T): value and
    slope, normal and grazing; -600 where there is no light."""
    idle = (table["normal"] == 0) & (table["grazing"] == 0)
    if len(idle) >= SORTED_FROM:  # those that die first last, pairs without light at the end
        order = torch.argsort(torch.where(idle, -math.inf, table["log_half"]), 0, descending=True)
        named = ("log_half", "normal", "grazing", "spread")
        table = {name: table[name].gather(0, order) for name in named if name in table}
        idle = idle.gather(0, order)
    log_half = table["log_half"]
    light = torch.stack([table["normal"], table["grazing"]])
    spread = table.get("spread")
    most = _widest_exponent(table)
    widest = torch.addcmul(torch.log1p(most), most, log_half) if spread is not None else log_half
    # a lobe that an extent keeps wide may outlast narrower ones nearer to their glint: it is left out by what is left of
    # the brightest in the end
    last = 1.0 if spread is None else most.clamp(max=1e6)
    depth = torch.where(idle, -math.inf, last * log_half)
    brightest = depth.amax(0).clamp(min=-1e300)
    grid = torch.arange(finer * GRID_STEPS + 1, dtype=light.dtype, device=light.device) * (GRID_STEP / finer)
    logs, slopes, steady = [], [], False
    for step, x in enumerate(grid):
        n = torch.expm1(x)
        if step % finer and step < smooth:
            continue  # as good from its neighbours
        if steady:
            logs.append(logs[-1])
            slopes.append(torch.zeros_like(logs[-1]))
            continue
        if step % (finer * STEPS_BETWEEN) == 0 and len(log_half) >= SORTED_FROM:
            depth = (
                n * (log_half - brightest)
                if spread is None
                else torch.minimum(n, most) * log_half - brightest
            )
            kept = 1 + int(((depth > DEEP) & ~idle).any(1).nonzero().amax()) if not bool(idle.all()) else 1
            log_half, light, idle = log_half[:kept], light[:, :kept], idle[:kept]
            if spread is not None:
                most, widest = most[:kept], widest[:kept]
        exponent = torch.addcmul(x, n, log_half)
        turning = torch.addcmul(torch.ones_like(n), n + 1, log_half)
        if spread is not None:
            free = n <= most
            exponent, turning = torch.where(free, exponent, widest), turning * free
        shone = light * lobe(exponent)
        total = shone.sum(-2)
        dark = total <= 1e-260
        safe = torch.where(dark, 1.0, total)
        logs.append(torch.where(dark, -600.0, torch.log(safe)))
        slopes.append(torch.where(dark, 0.0, (shone * turning).sum(-2) / safe) * GRID_STEP)
        steady = bool(((n > most) | idle).all())
    values, slopes = torch.stack(logs), torch.stack(slopes)
    if finer > 1:
        coarse = smooth // finer
        between = _between(values[: coarse + 1], slopes[: coarse + 1])
        values, slopes = torch.cat([between[0], values[coarse:]]), torch.cat([between[1], slopes[coarse:]])
    return torch.stack([values, slopes / finer], 1)


def _between(values: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor]:
    """Values and slopes per whole step (N, 2, T) also at FINER - 1 places after each node but the last, by cubics:
    ((N - 1) FINER, 2, T)."""
    t = (torch.arange(FINER, dtype=values.dtype, device=values.device) / FINER).reshape(-1, 1, 1)
    low, high, first, last = (
        column[:, None] for column in (values[:-1], values[1:], slopes[:-1], slopes[1:])
    )
    step = t * t * (3 - 2 * t)
    value = low + (high - low) * step + first * t * (1 - t) ** 2 + last * t * t * (t - 1)
    slope = 6 * t * (1 - t) * (high - low) + first * (1 - t) * (1 - 3 * t) + last * t * (3 * t - 2)
    return value.flatten(0, 1), slope.flatten(0, 1)


def interpolated(table: Mapping[str, Tensor], n: Tensor) -> tuple[Tensor, Tensor]:
    """The two lobe sums (..., T) of a condensed table at exponents n (...). One with ``monomials`` (..., M) has a polynomial of
    M terms, one row after the other, in place of each row."""
    monomials = table.get("monomials")
    terms = 1 if monomials is None else monomials.shape[-1]
    steps = table["lobes"].shape[0] // (2 * terms) - 1
    place = torch.log1p(n) * (steps / (GRID_STEPS * GRID_STEP))
    cell = place.detach().floor().clamp(0, steps - 1)
    t = place - cell
    h01 = t * t * (3 - 2 * t)
    weight = torch.stack([1 - h01, t * (1 - t) ** 2, h01, t * t * (t - 1)], -1)
    rows = 2 * per_epoch(cell.long()) + torch.arange(4, device=cell.device)
    if monomials is not None:
        rows = (terms * rows[..., None] + torch.arange(terms, device=cell.device)).flatten(-2)
        weight = (weight[..., None] * monomials[..., None, :]).flatten(-2)
        rows = rows.expand(weight.shape)
    normal, grazing = combined(table["lobes"], rows, weight).exp_().chunk(2, -1)
    return normal, grazing


def combined(table: Tensor, rows: Tensor, weight: Tensor) -> Tensor:
    """Sum over J of rows (..., J) of a table (R, C) times weight (..., J): (..., C)."""
    if transformed():
        return (weight[..., None, :] @ table[rows])[..., 0, :]
    flat, share = rows.reshape(-1, rows.shape[-1]), weight.reshape(-1, rows.shape[-1])
    return embedding_bag(flat, table, per_sample_weights=share, mode="sum").reshape(*rows.shape[:-1], -1)


def exponents(values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """n_u and n_v (...); one and the same tensor for an isotropic lobe."""
    if "n" in values:
        return values["n"], values["n"]
    return values["n_u"], values["n_v"]


def widened(table: Mapping[str, Tensor], n_u: Tensor, n_v: Tensor) -> tuple[Tensor, Tensor]:
    """Exponents shaped to meet (K, T), no larger than the pairs allow."""

    def wide(n: Tensor) -> Tensor:
        n = per_pair(n)
        return n / (n * table["spread"]).clamp(min=1) if "spread" in table else n

    first = wide(n_u)
    return first, first if n_u is n_v else wide(n_v)


def cosine_power(table: Mapping[str, Tensor], n_u: Tensor, n_v: Tensor) -> Tensor:
    """Eq. 4 times 2 pi, (..., K, T); one exponential a pair, and where n_u is n_v one product."""
    n_u, n_v = widened(table, n_u, n_v)
    if n_u is n_v:
        return lobe((n_u * table["log_half"]).add_(torch.log1p(n_u)))
    log_norm = 0.5 * (torch.log1p(n_u) + torch.log1p(n_v))
    return lobe(n_u * table["log_u"] + n_v * table["log_v"] + log_norm)
