"""One PyMC model of several subjects: parameters that they share, have of their own, or draw from one law."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import pymc as pm
import xarray as xr

from zoo.core.arviz_lines import InferenceData, datasets, made
from zoo.core.digests import of_json
from zoo.core.errors.base import DIMS
from zoo.core.model import ModelError, ModelRecord, record_of
from zoo.core.op import observed_series
from zoo.core.parameters import Parameter, variable_name
from zoo.core.words import nearest

SCALES = ("log", "unconstrained")


class Subjects(NamedTuple):
    """Names of all subjects, and a digest of their data, as a run's record has them."""

    name: str
    checksum: str


@dataclass(frozen=True, eq=False)
class JointRecord:
    """What a model of several subjects is made of, as ``model.zoo``.

    Attributes
    ----------
    name : str
        Of the subjects' models.
    subjects : mapping
        Name of a subject -> the record of its own model.
    variables : mapping
        Name of a subject -> its own model's variable -> the variable of this model.
    own : mapping
        Number that every subject has for itself -> its variables here, in the order of the subjects.
    units : mapping
        Variable -> unit.
    priors : mapping
        Variable -> prior in words.
    suggested : mapping
        Variable -> value that a search for the mode may start from.
    """

    name: str
    subjects: Mapping[str, ModelRecord]
    variables: Mapping[str, Mapping[str, str]]
    own: Mapping[str, Sequence[str]]
    units: Mapping[str, str]
    priors: Mapping[str, str]
    suggested: Mapping[str, Any]
    study: None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def data(self) -> Subjects:
        """Names and digest of the data of all subjects."""
        sources = {name: (one.study or one.data).checksum for name, one in self.subjects.items()}
        return Subjects(", ".join(sources), of_json(sources))


def joint_model(
    models: Mapping[str, pm.Model] | Sequence[pm.Model],
    *,
    share: Iterable[str] = (),
    population: Iterable[str] | Mapping[str, str] = (),
) -> pm.Model:
    """One PyMC model of several subjects, each with its own data, simulator and errors.

    The log-likelihood is the sum of those of the subjects, log p(y_1, ..., y_K) = sum_k log p(y_k | theta_k).
    A parameter of theta_k is a subject's own, with the prior of its own model; or shared, one for all; or
    drawn from a population, g(theta_k) ~ N(g(m), s^2), whose median m has the prior that the parameter had,
    and s a half-normal one whose scale is half the width of the central 68 % of g of that prior. It is
    sampled as theta_k = g^-1(g(m) + s z_k) with z_k ~ N(0, 1), which has no funnel where data are few.

    Parameters
    ----------
    models : mapping of str to pm.Model, or sequence
        Each with a record, such as those of `bayesian_model` or `zoo.model_G`, by name of the subject; the
        names of their studies or data in a sequence.
    share : iterable of str
        Parameters that all subjects have in common, those of errors too.
    population : iterable of str, or mapping of str to str
        Numbers that come from one population, with their scale g: "log", the default of those that are
        positive, or "unconstrained", the default of others: log((x - low)/(high - x)) within two bounds,
        log(x - low) or -log(high - x) within one, and x without. On the logarithmic scale a subject's value
        may lie outside the upper bound of the prior.

    Returns
    -------
    pm.Model
        Own parameters are named "f3[subject]", the others as in the subjects' models; of a population f3
        there are "f3_median", "f3_sd" and "f3" (subject). ``model.zoo`` is its record.

    Raises
    ------
    ModelError
        If two subjects have one name, a parameter is unknown, or its prior or unit differs between subjects.

    Examples
    --------
    >>> model = joint_model({"a": model_a, "b": model_b}, share=["c"], population=["f3"])  # doctest: +SKIP

    References
    ----------
    Gelman et al. (2013), Bayesian Data Analysis, chapter 5; Betancourt, Girolami (2015),
    doi 10.1201/b18502-5.
    """
    records = _records(models)
    shared, scales = _checked(share, population, records)
    variables: dict[str, dict[str, str]] = {name: {} for name in records}
    units: dict[str, str] = {}
    priors: dict[str, str] = {}
    start: dict[str, Any] = {}
    common: dict[str, Any] = {}
    first = next(iter(records.values()))
    with pm.Model(coords={"subject": list(records)}) as model:
        for name in (*shared, *scales):
            p = _parameters(first)[name]
            v = variable_name(name)
            units[v] = p.unit
            if name in scales:
                common[name] = _population(p, scales[name], units, priors)
                start[f"{v}_median"] = p.first
            else:
                dims = {"dims": p.dims} if p.dims else {}
                if p.dims:
                    model.add_coord(p.dims, _coordinates(models, first, p))
                common[name] = p.prior.variable(v, common, **dims)
                priors[v] = p.prior.text
                start[v] = first.suggested[v]
        for k, (subject, record) in enumerate(records.items()):
            values: dict[str, Any] = {}
            for p in (*record.forward.parameters, *record.errors.parameters):
                v = variable_name(p.name)
                if p.name in common:
                    values[p.name] = common[p.name][k] if p.name in scales else common[p.name]
                    variables[subject][v] = v
                    continue
                mine, settings = f"{v}[{subject}]", {}
                if p.dims:
                    settings["dims"] = f"{p.dims}[{subject}]"
                    if settings["dims"] not in model.coords:
                        model.add_coord(settings["dims"], _coordinates(models, record, p))
                values[p.name] = p.prior.variable(mine, values, **settings)
                variables[subject][v] = mine
                units[mine], priors[mine], start[mine] = p.unit, p.prior.text, record.suggested[v]
            mean, ok = observed_series(record.forward, values)
            axes = [f"{name}[{subject}]" for name in DIMS]
            model.add_coords(dict(zip(axes, (list(record.data.labels), record.data.times), strict=True)))
            errors = {p.name: values[p.name] for p in record.errors.parameters}
            record.errors.observe(f"y[{subject}]", mean, ok, errors, axes)
    names = dict.fromkeys(one.name for one in records.values())
    model.zoo = JointRecord(
        f"{', '.join(names)} of {len(records)} subjects",
        records,
        variables,
        _own(records, variables),
        units,
        priors,
        start,
        settings={"share": list(shared), "population": dict(scales)},
    )
    return model


def by_subject(idata: InferenceData, model: pm.Model) -> InferenceData:
    """Draws of a model of several subjects with the dimension "subject", and with units.

    Numbers that every subject has for itself, "f3[a]" and "f3[b]", become one variable "f3" (subject). What
    is so already, and vectors such as the stiffness of each vessel, stay as they are.

    Parameters
    ----------
    idata : InferenceData
        Draws of `model`, of any sampler; left as it is.
    model : pm.Model
        From `joint_model`.

    Returns
    -------
    InferenceData
    """
    record = joint_record_of(model)
    groups = {name: group.copy() for name, group in datasets(idata).items()}
    for group in ("posterior", "prior"):
        if group not in groups:
            continue
        draws = groups[group]
        for name, parts in record.own.items():
            if all(part in draws for part in parts):
                joined = xr.concat([draws[part].rename(name) for part in parts], dim="subject")
                joined = joined.transpose("chain", "draw", "subject").assign_coords(
                    subject=list(record.subjects)
                )
                units = {record.units[part] for part in parts}
                joined.attrs = {"units": units.pop()} if len(units) == 1 else {}
                draws = draws.drop_vars(parts).assign({name: joined})
        for name, unit in record.units.items():
            if name in draws:
                draws[name].attrs["units"] = unit
        groups[group] = draws
    return made(groups, idata.attrs)


def of_subject(idata: InferenceData, model: pm.Model, subject: str) -> InferenceData:
    """One subject's posterior, with the variables of its own model.

    It is what `zoo.add_groups` takes with that model, for predictions and comparisons.

    Parameters
    ----------
    idata : InferenceData
        Draws of `model`, as sampled or from `by_subject`.
    model : pm.Model
        From `joint_model`.
    subject : str

    Returns
    -------
    InferenceData
        With the group posterior.

    Raises
    ------
    ModelError
        If there is no such subject.
    """
    record = joint_record_of(model)
    if subject not in record.subjects:
        raise ModelError(f"subject = {subject!r}: {nearest(subject, list(record.subjects))}")
    draws = datasets(idata)["posterior"]
    found = {}
    for own, here in record.variables[subject].items():
        one = draws[here] if here in draws else draws[own]
        one = one.sel(subject=subject, drop=True) if "subject" in one.dims else one
        found[own] = one.rename({d: str(d).removesuffix(f"[{subject}]") for d in one.dims}).rename(own)
    return made({"posterior": xr.Dataset(found)})


def joint_record_of(model: pm.Model) -> JointRecord:
    """The record of a model made by `joint_model`.

    Raises
    ------
    ModelError
        If the model has none.
    """
    record = getattr(model, "zoo", None)
    if not isinstance(record, JointRecord):
        raise ModelError("this PyMC model is not of several subjects: make it with zoo.joint_model")
    return record


def _records(models: Mapping[str, pm.Model] | Sequence[pm.Model]) -> dict[str, ModelRecord]:
    given = models.items() if isinstance(models, Mapping) else ((None, model) for model in models)
    found: dict[str, ModelRecord] = {}
    for name, model in given:
        record = record_of(model)
        name = str(name or (record.study or record.data).name)
        if name in found:
            raise ModelError(
                f"subject {name!r}: is there twice; give models by name, {{'one': ..., 'two': ...}}"
            )
        if "/" in name or not name:
            raise ModelError(f"subject {name!r}: a name without a slash is needed; give models by name")
        found[name] = record
    if len(found) < 2:
        raise ModelError(f"{len(found)} subjects: give at least two models")
    return found


def _parameters(record: ModelRecord) -> dict[str, Parameter]:
    return {p.name: p for p in (*record.forward.parameters, *record.errors.parameters)}


def _checked(
    share: Iterable[str], population: Iterable[str] | Mapping[str, str], records: Mapping[str, ModelRecord]
) -> tuple[list[str], dict[str, str]]:
    """Names that are shared, in the model's order, and those of a population with their scales."""
    for option, names in (("share", share), ("population", population)):
        if isinstance(names, str):
            raise ModelError(f"{option} = {names!r}: give a list, such as [{names!r}]")
    share, scales = list(share), dict.fromkeys(population, "")
    if isinstance(population, Mapping):
        scales = dict(population)
    tables = {subject: _parameters(record) for subject, record in records.items()}
    first = next(iter(tables.values()))
    for option, name in (*(("share", n) for n in share), *(("population", n) for n in scales)):
        for subject, table in tables.items():
            if name not in table:
                raise ModelError(f"{option} = {name}: subject {subject}: {nearest(name, list(table))}")
            one, other = first[name], table[name]
            for what, a, b in (
                ("prior", one.prior.text, other.prior.text),
                ("unit", one.unit, other.unit),
                ("size", one.size, other.size),
            ):
                if a != b or (what == "prior" and one.prior != other.prior):
                    raise ModelError(
                        f"{option} = {name}: its {what} is {a} in {next(iter(tables))} and {b} in {subject}: "
                        f"must be one; give all subjects the same, such as by priors={{{name!r}: ...}}, or "
                        "leave it to each"
                    )
        if lacking := [n for n in first[name].prior.depends_on if n not in share]:
            raise ModelError(f"{option} = {name}: its prior depends on {lacking[0]}: share that too")
    for name, scale in scales.items():
        p = first[name]
        if name in share:
            raise ModelError(f"population = {name}: is shared already; leave out one of both")
        if p.dims or p.prior.depends_on:
            raise ModelError(
                f"population = {name}: is no single number with a prior of its own; leave it out"
            )
        scales[name] = scale or ("log" if p.prior.support[0] >= 0 else "unconstrained")
        if scales[name] not in SCALES:
            raise ModelError(f"population = {name}: scale {scale!r}: must be one of {', '.join(SCALES)}")
        if scales[name] == "log" and p.prior.support[0] < 0:
            raise ModelError(f"population = {name}: scale 'log': its prior {p.prior.text} reaches below 0")
    return [name for name in first if name in share], {name: scales[name] for name in first if name in scales}


def _population(p: Parameter, scale: str, units: dict[str, str], priors: dict[str, str]) -> Any:
    """The subjects' values of a population's number, (n_subjects,)."""
    low, high = (0.0, math.inf) if scale == "log" else p.prior.support
    v = variable_name(p.name)
    edges = np.asarray(p.prior.quantile([0.16, 0.84]), dtype=np.float64)
    width = 0.5 * float(np.diff(_to(edges, low, high, np))[0])
    median = p.prior.variable(f"{v}_median", {})
    sd = pm.HalfNormal(f"{v}_sd", width)
    z = pm.Normal(f"{v}_offset", 0.0, 1.0, dims="subject")
    plain = math.isinf(low) and math.isinf(high)
    units |= {f"{v}_median": p.unit, f"{v}_sd": p.unit if plain else "1", f"{v}_offset": "1"}
    priors |= {
        f"{v}_median": p.prior.text,
        f"{v}_sd": f"half-normal({width:g})",
        f"{v}_offset": "normal(0, 1)",
    }
    return pm.Deterministic(v, _from(_to(median, low, high, pm.math) + sd * z, low, high), dims="subject")


def _to(x: Any, low: float, high: float, library: Any) -> Any:
    """The unconstrained scale of a number between bounds."""
    if math.isfinite(low) and math.isfinite(high):
        return library.log(x - low) - library.log(high - x)
    if math.isfinite(low):
        return library.log(x - low)
    return -library.log(high - x) if math.isfinite(high) else x


def _from(u: Any, low: float, high: float) -> Any:
    """The number on the unconstrained scale, back between its bounds."""
    if math.isfinite(low) and math.isfinite(high):
        return low + (high - low) * pm.math.sigmoid(u)
    if math.isfinite(low):
        return low + pm.math.exp(u)
    return high - pm.math.exp(-u) if math.isfinite(high) else u


def _coordinates(models: Any, record: ModelRecord, p: Parameter) -> list[Any]:
    """Coordinates of a vector, as the subject's own model has them."""
    for model in models.values() if isinstance(models, Mapping) else models:
        if model.zoo is record and model.coords.get(p.dims) is not None:
            return list(model.coords[p.dims])
    return list(range(p.size))


def _own(
    records: Mapping[str, ModelRecord], variables: Mapping[str, Mapping[str, str]]
) -> dict[str, list[str]]:
    """Numbers that every subject has for itself, and their variables."""
    found = {}
    every = (p for record in records.values() for p in _parameters(record).values())
    vectors = {variable_name(p.name) for p in every if p.dims}
    for v in next(iter(variables.values())):
        parts = [table.get(v) for table in variables.values()]
        if len(set(parts)) == len(records) and all(parts) and v not in vectors:
            found[v] = [str(part) for part in parts]
    return found
