"""Diffuse light among the facets of one part that face each other: a bowl, a mesh with hollows.

Patches exchange light until nothing is left of it (radiosity: Goral et al. 1984). Letters: T rows, F facets, P
patches, K cosines at which a material's albedo is known.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from torchlc.brdf.angles import Incidence, incidence
from torchlc.brdf.base import Brdf
from torchlc.occlusion import visible_fractions
from torchlc.occlusion.rays import Traced
from torchlc.pairs.double_reflection import NEAR, form_factor
from torchlc.shapes import Facets
from torchlc.shapes.part import like
from torchlc.stages.effect import Context
from torchlc.stages.light import View

PATCHES = 96
"""Into how many patches a part is divided: halving them moves the light of a white bowl by 2e-3."""
MOST_COMPARED = 1024
"""Facets of a part against which its concavity is looked for."""
RAYS = 2048
"""Rays from a patch: the shares that reach others are good to 1/sqrt(RAYS) of the largest."""
COSINES = 6
"""Albedos are polynomials of the cosine to degree 5, which the diffuse part of Ashikhmin and Shirley is."""
EXITS = (12, 12)
"""Cosines and azimuths, over half a turn, of light that leaves, where an albedo is worked out."""


@dataclass(frozen=True)
class Cavity:
    """Facets (F,) of one part, the patch (F,) that each belongs to and how many facets each stands for (F,); the
    material of each of the P patches."""

    part: int
    facets: Tensor
    patch: Tensor
    share: Tensor
    materials: tuple[str, ...]


def cavities(context: Context) -> list[Cavity]:
    """The parts of which some facets rise above each other's planes. Convex parts have none."""
    result = []
    for number, (part, facets) in enumerate(zip(context.parts, context.rest, strict=True)):
        if part.hull is not None:
            continue
        inner = _facing_others(facets)
        if len(inner):
            divide = _sampled if part.thin else _clustered
            result.append(divide(number, inner, facets, part.materials))
    return result


def _facing_others(facets: Facets) -> Tensor:
    """Facets (F,) that rise above the plane of another one, and it above theirs."""
    middle, normal = facets.centroid.detach(), facets.normal.detach()
    other = torch.arange(0, len(middle), math.ceil(len(middle) / MOST_COMPARED), device=middle.device)
    size = float((middle.amax(0) - middle.amin(0)).norm())
    offset = (middle * normal).sum(-1)
    above = normal @ middle[other].mT - offset[:, None] > NEAR * size
    below = (normal[other] @ middle.mT).mT - offset[other] > NEAR * size
    return (above & below).any(-1).nonzero()[:, 0]


def _sampled(part: int, inner: Tensor, facets: Facets, materials: tuple[str, ...]) -> Cavity:
    """Every so many facets a patch of its own, which stands for its neighbours on the same ring."""
    chosen = inner[:: math.ceil(len(inner) / (2 * PATCHES))]
    share = facets.area[inner].sum() / facets.area[chosen].sum()
    names = tuple(str(materials[i]) for i in chosen.tolist())
    return Cavity(
        part,
        chosen,
        torch.arange(len(chosen), device=chosen.device),
        share.detach().expand(len(chosen)),
        names,
    )


def _clustered(part: int, inner: Tensor, facets: Facets, materials: tuple[str, ...]) -> Cavity:
    """Facets that lie and face alike are one patch: the widest patch is halved until there are PATCHES."""
    area = facets.area[inner].cpu().numpy()
    centroid = facets.centroid[inner].cpu().numpy()
    size = np.linalg.norm(np.ptp(centroid, axis=0))
    features = np.concatenate([centroid / size, facets.normal[inner].cpu().numpy()], axis=1)
    names = np.array([materials[i] for i in inner.tolist()])

    def entry(members: np.ndarray) -> tuple[float, int, np.ndarray]:
        about = features[members] - np.average(features[members], axis=0, weights=area[members])
        return -float((area[members] * (about**2).sum(1)).sum()), int(members[0]), members

    heap = [entry(np.flatnonzero(names == name)) for name in dict.fromkeys(names.tolist())]
    heapq.heapify(heap)
    while len(heap) < PATCHES and heap[0][0] < 0 and len(heap[0][2]) > 1:
        members = heapq.heappop(heap)[2]
        about = features[members] - np.average(features[members], axis=0, weights=area[members])
        axis = np.linalg.eigh((about * area[members, None]).T @ about)[1][:, -1]
        ordered = members[np.argsort(about @ axis, kind="stable")]
        cut = int(np.searchsorted(np.cumsum(area[ordered]), 0.5 * area[ordered].sum()))
        cut = min(max(cut, 1), len(ordered) - 1)
        heapq.heappush(heap, entry(np.sort(ordered[:cut])))
        heapq.heappush(heap, entry(np.sort(ordered[cut:])))
    patch = np.zeros(len(inner), dtype=int)
    for number, (_, _, members) in enumerate(heap):
        patch[members] = number
    return Cavity(
        part, inner, torch.as_tensor(patch, device=inner.device), torch.ones_like(facets.area[inner]),
        tuple(str(names[members[0]]) for _, _, members in heap),
    )  # fmt: skip


def exchanged(cavity: Cavity, facets: Facets, context: Context) -> tuple[Tensor, Tensor]:
    """Share (P, P) of a patch's diffuse light that each patch receives, and the patches' area (P,), of facets at rest.

    In a bowl all facets see each other whole: Lambert's formula, with its gradients. Among others rays are thrown,
    once for all: their shapes have no free sizes. A ray that meets the back of a facet first began where another
    body of the mesh covers the patch, and neither it nor that area counts.
    """
    area = _by_patch(cavity, cavity.share * facets.area[cavity.facets])
    if context.parts[cavity.part].thin:
        corners, middle = facets.vertices[cavity.facets], facets.centroid[cavity.facets]
        normal = facets.normal[cavity.facets]
        apart = ~torch.eye(len(middle), dtype=torch.bool, device=middle.device)
        relative = corners[None] - middle[:, None, None]
        # a facet seen from itself has corners in its plane, at which the formula has no slope
        relative = torch.where(
            apart[..., None, None], relative, 1.0 + torch.eye(4, 3, dtype=middle.dtype, device=middle.device)
        )
        share = torch.where(apart, form_factor(relative, normal[:, None]) * cavity.share, 0.0)
    else:
        share, open_ = context.memory.recall(
            [[facets.vertices, cavity.facets, cavity.patch]], partial(_thrown, cavity, facets)
        )
        share, area = share[0], area * open_[0]
    both = area[:, None] * share
    return 0.5 * (both + both.mT) / area[:, None], area


def _by_patch(cavity: Cavity, values: Tensor) -> Tensor:
    """Sums (..., P) over the facets (..., F) of each patch."""
    patch = cavity.patch.to(values.device)
    total = values.new_zeros(*values.shape[:-1], len(cavity.materials))
    return total.index_add(-1, patch, values)


def _thrown(cavity: Cavity, facets: Facets, _items: list[int]) -> tuple[Tensor, Tensor]:
    """Shares (1, P, P) by rays from each patch, even over its area and by the cosine law over directions, and what
    part of a patch is open (1, P)."""
    vertices, normal = facets.vertices.cpu().numpy(), facets.normal.cpu().numpy()
    from scipy.stats import qmc  # loads for 0.4 s: only where light goes about inside an object

    scene = Traced(vertices)
    chosen, patch = cavity.facets.cpu().numpy(), cavity.patch.cpu().numpy()
    owner = np.full(len(vertices), -1)
    owner[chosen] = patch
    area = facets.area.cpu().numpy()
    count = len(cavity.materials)
    uniform = qmc.Sobol(5, rng=np.random.default_rng(0)).random(RAYS)
    share, open_ = np.zeros((count, count)), np.zeros(count)
    for number in range(count):
        members = chosen[patch == number]
        edges = np.cumsum(area[members])
        u = (uniform + np.random.default_rng(number).random(5)) % 1.0
        facet = members[np.minimum(np.searchsorted(edges, u[:, 0] * edges[-1]), len(members) - 1)]
        a, b = np.sqrt(u[:, 1]), u[:, 2]
        weight = np.stack([1 - a, a * (1 - b), a * b], -1)
        start = (weight[..., None] * vertices[facet][:, :3]).sum(1)
        level, turn = np.sqrt(u[:, 3]), 2 * math.pi * u[:, 4]
        up = normal[facet]
        across = np.cross(up, np.eye(3)[np.argmin(np.abs(up), axis=1)])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        ahead = level[:, None] * (
            np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(up, across)
        )
        ahead = ahead + np.sqrt(1 - level**2)[:, None] * up
        met = scene.first(start, up, ahead)
        front = (normal[met] * ahead).sum(-1) < 0
        reached = owner[met[(met >= 0) & front]]
        began = max(int(((met < 0) | front).sum()), 1)
        share[number] = np.bincount(reached[reached >= 0], minlength=count) / began
        open_[number] = began / RAYS
    return torch.as_tensor(share).to(facets.area)[None], torch.as_tensor(open_).to(facets.area)[None]


def sources_and_sinks(cavity: Cavity, view: View, context: Context, rows: slice) -> tuple[Tensor, Tensor]:
    """Sunlight on each patch and its area as the observer sees it over pi, (T, P, K) each: as sums over facets of
    the polynomials that are 1 at one of the K cosines and 0 at the others."""
    middle = view.to_observer.shape[0] // 2
    to_sun, to_observer = view.to_sun[middle, rows], view.to_observer[middle, rows]
    poses = [None if pose is None else pose[middle, rows] for pose in view.poses]
    facets, pose = view.facets[cavity.part], poses[cavity.part]
    sums = []
    for direction in (to_sun, to_observer):
        free = visible_fractions(context.shape, view.facets, poses, direction, direction)[cavity.part]
        local = direction if pose is None else torch.einsum("tij,ti->tj", pose, direction)
        cosine = (local @ facets.normal[cavity.facets].mT).clamp(min=0)
        light = cavity.share * facets.area[cavity.facets] * cosine * free[:, cavity.facets]
        sums.append(
            torch.stack([_by_patch(cavity, light * polynomial) for polynomial in _polynomials(cosine)], -1)
        )
    sunlight = [light.irradiance[:, middle, rows].sum(0) for light in view.lights if light.primary]
    gain = torch.stack(sunlight).sum(0) / view.range_m[middle, rows] ** 2
    return gain[:, None, None] * sums[0], sums[1] / math.pi


def _nodes() -> tuple[np.ndarray, np.ndarray]:
    """K cosines from 0 to 1, and weights of the integral between."""
    node, weight = np.polynomial.legendre.leggauss(COSINES)
    return 0.5 * (node + 1), 0.5 * weight


def _polynomials(cosine: Tensor) -> list[Tensor]:
    """Lagrange's polynomials of the K cosines, same shape each."""
    node = _nodes()[0]
    made = []
    for k in range(COSINES):
        factor = torch.ones_like(cosine)
        for other in np.delete(node, k):
            factor = factor * (cosine - other) / (node[k] - other)
        made.append(factor)
    return made


def albedo_table(model: type[Brdf], facets: Facets) -> dict[str, Tensor]:
    """A material's table of light from the K cosines that leaves in all directions, (K, exits, 1): its diffuse part is
    the directional albedo."""
    node = _nodes()[0]
    out, weight = np.polynomial.legendre.leggauss(EXITS[0])
    out, weight = 0.5 * (out + 1), 0.5 * weight
    turn = math.pi * (np.arange(EXITS[1]) + 0.5) / EXITS[1]
    cosine, azimuth = (axis.ravel() for axis in np.meshgrid(out, turn, indexing="ij"))
    solid = (weight[:, None] * np.full(EXITS[1], 2 * math.pi / EXITS[1])).ravel()

    def directions(cosine: np.ndarray, azimuth: np.ndarray) -> Tensor:
        sine = np.sqrt(1 - cosine**2)
        return like(np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], -1), facets.area)

    normal, u = torch.eye(3, dtype=facets.area.dtype, device=facets.area.device)[[2, 0]]
    angles = incidence(normal, u, directions(node, 0 * node)[:, None], directions(cosine, azimuth)[None])
    fields = torch.broadcast_tensors(*vars(angles).values())
    scale = like(solid[None] / node[:, None], facets.area)
    return model.tabulate(Incidence(*(field[..., None] for field in fields)), scale[..., None])


def returned(share: Tensor, source: Tensor, sink: Tensor, area: Tensor, albedo: Tensor) -> Tensor:
    """Light (..., T) that reaches the observer after two reflections or more, of any number.

    share (P, P) as of :func:`exchanged`, source and sink (T, P, K), area (P,), albedo (..., P, K) of each patch at
    the K cosines. What patches receive is H = M F + M F D F + ..., M the light that leaves them first, F the
    shares, D the albedos under a white sky: the sum of the series, for D F shrinks all light.
    """
    node, weight = _nodes()
    mean = (albedo * like(2 * weight * node, albedo)).sum(-1)
    eye = torch.eye(len(area), dtype=area.dtype, device=area.device)
    series = torch.linalg.solve(eye - mean[..., None] * share, share, left=False)
    first = torch.einsum("tpk,...pk->...tp", source, albedo)
    last = torch.einsum("tpk,...pk->...tp", sink, albedo) / area
    return ((first @ series) * last).sum(-1)
