"""Rotation of a rigid body that no torque acts on, exact: Jacobi's elliptic functions and one Fourier series.

The direction l of the angular momentum L, seen from the body, runs round a closed curve (Landau & Lifshitz,
Mechanics, 37; Samarasinha & A'Hearn 1991, Icarus 93, 194): about the principal axis of the largest moment
(short-axis mode, SAM) or of the smallest (long-axis mode, LAM). The rotation is

    R = Rz(phi) S(l),

S(l) the smallest rotation that takes l to the z axis, along L, and phi an angle whose rate is smooth and periodic.
Neither has a singularity where the body turns about a principal axis or two moments are equal. Between the modes,
on the separatrix, the period is infinite; states within 1e-15 of it in the parameter 1 - m are not resolved.

Letters: ... batch, T rows. Moments are relative, angles rad, time s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchlc.geometry.rotation.matrices import frame_turned_about_z
from torchlc.tensors.autodiff_state import readable, transformed

NODES = 128
"""Instants over half a period at which the rate of phi is sampled. Its harmonics fall as the nome to the k-th power:
64 of them reach 1e-14 while 1 - m is above 1e-15."""
MEANS = 9
"""Steps of the arithmetic-geometric mean; it doubles its digits at each and has all of them after 8 at 1 - m = 1e-15."""
NEGLIGIBLE = 1e-15
"""Harmonics of phi, rad, and differences of the means below this are left out: 1e-8 rad would be told after 1e6 turns."""


@dataclass(frozen=True)
class FreeRotation:
    """A state of torque-free rotation, each (...,): mean turns a second of the long (smallest moment) and the short
    (largest) principal axis about L, and of L about the body, ``polhode``; ``short_axis_mode`` true for SAM."""

    precession_long: Tensor
    precession_short: Tensor
    polhode: Tensor
    short_axis_mode: Tensor


@dataclass(frozen=True)
class _Motion:
    """The motion for L = I3 = 1, (...,) each: parameter m and amplitudes of l about the axis of its mode, turns of l
    about the body and mean turns of phi a unit of time, the harmonics of phi (..., K), rad, and ``basis``
    (..., 3, 3), whose rows are the axes x, y, z of the mode in the body."""

    m: Tensor
    amplitude: Tensor
    across: Tensor
    along: Tensor
    polhode: Tensor
    phi: Tensor
    harmonics: Tensor
    basis: Tensor
    short_axis_mode: Tensor


def free_rotation(
    elapsed_s: Tensor,
    moments: Tensor,
    nutation_rad: Tensor,
    period_s: Tensor,
    phase_turns: Tensor,
    polhode_turns: Tensor,
) -> Tensor:
    """Rotations (..., T, 3, 3) from principal axes to a frame with z along L, at ``elapsed_s`` (..., T) after the epoch.

    ``moments`` (..., 3) about the principal axes, in any order and unit. ``nutation_rad`` (..., 1 or T), 0 to pi / 2:
    angle of the short axis from L when L is in the plane of the short and the long axis, which is where
    ``polhode_turns``, the phase of L's way round the body in turns, is 0. ``period_s``: mean turn of the long axis about
    L. ``phase_turns``: phi at the epoch.
    """
    motion = _motion(moments, nutation_rad)
    scale = 1.0 / (period_s * _long(motion))  # L / I3 in units of time
    turns = elapsed_s * scale
    x = polhode_turns + motion.polhode * turns
    direction = _direction(motion, x)
    wander = _series(motion.harmonics, x) - _series(motion.harmonics, polhode_turns.expand_as(x))
    phi = 2 * math.pi * (phase_turns + motion.phi * turns) + wander
    return frame_turned_about_z(-phi) @ _to_z(direction) @ motion.basis


def frequencies(moments: Tensor, nutation_rad: Tensor, period_s: Tensor) -> FreeRotation:
    """Mean rates of a state; arguments as of :func:`free_rotation`, (...,) but for moments (..., 3)."""
    way = _way(moments, nutation_rad[..., None])
    sam = way.short_axis_mode[..., 0]
    phi, polhode = way.phi_rate.mean(-1) / (2 * math.pi), way.polhode[..., 0]
    long, short = phi - torch.where(sam, 0.0, polhode), phi + torch.where(sam, polhode, 0.0)
    scale = 1.0 / (period_s * long)
    return FreeRotation(long * scale, short * scale, polhode * scale, sam)


def _long(motion: _Motion) -> Tensor:
    """Mean turns of the long axis about L: those of phi, less those of l about it, which are backwards, where it is the
    axis of the mode."""
    return motion.phi - torch.where(motion.short_axis_mode, 0.0, motion.polhode)


@dataclass(frozen=True)
class _Way:
    """The way of l round the body for L = I3 = 1, as of :class:`_Motion`, and the rate of phi (..., NODES) over half of it, rad a
    unit of time; which place each axis has in the order of the moments."""

    m: Tensor
    amplitude: Tensor
    across: Tensor
    along: Tensor
    polhode: Tensor
    phi_rate: Tensor
    order: Tensor
    short_axis_mode: Tensor


def _way(moments: Tensor, nutation: Tensor) -> _Way:
    ordered, order = torch.sort(moments, dim=-1)
    small, middle, large = (ordered / ordered[..., 2:]).unbind(-1)
    small, middle, large = (moment[..., None] for moment in (small, middle, large))
    sine, cosine = torch.sin(nutation), torch.cos(nutation)
    inverse = sine**2 / small + cosine**2 / large  # 2 T / L^2
    sam = inverse * middle < 1
    # differences of inverse moments, which make up the parameter and the rate: b over a in SAM, a over b in LAM
    low, high = 1 / middle - 1 / large, 1 / small - 1 / middle
    own = torch.where(sam, low * cosine**2, high * sine**2)
    other = torch.where(sam, high * sine**2, low * cosine**2)
    positive = own > 0
    m = torch.where(positive, other / torch.where(positive, own, 1.0), 0.0).clamp(max=1 - NEGLIGIBLE)
    amplitude, along = torch.where(sam, sine, cosine), torch.where(sam, cosine, sine)
    ends = 1 / small - 1 / large
    inner = torch.where(sam, low, high)
    ratio = torch.where(positive, ends / torch.where(positive, inner, 1.0), 1.0)
    across = amplitude * torch.sqrt(ratio)
    rate = along * torch.sqrt(ends * inner)  # d u / dt of the elliptic functions
    means = _means(m)
    polhode = rate * means[-1][0] / (2 * math.pi)  # over 4 K = 2 pi / mean
    x = torch.arange(NODES, dtype=m.dtype, device=m.device) / (2 * NODES)
    sn, cn, dn = _elliptic(means, m, x)
    first, second = torch.where(sam, cn, sn), torch.where(sam, sn, cn)
    l = torch.stack(  # noqa: E741 - the direction of L, as in the texts
        [
            torch.where(sam, amplitude, across) * first,
            torch.where(sam, across, amplitude) * second,
            along * dn,
        ],
        -1,
    )
    own_moments = torch.where(
        sam[..., None],
        torch.stack([small, middle, large], -1),
        torch.stack([middle, large, small], -1),
    )
    omega = l / own_moments
    turning = torch.linalg.cross(l, omega)
    swing = (l[..., 0] * turning[..., 1] - l[..., 1] * turning[..., 0]) / (1 + l[..., 2])
    phi_rate = inverse - swing
    return _Way(m, amplitude, across, along, polhode, phi_rate, order, sam)


def _motion(moments: Tensor, nutation: Tensor) -> _Motion:
    way = _way(moments, nutation)
    spectrum = torch.fft.rfft(way.phi_rate, dim=-1).real / NODES
    mean = spectrum[..., :1]
    k = torch.arange(1, NODES // 2, dtype=mean.dtype, device=mean.device)
    still = way.polhode == 0
    period = torch.where(still, 0.0, 1 / torch.where(still, 1.0, way.polhode))
    harmonics = 2 * spectrum[..., 1 : NODES // 2] * period / (4 * math.pi * k)
    return _Motion(
        way.m,
        way.amplitude,
        way.across,
        way.along,
        way.polhode,
        mean / (2 * math.pi),
        _significant(harmonics),
        _basis(way.order, way.short_axis_mode),
        way.short_axis_mode,
    )


def _basis(order: Tensor, sam: Tensor) -> Tensor:
    """Axes of the mode in the body, as rows: (small, middle, large) in SAM, (middle, large, small) in LAM, the middle
    one turned round where the order of the axes is left-handed."""
    axes = (order[..., None] == torch.arange(3, device=order.device)).to(torch.float64)
    hand = torch.linalg.det(axes)[..., None]
    axes = torch.stack([axes[..., 0, :], axes[..., 1, :] * hand, axes[..., 2, :]], -2)
    return torch.where(sam[..., None, None], axes[..., None, :, :], axes[..., None, [1, 2, 0], :])


def _direction(motion: _Motion, x: Tensor) -> Tensor:
    """Direction of L (..., T, 3) in the axes of the mode at phases x (..., T) of its way, in turns."""
    sn, cn, dn = _elliptic(_means(motion.m), motion.m, x)
    sam = motion.short_axis_mode
    first = torch.where(sam, motion.amplitude * cn, motion.across * sn)
    second = torch.where(sam, motion.across * sn, motion.amplitude * cn)
    return torch.stack([first, second, motion.along * dn], -1)


def _means(m: Tensor) -> list[tuple[Tensor, Tensor]]:
    """Arithmetic means a and half differences c of the arithmetic-geometric mean of 1 and sqrt(1 - m), from the second
    step on; the last is the mean itself, pi / (2 K)."""
    a, b = torch.ones_like(m), torch.sqrt(1 - m)
    means = []
    for _ in range(MEANS):
        a, b, c = (a + b) / 2, torch.sqrt(a * b), (a - b) / 2
        means.append((a, c))
        if not transformed() and readable(c) and bool((c.abs() < NEGLIGIBLE).all()):
            break
    return means


def _elliptic(means: list[tuple[Tensor, Tensor]], m: Tensor, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """sn, cn and dn of 4 K x, by descending Landen transformations (Abramowitz & Stegun 16.4)."""
    angle = 2 * math.pi * 2 ** len(means) * (x - torch.floor(x.detach()))
    for a, c in reversed(means):
        angle = (angle + torch.asin((c / a * torch.sin(angle)).clamp(-1, 1))) / 2
    sn = torch.sin(angle)
    return sn, torch.cos(angle), torch.sqrt(1 - m * sn * sn)


def _significant(harmonics: Tensor) -> Tensor:
    """The harmonics (..., K) up to the last that is not negligible."""
    if transformed() or not readable(harmonics):
        return harmonics
    large = (harmonics.detach().abs() > NEGLIGIBLE).reshape(-1, harmonics.shape[-1]).any(0)
    last = int(large.nonzero()[-1]) + 1 if bool(large.any()) else 1
    return harmonics[..., :last]


def _series(harmonics: Tensor, x: Tensor) -> Tensor:
    """Sum over k of harmonics (..., K) times sin(4 pi k x), (..., T), by Clenshaw's recurrence."""
    angle = 4 * math.pi * x
    twice = 2 * torch.cos(angle)
    later, last = torch.zeros_like(angle), torch.zeros_like(angle)
    for k in range(harmonics.shape[-1] - 1, -1, -1):
        later, last = harmonics[..., k : k + 1] + twice * later - last, later
    return later * torch.sin(angle)


def _to_z(direction: Tensor) -> Tensor:
    """The smallest rotation (..., 3, 3) that takes unit vectors (..., 3), not near -z, to z."""
    x, y, z = direction.unbind(-1)
    inverse = 1 / (1 + z)
    xy = -x * y * inverse
    rows = [1 - x * x * inverse, xy, -x, xy, 1 - y * y * inverse, -y, x, y, z]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))
