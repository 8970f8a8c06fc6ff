"""What is fixed about a model of one scene and recording, and the questions that evaluators ask of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import torch
from torch import Tensor, nn

from torchlc.brdf import MODELS
from torchlc.brdf.base import Brdf
from torchlc.effects import GEOMETRY_STAGES
from torchlc.geometry.orbit import Track
from torchlc.geometry.rotation.attitude import Attitude
from torchlc.lightcurve.lobes import exponent_of
from torchlc.naming import Origin
from torchlc.parameters import ParameterSet
from torchlc.readers import Recording
from torchlc.scene import Scene
from torchlc.shapes import Part, Shape
from torchlc.stages.effect import Context, Effect
from torchlc.stages.instants import Columns, Instants
from torchlc.tensors.moving import CPU


@dataclass(frozen=True)
class Assembly:
    """Everything fixed about a model; built once by :func:`assemble` and shared between models that differ in
    their effects."""

    scene: Scene
    recording: Recording
    track: Track
    attitude: Attitude
    shape: Shape
    effects: tuple[Effect, ...]
    parameters: ParameterSet
    models: Mapping[str, type[Brdf]]
    context: Context
    sun_magnitude: Tensor
    row_index: Mapping[str, tuple[Tensor, Sequence[str]]]
    divided: Mapping[str, str]
    """By full name, what a number has a value for each of: "curve", "station", "night" or "object"."""
    origins: Mapping[str, Origin]
    """By full name, whose each number is."""
    warnings: tuple[str, ...]
    optics: Context
    instants: Instants | None = None
    pinned: Mapping[str, float] = field(default_factory=dict)
    dtype: torch.dtype = torch.float64
    device: torch.device = CPU

    @property
    def T(self) -> int:
        return len(self.context.seconds)

    @property
    def N(self) -> int:
        """Instants at which the geometry is worked out: those of ``optics``, at least one a row."""
        return len(self.optics.seconds)

    @property
    def instant_row(self) -> Tensor | None:
        """The row of each instant, (N,); None if they are the rows."""
        return None if self.instants is None else self.instants.row

    @cached_property
    def apart(self) -> Columns | None:
        """Every instant as a column of the tables; None if rows have one."""
        return None if self.instants is None else Columns.of_each(self.instants)

    @cached_property
    def columns(self) -> Columns | None:
        """Columns of tables made for good: instants stay apart where the share of sunlight changes within the
        exposure."""
        if self.instants is None:
            return None
        apart = torch.zeros(self.T, dtype=torch.bool)
        for effect in self.stage("shade"):
            apart |= effect.change(self.context, exposures(self.context)) > 0
        return Columns.joined(self.instants, apart)

    @property
    def components(self) -> list[str]:
        names = [part.name for part in self.shape.parts]
        return names + [
            effect.label for effect in self.effects if effect.stage == "surface" and effect.quantities
        ]

    @property
    def needs_shares(self) -> bool:
        return any(effect.needs_shares for effect in self.effects)

    @cached_property
    def pairs(self) -> int:
        """Pairs of facet, or of a point on a curved surface, and row of one evaluation, with the instants and lights that the effects bring; sizes the
        batches."""
        surfaces = sum(self._slots(part) for part in self.shape.parts)
        return surfaces * self.N * max(1, math.prod(effect.nodes for effect in self.effects))

    @cached_property
    def pairs_of_discs(self) -> int:
        """The same where sources that are discs are left whole for parts that are not curved."""
        every = max(1, math.prod(effect.nodes for effect in self.effects))
        others = max(1, math.prod(effect.nodes for effect in self.effects if not effect.widens))
        curved = [any(points > 1 for points in part.whole.values()) for part in self.shape.parts]
        slots = zip(map(self._slots, self.shape.parts), curved, strict=True)
        return self.N * sum(count * (every if bent else others) for count, bent in slots)

    def _slots(self, part: Part) -> int:
        """Facets and points at which light of a part is summed; where parts shadow each other also the facets of
        curved surfaces."""
        faces = dict.fromkeys(zip(part.faces, part.materials, strict=True))
        whole = [
            face for face, material in faces if face in part.whole and not self.models[material].additive
        ]
        points = sum(part.whole[face] for face in whole)
        hidden = [face for face in whole if self.stage("surface") and part.whole[face] > 1]
        apart = (face not in whole or face in hidden for face in part.faces)
        return points + sum(apart)

    @property
    def traced_pairs(self) -> int:
        """Facet-row pairs of the parts that are traced by rays."""
        return self.N * sum(len(part.faces) for part in self.shape.parts if part.hull is None)

    @cached_property
    def patches(self) -> list[list[tuple[str, str | None, list[str], Tensor]]]:
        """For each part, the materials on it, each of its surfaces that is one whole by its label (else None), and the
        labels and the indices of the facets of each."""
        patches = []
        for part in self.shape.parts:
            labels = [face if face in part.whole else None for face in part.faces]
            groups: dict[tuple[str, str | None], list[int]] = {}
            for index, key in enumerate(zip(part.materials, labels, strict=True)):
                groups.setdefault(key, []).append(index)
            patches.append(
                [
                    (*key, [part.faces[i] for i in index], torch.as_tensor(index, device=self.device))
                    for key, index in groups.items()
                ]
            )
        return patches

    @cached_property
    def moving(self) -> dict[str, str]:
        """Free parameters that move the geometry, in the order of theta, and where each does: the attitude's
        "spin", a "size", or the stage of an effect before shade."""
        stages = {name: self._moves(name) for name in self.parameters.names}
        return {name: stage for name, stage in stages.items() if stage is not None}

    @cached_property
    def settled(self) -> tuple[tuple[str, float], ...]:
        """Fixed numbers that the geometry depends on."""
        return tuple((name, value) for name, value in self.parameters.fixed.items() if self._moves(name))

    @cached_property
    def geometry_columns(self) -> list[int]:
        """Places in theta of the parameters that move the geometry."""
        return [self.parameters.names.index(name) for name in self.moving]

    def _moves(self, name: str) -> str | None:
        """The stage at which a number moves the geometry; None if it does not."""
        origin = self.origins[name]
        if origin.role == "attitude":
            return "spin"
        if origin.role == "components":
            return "size"
        if origin.role != "effects":
            return None
        for effect in self.effects:
            if effect.name != origin.owner or effect.linear or effect.stage not in GEOMETRY_STAGES:
                continue
            if effect.brdf is None or not _is_material(effect.brdf, origin.quantity):
                return effect.stage
        return None

    @property
    def geometry_free(self) -> bool:
        """True if the tables of the geometry cannot be kept: a free parameter moves it, or an effect learns it."""
        return bool(self.geometry_columns) or self.learns_geometry

    @cached_property
    def learns_geometry(self) -> bool:
        """True if an effect that learns acts where tables would hold what it did: they are then made anew at every call."""
        held = {*GEOMETRY_STAGES, "scatter"}
        return any(effect.stage in held and effect.learns for effect in self.effects)

    @property
    def learners(self) -> dict[str, nn.Module]:
        """What learns beside the free parameters, by whose it is: effects and laws of materials."""
        effects = {f"effects.{effect.entry}": effect for effect in self.effects}
        laws = {
            f"materials.{name}": law
            for name, law in self.context.models.items()
            if isinstance(law, nn.Module)
        }
        return {name: module for name, module in (effects | laws).items() if _has_state(module)}

    def effect_of(self, name: str) -> Effect | None:
        """The effect whose number this is, by its full name; None if it is the scene's."""
        origin = self.origins[name]
        if origin.role != "effects":
            return None
        return next((effect for effect in self.effects if effect.name == origin.owner), None)

    @property
    def parts_meet(self) -> bool:
        """True if parts shadow or light each other, which every new geometry has to have worked out anew."""
        return any(effect.joins_parts or effect.stage == "scatter" for effect in self.effects)

    def stage(self, name: str) -> list[Effect]:
        return [effect for effect in self.effects if effect.stage == name]

    def own(
        self, effect: Effect, values: Mapping[str, Tensor], row: Tensor | None = None
    ) -> dict[str, Tensor]:
        """An effect's parameters by short name, each (..., 1) or (..., T), or for the rows ``row`` (N,) asked for."""
        return {
            quantity.name: self.rows(values, effect.full_name(quantity.name), row)
            for quantity in effect.quantities
        }

    def rows(self, values: Mapping[str, Tensor], name: str, row: Tensor | None = None) -> Tensor:
        """A parameter (..., 1), or (..., T) if it has a value for each curve, station or night; (..., N) for the rows
        ``row`` (N,) asked for."""
        if name in values:
            return values[name][..., None]
        index, ids = self.row_index[self.divided[name]]
        index = index if row is None else index[row]
        each = torch.broadcast_tensors(*[values[f"{name}[{member}]"] for member in ids])
        return torch.stack(each, -1)[..., index]

    def attitude_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """``values`` with the attitude's numbers by the attitude's own names, as `rows` gives them for every
        instant."""
        names = self._own_names["attitude"]
        numbers = {plain: self.rows(values, name, self.instant_row) for plain, name in names.items()}
        return {**values, **numbers}

    def size_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """``values`` with the sizes of parts by the parts' own names."""
        return {**values, **{plain: values[name] for plain, name in self._own_names["components"].items()}}

    @cached_property
    def _own_names(self) -> dict[str, dict[str, str]]:
        """By role, the full names of the scene's numbers by their plain ones, which no two of a role share."""
        names: dict[str, dict[str, str]] = {"materials": {}, "attitude": {}, "components": {}}
        for name, origin in self.scene.origins().items():
            names[origin.role][origin.full_name()] = name
        return names

    def material_values(
        self, material: str, model: type[Brdf], values: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Values of one material, of the scene or of an effect (by its :attr:`Effect.material_key`), by the short
        names its model uses; a shared name appears under each name it stands for."""
        given = self._material_names(material)
        shared = {long: short for short, keys in model.shared.items() for long in keys}
        names = (quantity.name for quantity in model.quantities)
        return {name: values[given[name] if name in given else given[shared[name]]] for name in names}

    def lobes_at(self, values: Mapping[str, Tensor]) -> dict[str, float]:
        """The exponent of each material's sharpest lobe at these values."""
        lobes = {}
        for name, material in self.scene.materials.items():
            law, names = MODELS[material.model], self._material_names(name)
            numbers = [(law.quantity(key).role, float(values[names[key]])) for key in material.parameters]
            lobes[name] = max(
                [1.0, *(exponent for role, number in numbers if (exponent := exponent_of(role, number)))]
            )
        return lobes

    def has_number(self, material: str, short: str) -> bool:
        """Whether a material has a number of this short name."""
        return short in self._material_names(material)

    def _material_names(self, material: str) -> dict[str, str]:
        """Full names of a material's numbers by the short ones."""
        if material in self.scene.materials:
            names = self._own_names["materials"]
            return {key: names[f"{material}.{key}"] for key in self.scene.materials[material].parameters}
        effect = next(
            candidate
            for candidate in self.effects
            if candidate.brdf is not None and candidate.material_key == material
        )
        return {quantity.name: effect.full_name(quantity.name) for quantity in effect.quantities}


def exposures(context: Context) -> Tensor:
    """The longest time that each exposure may take, (T,), s: as recorded, else the cadence."""
    return torch.full_like(context.seconds, context.cadence) if context.exptime is None else context.exptime


def _has_state(module: nn.Module) -> bool:
    return next(module.parameters(), None) is not None or next(module.buffers(), None) is not None


def _is_material(model: type[Brdf], short: str) -> bool:
    return short in model.shared or any(quantity.name == short for quantity in model.quantities)
