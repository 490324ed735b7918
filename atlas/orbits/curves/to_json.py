"""Bifurcations, grazes and their curves as JSON text, with all floating-point numbers exact."""

from typing import Any

import numpy as np

from atlas.orbits.curves.following import FollowedCurve, PlaneEvent
from workers.continuation import Condition, Itinerary, Orbit
from workers.continuation.itinerary import Leg
from workers.model.hybrid_modes import ModeCode


def event_as_json(event: PlaneEvent) -> dict[str, Any]:
    """Return a bifurcation or graze as dicts, lists, numbers and strings for JSON."""
    return {
        "kind": event.kind,
        "condition": list(event.condition),
        "orbit": orbit_as_json(event.orbit),
        "contacts": event.contact_times.tolist(),
        "values": event.values.tolist(),
        "kappa": None if np.isnan(event.kappa) else event.kappa,
    }


def event_from_json(data: dict[str, Any]) -> PlaneEvent:
    """Return the bifurcation or graze from the result of ``event_as_json``."""
    return PlaneEvent(
        kind=data["kind"],
        condition=Condition(*data["condition"]),
        orbit=orbit_from_json(data["orbit"]),
        contact_times=np.array(data["contacts"], dtype=np.float64),
        values=np.array(data["values"]),
        kappa=np.nan if data["kappa"] is None else data["kappa"],
    )


def curve_as_json(followed: FollowedCurve) -> dict[str, Any]:
    """Return a curve as dicts, lists, numbers and strings for JSON.

    Itineraries, each the sequence of impacts and other events of an orbit, are listed once, with the condition that
    defines the curve for them. Orbits refer to them by index.
    """
    pairs = [
        (orbit.itinerary, condition) for orbit, condition in zip(followed.orbits, followed.conditions, strict=True)
    ]
    shared = list(dict.fromkeys(pairs))
    return {
        "of": event_as_json(followed.event),
        "itineraries": [[list(itinerary), list(condition)] for itinerary, condition in shared],
        "which": [shared.index(pair) for pair in pairs],
        "values": followed.values.tolist(),
        "times": [orbit.times.tolist() for orbit in followed.orbits],
        "speeds": [orbit.speeds.tolist() for orbit in followed.orbits],
        "lengths": [_as_length(orbit) for orbit in followed.orbits],
        "contacts": followed.contact_times.tolist(),
        "unstable": followed.unstable.tolist(),
        "corners": [[kind, point.tolist()] for kind, point in followed.corners],
        "ends": list(followed.ends),
    }


def curve_from_json(data: dict[str, Any]) -> FollowedCurve:
    """Return the curve from the result of ``curve_as_json``."""
    shared = [(_itinerary(itinerary), Condition(*condition)) for itinerary, condition in data["itineraries"]]
    orbits = [
        _orbit(shared[k][0], *fields)
        for k, *fields in zip(data["which"], data["times"], data["speeds"], data["lengths"], strict=True)
    ]
    first, last = data["ends"]
    return FollowedCurve(
        event=event_from_json(data["of"]),
        values=np.array(data["values"]),
        orbits=orbits,
        contact_times=np.array(data["contacts"], dtype=np.float64).reshape(len(orbits), -1),
        conditions=[shared[k][1] for k in data["which"]],
        unstable=np.array(data["unstable"], dtype=np.int64),
        corners=[(kind, np.array(point)) for kind, point in data["corners"]],
        ends=(first, last),
    )


def orbit_as_json(orbit: Orbit) -> dict[str, Any]:
    """Return an orbit as dicts, lists, numbers and strings for JSON."""
    return {
        "itinerary": list(orbit.itinerary),
        "times": orbit.times.tolist(),
        "speeds": orbit.speeds.tolist(),
        "length": _as_length(orbit),
    }


def orbit_from_json(data: dict[str, Any]) -> Orbit:
    """Return the orbit from the result of ``orbit_as_json``."""
    return _orbit(_itinerary(data["itinerary"]), data["times"], data["speeds"], data["length"])


def _as_length(orbit: Orbit) -> float | None:
    return None if np.isnan(orbit.length) else float(orbit.length)


def _orbit(itinerary: Itinerary, times: list[float], speeds: list[float], length: float | None) -> Orbit:
    fields = (np.array(field, dtype=np.float64) for field in (times, speeds, np.nan if length is None else length))
    return Orbit(itinerary, *fields)


def _itinerary(data: list[Any]) -> Itinerary:
    sides, periods, symmetric, legs = data
    return Itinerary(tuple(sides), periods, symmetric, tuple(tuple(map(_leg, chain)) for chain in legs))


def _leg(data: list[Any]) -> Leg:
    (phase, contacts, slips), begun, signal, side = data
    return Leg(ModeCode(phase, tuple(contacts), tuple(slips)), tuple(begun), signal, side)
