"""The light curve as a module: geometry and effects around the facet sum of eqs. 8-11, from theta to
magnitudes.

``LightCurve`` separates what depends on geometry (computed once while no geometric parameter is free) from
what depends on materials (one exponential per lit-and-seen pair of facet and epoch). Letters: B batch, L
lights, Q instants, T rows, F facets, C components.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Self
from weakref import WeakSet

import torch
from torch import Tensor, nn
from torch.utils.weak import WeakIdKeyDictionary

from torchlc.digits import number_of
from torchlc.errors import InputError
from torchlc.lightcurve.assembled import Assembly
from torchlc.lightcurve.assembly import assemble
from torchlc.lightcurve.evaluators import Evaluator, chosen
from torchlc.lightcurve.evaluators.clock import MOST_TRACED_PAIRS
from torchlc.lightcurve.evaluators.exact import ExactGeometry
from torchlc.lightcurve.evaluators.expansion import Expansion
from torchlc.lightcurve.pipeline import Pipeline
from torchlc.lightcurve.tables import Tables
from torchlc.parameters import ParameterSet
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.stages.effect import Effect, Noise
from torchlc.stages.light import Brightness, View
from torchlc.stages.order import GEOMETRY_STAGES
from torchlc.tensors.moving import CPU, moved, on

USERS: MutableMapping[nn.Parameter, WeakSet[LightCurve]] = WeakIdKeyDictionary()
"""Which models have a parameter that an effect or a law has learnt, for those of one assembly share it."""
MODULE_ATTRIBUTES = frozenset((*dir(nn.ModuleDict()), *dir(nn.ParameterDict())))


@dataclass(frozen=True)
class Evaluation:
    """How a model works out its light, settled by scene, recording and effects: the same for every theta, alone or
    in a batch, with or without gradients.

    ``way``: "kept" tables of a fixed geometry; tables worked out "anew" for every theta; "stepped", light
    interpolated over the one parameter that moves the geometry, or "clocked", tables over the offset of the clock.
    ``tabulated`` names the materials whose lobes are interpolated over their exponent. ``error_mag`` is the largest
    error of these interpolations, mag, 0 where there is none.
    """

    way: str
    tabulated: tuple[str, ...]
    error_mag: float


class LightCurve(nn.Module):
    """Model of one recording. ``model()`` is the light curve at the module's own parameters, ``model(theta)``
    at natural values theta (..., P): magnitudes (..., T), or the irradiance ratio Phi for a recording of
    relative flux.

    ``sibling``, a model of the same scene and recording, lends its tables where its geometry is the same. The
    free parameters are ``nn.Parameter`` leaves in unconstrained coordinates, grouped as
    ``free.<owner>.<name>`` with "." and "%" in names as %2E and %25; ``names`` lists them in the order of theta and ``theta()`` gives their natural
    values. What effects and laws learn beside these, such as networks, is in ``learners``. Neglects everything that is not among ``effects``.
    """

    def __init__(
        self,
        scene: Scene,
        recording: Recording,
        *,
        effects: Sequence[str] | None = None,
        assembly: Assembly | None = None,
        sibling: LightCurve | None = None,
    ) -> None:
        super().__init__()
        if not (isinstance(scene, Scene) and isinstance(recording, Recording)):
            found = f"{type(scene).__name__} and {type(recording).__name__}"
            raise InputError(
                None, "scene, recording", found, "a Scene and a Recording, as torchlc.load returns"
            )
        if assembly is None:
            with on(CPU):
                assembly = assemble(scene, recording, effects)
        self.assembly = assembly
        with self._home():
            self.free = nn.ModuleDict()
            z = self.parameter_set.to_unconstrained(self.parameter_set.start())
            self._keys: list[tuple[str, str]] = []
            for index, parameter in enumerate(self.parameter_set.free):
                short = parameter.origin.short
                label = parameter.name.removesuffix(f".{short}") if parameter.origin.owner else "calibration"
                owner, short = module_key(label), module_key(short)
                if owner not in self.free:
                    self.free[owner] = nn.ParameterDict()
                self.free[owner][short] = nn.Parameter(z[index].clone())  # pyright: ignore[reportIndexIssue]
                self._keys.append((owner, short))
            learners = {module_key(name): module for name, module in self.assembly.learners.items()}
            self.learners = nn.ModuleDict(learners).to(self.assembly.dtype)
            self._use_learnt()
            self.pipeline = Pipeline(self.assembly)
            shared = sibling is not None and sibling.tables_key == self.tables_key
            lending = sibling.evaluator if shared and sibling is not None else None
            self.evaluator: Evaluator = chosen(self.pipeline, lending)

    # ------------------------------------------------------------------ parameters

    @property
    def scene(self) -> Scene:
        return self.assembly.scene

    @property
    def recording(self) -> Recording:
        return self.assembly.recording

    @property
    def parameter_set(self) -> ParameterSet:
        return self.assembly.parameters

    @property
    def names(self) -> list[str]:
        """Full names of the free parameters, in the order of theta."""
        return self.parameter_set.names

    @property
    def effects(self) -> tuple[Effect, ...]:
        return self.assembly.effects

    def unconstrained(self) -> Tensor:
        """The module's own parameters as one vector z, (P,)."""
        leaves = [self.free[owner][short] for owner, short in self._keys]  # pyright: ignore[reportIndexIssue]
        return torch.stack(leaves) if leaves else self.parameter_set.start()

    def theta(self) -> Tensor:
        """The module's own parameters as natural values, (P,)."""
        return self.parameter_set.to_natural(self.unconstrained())

    @torch.no_grad()
    def set_theta(self, theta: Tensor) -> None:
        """Make natural values theta (P,) the module's own; what lies beyond a bound is set inside it."""
        for (owner, short), value in zip(self._keys, self.parameter_set.to_unconstrained(theta), strict=True):
            self.free[owner][short].copy_(value)  # pyright: ignore[reportIndexIssue]

    def values(self, theta: Tensor | None = None) -> dict[str, Tensor]:
        """Every number of the model by its full name, free and fixed."""
        return self.parameter_set.values(self.theta() if theta is None else theta)

    @property
    def tables_key(self) -> tuple[str, ...]:
        """What the tables of a fixed geometry depend on; models of one assembly with equal keys may share
        them."""
        shaping = [e for e in self.effects if e.stage in {*GEOMETRY_STAGES, "scatter"} or e.reshapes_lobe]
        return (
            *(str(item) for item in (self.geometry_free, bool(self.names), self.assembly.settled)),
            *(f"{e.entry} {e.nodes}" for e in shaping),
            # an effect may tabulate more of a law than the law does itself
            *(f"{material} {self.assembly.models[material]}" for material in self.scene.materials),
        )

    @property
    def geometry_free(self) -> bool:
        """True if a free parameter moves the geometry, so that its tables cannot be kept."""
        return self.assembly.geometry_free

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """What ``to``, ``cuda``, ``double`` and their like do: all that is no parameter moves too. Tables that are kept
        are made first, in the precision and on the device in which they would have been."""
        with self._home():
            a = self.assembly
            like = fn(torch.zeros((), dtype=a.dtype, device=a.device))
            if (like.dtype, like.device) == (a.dtype, a.device):
                return super()._apply(fn, recurse)
            self.evaluator.settle()
            shared = {id(learnt) for learnt in self.learners.parameters() if len(USERS.get(learnt, ())) > 1}

            def copied(parameter: nn.Parameter) -> nn.Parameter:
                if id(parameter) not in shared:
                    return parameter
                return nn.Parameter(fn(parameter.detach()), parameter.requires_grad)

            if shared:  # moved as copies with all the rest: the other model's stay where they are
                for learnt in self.learners.parameters():
                    USERS.get(learnt, WeakSet()).discard(self)
                self.learners = nn.ModuleDict()
            super()._apply(fn, recurse)
            self.evaluator = moved(self.evaluator, fn, a.dtype, a.device, (Scene, Recording), copied)
        self.pipeline = self.evaluator.pipeline
        self.assembly = self.pipeline.assembly
        self.learners = nn.ModuleDict(
            {module_key(name): module for name, module in self.assembly.learners.items()}
        )
        self._use_learnt()
        return self

    def _use_learnt(self) -> None:
        for learnt in self.learners.parameters():
            USERS.setdefault(learnt, WeakSet()).add(self)

    def _home(self) -> AbstractContextManager[None]:
        """Tensors that are made without a device are made where the model is."""
        return on(self.assembly.device)

    # ------------------------------------------------------------------ the curve

    def forward(self, theta: Tensor | None = None) -> Tensor:
        """Magnitudes (..., T), or relative flux for a recording of kind ``flux``, of natural values theta
        (..., P)."""
        brightness = self.brightness(theta)
        return self.magnitude(brightness, theta) if self.recording.kind == "mag" else brightness.flux

    def magnitude(self, brightness: Brightness, theta: Tensor | None = None) -> Tensor:
        """Eq. 11: band_sun_magnitude - 2.5 log10 Phi + zero_point, (..., T); +inf where the flux is 0 or
        less."""
        lit = brightness.flux > 0
        magnitude = -2.5 * torch.log10(torch.where(lit, brightness.flux, 1.0))
        return self.assembly.sun_magnitude + torch.where(lit, magnitude, math.inf) + self.zero_point(theta)

    def zero_point(self, theta: Tensor | None = None) -> Tensor:
        """Zero point, mag, (..., 1) or (..., T)."""
        return self.assembly.rows(self.values(theta), "zero_point")

    def brightness(self, theta: Tensor | None = None, *, shares: bool = False) -> Brightness:
        """Total flux Phi (..., T), and component shares (..., C, T) if asked for, of natural values theta
        (..., P)."""
        with self._home():
            return self.evaluator.brightness(self.theta() if theta is None else theta, shares)

    # ------------------------------------------------------------------ how it is evaluated

    @property
    def evaluation(self) -> Evaluation:
        """How light is worked out, and what that neglects; makes the tables that are kept."""
        return Evaluation(self.evaluator.way, self.evaluator.tabulated, self.evaluator.error_mag)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was assumed or left out, a sentence each: of scene, recording and effects, and of how light is
        worked out."""
        said = [*self.assembly.warnings]
        movers = [name for name, stage in self.assembly.moving.items() if stage not in ("light", "surface")]
        for effect in self.effects if movers else ():
            jumping = effect.jumps(self.assembly.context)
            if jumping is not None:
                said.append(
                    f"{effect.name}: {jumping} move in jumps: gradients by {', '.join(movers)}, and fits, which follow "
                    "them, leave out how they move; draws of the posterior do not"
                )
        return (*said, *self.evaluator.warnings)

    def forget(self) -> None:
        """Drops the tables of recent geometries, which an optimiser at work comes back to."""
        self.evaluator.forget()

    def batch_size(self, tables: Tables | None = None) -> int:
        """Values of theta that are worked out at once where the geometry is fixed."""
        return self.evaluator.batch_size(self._given(tables))

    def values_a_call(self, tables: Tables | None = None) -> int:
        """Numbers that light at one value of theta needs where the geometry is fixed: its rows or the pairs of
        its largest surface."""
        return self.evaluator.values_a_call(self._given(tables))

    def _given(self, tables: Tables | None) -> Tables:
        return tables if tables is not None else self.tables(self.assembly.needs_shares)

    @property
    def parts_meet(self) -> bool:
        """True if parts shadow or light each other, which every new geometry has to have worked out anew."""
        return self.assembly.parts_meet

    @property
    def unaffordable(self) -> bool:
        """True if fits would work out the whole of a large mesh anew for every value of a parameter."""
        anew = isinstance(self.evaluator, ExactGeometry)
        return anew and self.assembly.traced_pairs > MOST_TRACED_PAIRS

    def expanded(self, theta: Tensor, scale: Tensor) -> LightCurve:
        """A model that works light out to second order about natural values theta (P,), several times as fast, where the
        geometry is within some standard deviations of theta; ``scale`` is their covariance (P, P). The same numbers come
        out to ``evaluator.error_mag``, at most 2e-3 mag, and beyond ``evaluator.reach`` exactly.

        Raises :class:`~torchlc.lightcurve.evaluators.expansion.UnsuitableError` where that cannot be done.
        """
        other = LightCurve(self.scene, self.recording, assembly=self.assembly)
        other.set_theta(self.theta())
        other.evaluator = Expansion(self.evaluator, theta, scale)
        return other

    # ------------------------------------------------------------------ stage by stage

    def view(self, values: Mapping[str, Tensor], batch: int = 1) -> View:
        """Geometry of every instant, see :meth:`Pipeline.view`."""
        with self._home():
            return self.pipeline.view(values, batch)

    def tables(self, detail: bool = False) -> Tables:
        """The tables of a fixed geometry; with ``detail`` wings stay apart."""
        with self._home():
            made = self.evaluator.tables_at(self.parameter_set.start(), detail)
        if made is None:
            raise ValueError("a free parameter moves the geometry: there are no tables to keep")
        return made

    def make_tables(self, view: View, detail: bool, *, compact: bool) -> Tables:
        """Angles and weights of every pair of facet and instant, see :meth:`Pipeline.make_tables`."""
        with self._home():
            return self.pipeline.make_tables(view, detail, compact=compact)

    def shine(self, tables: Tables, values: Mapping[str, Tensor], shares: bool = False) -> Brightness:
        """Light of prepared tables, see :meth:`Pipeline.shine`."""
        with self._home():
            return self.pipeline.shine(tables, values, shares)

    def noise(self, theta: Tensor) -> Noise:
        """What the noise effects add to the quoted errors at natural values theta (..., P)."""
        noise = Noise()
        effects = self.assembly.stage("noise")
        values = self.values(theta) if effects else {}
        with self._home():
            for effect in effects:
                noise = effect.noise(noise, self.assembly.own(effect, values), self.assembly.context)
        return noise

    def extra_repr(self) -> str:
        effects = ", ".join(dict.fromkeys(effect.name for effect in self.effects)) or "none"
        return f"{self.scene.name!r}, {number_of(self.assembly.T, 'row')}, effects: {effects}; free: {', '.join(self.names) or 'nothing'}"


def module_key(text: str) -> str:
    """A name as torch allows it for a child of a module, "." and "%" as codes, so that no two become one; one that a
    module has for itself begins with a code."""
    escaped = text.replace("%", "%25").replace(".", "%2E")
    return f"%{ord(escaped[0]):02X}{escaped[1:]}" if escaped in MODULE_ATTRIBUTES else escaped
