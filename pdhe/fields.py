"""Every quantity that a result holds, declared once: name, unit, meaning and shape."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Field:
    """One variable of a result file.

    Attributes
    ----------
    unit
        As written into the file; ``1`` for numbers.
    long_name
        Meaning, fit for an axis label.
    dims
        Names of the dimensions.
    """

    unit: str
    long_name: str
    dims: tuple[str, ...]


_STATIC = ("node",)
_SNAPSHOT = ("time", "node")
_HISTORY = ("step",)

#: Variables of a result file. Those of absent physics are left out of it.
FIELDS: dict[str, Field] = {
    "time": Field("s", "time", ("time",)),
    "node_x": Field("m", "x of the node", _STATIC),
    "node_y": Field("m", "y of the node", _STATIC),
    "node_z": Field("m", "z of the node", _STATIC),
    "volume": Field("m^3", "volume of the node's cell", _STATIC),
    "vertices": Field("m", "position of the mesh vertex", ("vertex", "component")),
    "cells": Field(
        "1", "vertices of the node's cell, counter-clockwise; in space as gmsh orders them", ("node", "corner")
    ),
    "displacement": Field("m", "displacement", ("time", "node", "component")),
    "velocity": Field("m/s", "velocity", ("time", "node", "component")),
    "stress": Field("Pa", "stress of a user material, in the order of Abaqus", ("time", "node", "entry")),
    "state_variables": Field("1", "state variables of a user material, in its own units", ("time", "node", "variable")),
    "damage": Field("1", "damage: volume-weighted share of broken bonds", _SNAPSHOT),
    "coverage": Field("1", "hydrogen coverage", _SNAPSHOT),
    "history_time": Field("s", "time of the history entry", _HISTORY),
    "elastic_energy": Field("J", "elastic energy", _HISTORY),
    "plastic_dissipation": Field("J", "plastic dissipation that a user material tells (SPD)", _HISTORY),
    "creep_dissipation": Field("J", "creep dissipation that a user material tells (SCD)", _HISTORY),
    "kinetic_energy": Field("J", "kinetic energy", _HISTORY),
    "external_work": Field("J", "work done by prescribed displacements, and tractions", _HISTORY),
    "damping_loss": Field("J", "energy taken by damping since the start", _HISTORY),
    "fracture_energy": Field("J", "energy held by bonds at the moment they broke", _HISTORY),
    "crack_length": Field("m", "equivalent crack length: broken bonds over bonds crossing a unit length", _HISTORY),
    "crack_extension": Field("m", "distance of the foremost broken short bond from the pre-cracks", _HISTORY),
    "crack_tip_x": Field("m", "x of the foremost broken short bond", _HISTORY),
    "crack_tip_y": Field("m", "y of the foremost broken short bond", _HISTORY),
    "crack_tip_z": Field("m", "z of the foremost broken short bond", _HISTORY),
    "mean_damage": Field("1", "volume-averaged damage", _HISTORY),
    "broken_bonds": Field("1", "bonds broken since the start", _HISTORY),
    "largest_load": Field("1", "largest load over resistance among the bonds that may still break", _HISTORY),
    "mean_coverage": Field("1", "volume-averaged coverage", _HISTORY),
    "hydrogen_content": Field("m^3", "coverage integrated over the volume", _HISTORY),
    "hydrogen_influx": Field("m^3", "hydrogen that entered through edges and held nodes since the start", _HISTORY),
    "failure_rounds": Field("1", "rounds of bond failures so far", _HISTORY),
    "time_steps": Field("1", "steps of the motion so far", _HISTORY),
    "equilibrium_solves": Field("1", "equilibrium solves so far", _HISTORY),
    "equilibrium_iterations": Field("1", "conjugate-gradient iterations so far", _HISTORY),
    "force_sweeps": Field("1", "force sweeps over all bonds so far", _HISTORY),
    "diffusion_sweeps": Field("1", "diffusion sweeps over all bonds so far", _HISTORY),
    "diffusion_iterations": Field(
        "1", "iterations of implicit diffusion steps so far, their sweeps counted above", _HISTORY
    ),
    "broken_i": Field("1", "first node of the broken bond", ("broken",)),
    "broken_j": Field("1", "second node of the broken bond; in a part, by its number in the whole body", ("broken",)),
    "broken_time": Field("s", "time at which the bond broke", ("broken",)),
}


def field_of(name: str) -> Field:
    """Return the declaration of a variable; those of a node set are named after it, ``reaction_top_y``.

    State variables of a user material have the unit that their scene gives, 1 here.
    """
    if name.startswith("reaction_"):
        where, component = name.removeprefix("reaction_").rsplit("_", 1)
        return Field("N", f"reaction on {where} along {component}", _HISTORY)
    if name.startswith("applied_"):
        where, component = name.removeprefix("applied_").rsplit("_", 1)
        return Field("m", f"prescribed displacement of {where} along {component}", _HISTORY)
    if name.startswith("traction_"):
        where, component = name.removeprefix("traction_").rsplit("_", 1)
        return Field("Pa", f"traction on {where} along {component}", _HISTORY)
    if name.startswith("state_") and name not in FIELDS:
        return Field("1", f"state variable {name.removeprefix('state_')} of the user material", _SNAPSHOT)
    return FIELDS[name]
