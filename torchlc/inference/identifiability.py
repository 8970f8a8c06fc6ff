"""What the data say about each parameter, and where they say nothing, the geometric reason.

A parameter is informed if its posterior is clearly narrower than its prior, or has moved away from it. Of a
flat prior, an end cut off is a limit and no more: that no lobe as broad as n = 100 is seen leaves n to its
prior beyond. With relative flux, numbers that only scale the light together are never informed, however
their ratios are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torchlc.effects import GEOMETRY_STAGES
from torchlc.geometry.orbit import angle_between
from torchlc.inference.likelihood import Likelihood
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.model import LightCurve
from torchlc.lightcurve.pipeline import DARKEST
from torchlc.parameters import EXPONENT, FRESNEL, INDEX, LOBE_REFLECTANCE, REFLECTANCE, WIDTH, Free, Prior
from torchlc.shapes import Band, Dome
from torchlc.stages.light import View
from torchlc.tensors.moving import on_cpu

COVERED = 0.5
"""Share of a flat prior that lies in the 90 % interval of a posterior that says nothing, or hardly more than
a limit; 4000 prior draws give it to 0.01.
"""
NARROWER = 0.75
"""Ratio of posterior to prior standard deviation below which a parameter with a peaked prior is informed."""
TENSION = 3.0
"""Distance of the median from the centre of a peaked prior, in its sigma, that is warned of."""
SCALE_STEP = 0.8
SCALE_CHI2 = 1e-3
"""Numbers multiplied by SCALE_STEP together are only a scale if chi-square changes by less than this share
of the rows.
"""
FAR_GLINT_DEG = 10.0
"""A closest glint beyond this, or beyond two lobe widths, is a reason not to know a lobe."""
PRIOR_DRAWS = 4000
"""Its quantiles at 16 and 84 % are then within 0.024 standard deviations."""
TOLD_MAG = 0.002
"""Change of an exposure's light by twice the instants that is told."""
LOOKED_AT = 400
"""Rows, half of them those with most instants, half spread evenly."""
FAINT, FAINTEST_LOOKED_AT = 1e-2, 1e-4
"""Shares of the median row's light below which an exposure is told of apart, and below which it is not looked at."""
FACETS_AT_ONCE = 2_000_000
"""Facets and rows, or directions: 16 MB a tensor."""
SCALES = frozenset({REFLECTANCE, LOBE_REFLECTANCE})
"""Roles of numbers that are factors of light."""
OF_LOBE = frozenset({EXPONENT, WIDTH, INDEX, LOBE_REFLECTANCE, FRESNEL})
"""Roles of numbers of which a glint is needed to know them."""


@dataclass(frozen=True)
class Glint:
    """How near the bisector of Sun and observer comes to a lit-and-seen facet of a material, degrees, at
    which row.
    """

    degrees: float
    row: int


@on_cpu
def bare_view(model: LightCurve, theta: Tensor) -> View:
    """Where everything stands at each row's stamp: a view (Q = 1) without shadows, discs or exposures, at
    natural values theta (P,).
    """
    with torch.no_grad():
        return bare_model(model).view(model.values(theta))


@on_cpu
def bare_model(model: LightCurve) -> LightCurve:
    """The model without shadows, discs and exposures: only what moves or turns the object is left of its effects."""
    moving = [
        effect.entry
        for effect in model.effects
        if effect.stage in GEOMETRY_STAGES
        and not effect.spans_exposure
        and effect.stage not in ("light", "surface", "scatter")
    ]
    return LightCurve(
        model.scene,
        model.recording,
        assembly=assemble(model.scene, model.recording, moving, base=model.assembly),
    )


@on_cpu
def limits(model: LightCurve, theta: Tensor) -> list[str]:
    """What the model's approximations amount to at natural values theta (P,), where that is worth telling: what each effect
    says of itself, and what exposures lose by the number of their instants.
    """
    with torch.no_grad():
        values = model.values(theta)
        context = replace(model.assembly.context, lobes=model.assembly.lobes_at(values))
        sentences = [
            text
            for effect in model.effects
            for text in effect.limits(model.assembly.own(effect, values), context)
        ]
        return sentences + _exposures(model, theta)


def _exposures(model: LightCurve, theta: Tensor) -> list[str]:
    """Sentences that twice the instants change the light of some exposures, of faint ones apart. The rows looked at are
    LOOKED_AT, those that have most instants first."""
    effect = next((effect for effect in model.effects if effect.spans_exposure), None)
    if effect is None:
        return []
    divided = effect.instants(model.assembly.context)
    flux = model.brightness(theta[None]).flux[0]
    lit = flux > FAINTEST_LOOKED_AT * flux[flux > 0].median() if bool((flux > 0).any()) else flux > 0
    one_each = torch.ones_like(lit, dtype=torch.long)
    instants = one_each if divided is None else torch.bincount(divided.row, minlength=len(flux))
    candidates = torch.nonzero(lit)[:, 0]
    if not len(candidates):
        return []
    most = candidates[torch.argsort(instants[candidates], descending=True)[: LOOKED_AT // 2]]
    even = candidates[
        torch.linspace(0, len(candidates) - 1, LOOKED_AT // 2, dtype=torch.float32).round().long()
    ]
    looked = torch.zeros_like(lit)
    looked[torch.cat([most, even])] = True
    a = model.assembly
    entries = [model_effect.entry for model_effect in model.effects]
    finer = assemble(a.scene, a.recording, entries, base=a, pinned=a.pinned, finer=looked)
    again = LightCurve(a.scene, a.recording, assembly=finer).brightness(theta[None]).flux[0]
    change = 2.5 * torch.log10(flux[looked] / again[looked].clamp(min=DARKEST)).abs()
    faint = flux[looked] < FAINT * flux[flux > 0].median()
    kinds = (
        (~faint, "exposures"),
        (faint, f"exposures with less than {100 * FAINT:g} % of the median light"),
    )
    sentences = [
        f"{effect.name}: twice as many instants change {int((some > TOLD_MAG).sum())} of {len(some)} {kind} looked at by more "
        f"than {TOLD_MAG} mag, up to {float(some.max()):.2g} mag ({float(some.square().mean().sqrt()):.2g} mag rms)"
        for chosen, kind in kinds
        if bool(((some := change[chosen]) > TOLD_MAG).any())
    ]
    if sentences and effect.capped is not None:
        have, needed = effect.capped
        sentences[-1] += (
            f": memory allows {have:,} of {needed:,} instants; take fewer rows at once, or coarser shapes"
        )
    return sentences


def glints(view: View) -> dict[str, Glint | None]:
    """The closest glint of each material; None if no facet of it is ever both lit and seen."""
    to_sun, to_observer = view.to_sun[0], view.to_observer[0]
    half = torch.nn.functional.normalize(to_sun + to_observer, dim=-1)
    closest: dict[str, Glint | None] = {}
    for patch in view.patches:
        closest.setdefault(patch.material, None)
        size = max(1, FACETS_AT_ONCE // len(to_sun))
        directions = (to_sun, to_observer, half)
        if patch.pose is not None:
            directions = tuple(
                torch.einsum("tij,ti->tj", patch.pose[0], direction) for direction in directions
            )
        if isinstance(patch.surface, Band | Dome):
            least, row = _closest_on(patch.surface, *directions[:2])
            best = closest[patch.material]
            if math.isfinite(least) and (best is None or least < best.degrees):
                closest[patch.material] = Glint(least, row)
            continue
        for normal in patch.normal.split(size):
            cos_i, cos_r, _ = (direction @ normal.T for direction in directions)
            angle = torch.rad2deg(angle_between(directions[2][:, None], normal[None]))
            angle = torch.where((cos_i > 0) & (cos_r > 0), angle, math.inf)
            least = float(angle.min())
            best = closest[patch.material]
            if math.isfinite(least) and (best is None or least < best.degrees):
                closest[patch.material] = Glint(least, int(angle.min(1).values.argmin()))
    return closest


def _closest_on(surface: Band | Dome, to_sun: Tensor, to_observer: Tensor) -> tuple[float, int]:
    """The smallest angle, deg, between the bisector and a lit and seen normal of a curved surface, of directions (T, 3), and
    its row; inf if there is none."""
    least, row = math.inf, 0
    size = max(1, FACETS_AT_ONCE // Dome.count)
    for start in range(0, len(to_sun), size):
        cut = slice(start, start + size)
        points = surface.points(to_sun[cut], to_observer[cut])
        there = (torch.minimum(points.cos_i, points.cos_r) > 0) & (points.area > 0)
        tilt = torch.atan2(torch.hypot(points.along_u, points.along_v), points.cos_i + points.cos_r)
        angle = torch.rad2deg(torch.where(there, tilt, math.inf)).amin(-1)
        if float(angle.min()) < least:
            least, row = float(angle.min()), start + int(angle.argmin())
    return least, row


def material_shares(model: LightCurve, theta: Tensor) -> dict[str, float]:
    """The largest share of any row's light that comes from the components each material is on, at natural
    values theta (P,).
    """
    with torch.no_grad():
        brightness = model.brightness(theta, shares=True)
    assert brightness.shares is not None  # asked for
    share = dict(zip(brightness.components, brightness.shares, strict=True))
    shares = {}
    for material in model.scene.materials:
        on_parts = [share[part.name] for part in model.assembly.shape.parts if material in part.materials]
        shares[material] = float(torch.stack(on_parts).sum(0).max())
    return shares


@dataclass(frozen=True)
class Insight:
    """``informed`` by parameter name, and ``warnings``: one sentence for each that is not, and for each
    prior in tension.
    """

    informed: Mapping[str, bool]
    warnings: Sequence[str]


@on_cpu
def judge(likelihood: Likelihood, best: Tensor, draws: Tensor, view: View, seed: int) -> Insight:
    """Compare posterior ``draws`` (N, P) with the prior; ``best`` (P,) is the maximum a posteriori,
    ``view`` its geometry.
    """
    parameters = likelihood.model.parameter_set
    prior = parameters.sample_prior(PRIOR_DRAWS, torch.Generator(device=parameters.device).manual_seed(seed))
    scales = only_scales(likelihood, best)
    scale_of = {name: group for group in scales for name in group}
    informed = {
        free.name: free.name not in scale_of and narrower_or_moved(free.prior, prior[:, i], draws[:, i])
        for i, free in enumerate(parameters.free)
    }
    warnings: list[str] = [_scale_sentence(group) for group in scales]
    flat = parameters.to_flat(draws)
    closest, shares = glints(view), material_shares(likelihood.model, best)
    for i, name in enumerate(parameters.names):
        if not informed[name] and name not in scale_of:
            reason = _reason(likelihood.model, parameters.free[i], best, closest, shares) or _trade(
                parameters.names, i, flat
            )
            warnings.append(f"{name} is set by its prior: {reason}")
    for i, entry in enumerate(parameters.free):
        prior_i = entry.prior
        if not prior_i.peaked or prior_i.kind == "cauchy":  # whose tails hold what is far
            continue
        middle = float(draws[:, i].median())
        logarithmic = prior_i.kind == "lognormal"
        gap = math.log(middle / prior_i.centre) if logarithmic else middle - prior_i.centre
        away = abs(gap) / prior_i.sigma
        if away > TENSION:
            warnings.append(
                f"prior in tension: {entry.name} = {middle:.4g} lies {away:.1f} sigma from its prior "
                f"({prior_i.centre:.4g}, sigma {prior_i.sigma:.4g}{' in ln' if logarithmic else ''})"
            )
    return Insight(informed, warnings)


def narrower_or_moved(prior: Prior, before: Tensor, after: Tensor) -> bool:
    """Whether draws of a posterior (N,) are more than draws of the prior (M,), or than these cut off at one
    end if the prior is flat: their 90 % interval leaves out the prior's median, or is narrow.
    """
    low, high = np.quantile(after.numpy(), (0.05, 0.95))
    middle = float(before.median())
    if not low <= middle <= high:
        return True
    if not prior.peaked:
        return float(((before >= low) & (before <= high)).double().mean()) < COVERED
    if prior.logarithmic:
        before, after = before.log(), after.log()
    return bool(after.std() < NARROWER * before.std())


def only_scales(likelihood: Likelihood, best: Tensor) -> list[list[str]]:
    """Groups of free parameters that relative flux leaves undetermined together: all reflectances, all
    sizes.
    """
    if likelihood.kind != "flux":
        return []
    names, free = likelihood.model.names, likelihood.model.parameter_set.free
    groups = []
    kinds: tuple[Callable[[Free], bool], ...] = (
        lambda parameter: parameter.role in SCALES and parameter.origin.target is None,
        lambda parameter: parameter.origin.role == "components",
    )
    for of_kind in kinds:
        index = [i for i, parameter in enumerate(free) if of_kind(parameter)]
        if not index:
            continue
        scaled = best.clone()
        scaled[index] *= SCALE_STEP
        with torch.no_grad():
            change = float((likelihood.chi2(scaled) - likelihood.chi2(best)).abs())
        if change < SCALE_CHI2 * likelihood.rows:
            groups.append([names[i] for i in index])
    return groups


def _scale_sentence(group: Sequence[str]) -> str:
    if len(group) == 1:
        return f"{group[0]} is set by its prior: it is only a scale of the light, and relative flux has none"
    listed = ", ".join(group[:-1]) + f" and {group[-1]}"
    return (
        f"{listed} are known only relative to one another: together they are a scale of the light, and "
        "relative flux has none"
    )


def _reason(
    model: LightCurve,
    free: Free,
    best: Tensor,
    closest: Mapping[str, Glint | None],
    shares: Mapping[str, float],
) -> str | None:
    """Why a material's parameter is not informed, from the geometry; None if the geometry gives no reason."""
    owner = free.origin.owner
    if free.origin.role != "materials":
        return None
    glint = closest.get(owner)
    if glint is None:
        return f"no facet of {owner} is ever both lit and seen"
    share = shares.get(owner, 0.0)
    kind = model.assembly.models[owner]
    values = model.assembly.material_values(owner, kind, model.values(best))
    width = math.degrees(math.sqrt(float(kind.lobe_variance(values))))
    if free.role in OF_LOBE and math.isfinite(width) and glint.degrees > min(2 * width, FAR_GLINT_DEG):
        return f"no glint comes within {glint.degrees:.1f} deg of any {owner} facet"
    if share < 0.2:
        return f"what is made of {owner} never gives more than {100 * share:.2g} % of the light"
    return None


def _trade(names: Sequence[str], index: int, flat: Tensor) -> str:
    """The parameter with which draws (N, P) trade most, in words."""
    if len(names) > 1:
        correlation = torch.corrcoef(flat.T)[index].nan_to_num()
        correlation[index] = 0.0
        other = int(correlation.abs().argmax())
        if abs(float(correlation[other])) > 0.7:
            return f"it trades against {names[other]} (correlation {float(correlation[other]):.2f})"
    return "the light hardly depends on it here"
