"""Claims about definitions with several contacts, friction and phases: written down, read, refused, and as numbers."""

import copy
import json
import math
import pickle
import tomllib
from typing import Any

import numpy as np
import pytest
import tomli_w

from tests.refusals import refuse
from tests.workers.model.test_systems import MACHINE, values_of
from workers import System
from workers.model.definition import Definition
from workers.model.entries import DefinitionError
from workers.model.machines import Machines, faults
from workers.model.oscillator import map_fields
from workers.model.system import find_system, identity, system_names
from workers.results import NO_REASON, OUT_OF_DOUBLES, OUT_OF_RANGE

RIG = """
[system]
name = "rig"
coordinates = ["x1", "x2"]
mass = [[1, 0], [0, "m"]]
damping = [["c", 0], [0, 0.1]]
stiffness = [["1 + k", -1], [-1, 2]]
force = ["A", 0]
phase = [0.5, 0]
[[system.harmonics]]
order = 3
force = [0, 0.2]
[[system.contacts]]
name = "wall"
gap = [1, 0]
upper = "b"
lower = "-b"
restitution = "R"
[[system.contacts]]
name = "pad"
gap = [-1, 1]
lower = "-2 * b"
stiffness = "s"
damping = "s / 100"
preload = 0.25
release = "force"
[[system.friction]]
name = "ground"
row = [0, 1]
kinetic = "mu"
belt = 0.5
slope = -0.01
[[system.friction]]
name = "guide"
row = [1, 0]
kinetic = 0.1
static = "1.2 * mu"
[[system.phases]]
start = 0
[[system.phases]]
start = "duty"
stiffness = [["1 + 2 * k", -1], [-1, 2]]
damping = [["2 * c", 0], [0, 0.1]]
force = [0, "A"]
load = [0, "-A"]
contacts.pad = { preload = 0.5, stiffness = "2 * s" }
friction.ground = { kinetic = "mu / 2" }
[system.parameters]
m = { default = 2.0 }
c = { default = 0.1 }
k = { default = 3.0 }
A = { default = 1.5 }
b = { default = 0.4 }
R = { default = 0.7 }
s = { default = 20.0 }
mu = { default = 0.3 }
duty = { default = 0.25 }
"""

CAPSULE = """
[system]
name = "capsule"
coordinates = ["r", "x2"]
mass = [[1, 1], [1, 6]]
damping = [[0.1, 0], [0, 0]]
stiffness = [[1, 0], [0, 0]]
force = [1, 1]
drift = "x2"
[[system.contacts]]
name = "stop"
gap = [1, 0]
upper = 0.02
stiffness = 15
[[system.friction]]
name = "ground"
row = [0, 1]
kinetic = 0.5
"""

SQUARE = """
[system]
name = "square"
coordinates = ["x"]
mass = [[1]]
damping = [[0.1]]
stiffness = [[1]]
[[system.phases]]
start = 0
load = [0.5]
[[system.phases]]
start = 0.5
load = [-0.5]
"""

BELT = """
[system]
name = "belt"
coordinates = ["x"]
mass = [[1]]
damping = [[0.1]]
stiffness = [[1]]
[[system.friction]]
name = "belt"
row = [1]
kinetic = 0.4
static = 1
belt = 0.5
"""


def test_one_rigid_contact_is_the_short_form_under_a_name() -> None:
    given = tomllib.loads(MACHINE)["system"]
    entries = {key: given.pop(key) for key in ("gap", "upper", "lower", "restitution")}
    short = System.from_toml(MACHINE)
    assert System.from_mapping(given | {"contacts": [{"name": "stop", **entries}]}) == short
    assert short.definition.stop.name == "stop" and "contacts" not in short.table()
    named = System.from_mapping(given | {"contacts": [{"name": "wall", **entries}]})
    assert named.table()["contacts"] == [{"name": "wall"} | {key: short.table()[key] for key in entries}]
    values = values_of(short)
    for one, other in zip(named.build_many(values)[0].gap, short.build_many(values)[0].gap, strict=True):
        assert one.tobytes() == other.tobytes()


OWN = {"rig": RIG, "capsule": CAPSULE, "square": SQUARE, "belt": BELT}

each_system = pytest.mark.parametrize(
    "system",
    [*map(find_system, system_names()), *map(System.from_toml, OWN.values())],
    ids=[*system_names(), *(f"own {name}" for name in OWN)],
)


@each_system
def test_nothing_of_a_definition_is_lost_on_the_way_through_toml_json_and_pickle(system: System) -> None:
    for table in (json.loads(json.dumps(system.table())), tomllib.loads(tomli_w.dumps(system.table()))):
        again = System.from_mapping(table)
        assert (again.table(), again.parameters, again.definition) == (
            system.table(), system.parameters, system.definition,
        )  # fmt: skip
        assert hash(again.definition) == hash(system.definition)
    assert pickle.loads(pickle.dumps(system)) == system


@each_system
def test_all_machines_of_a_definition_are_made_alike_to_the_bit(system: System) -> None:
    """A machine is the same whether it is made alone or among many, but for the room that laws of others take."""

    def alike(alone: np.ndarray, among: np.ndarray) -> bool:
        own = among if among.shape == alone.shape else among[..., : alone.shape[-2], :]
        more = among[..., own.shape[-2] :, 0] if own is not among else np.zeros(0)
        return alone.tobytes() == own.tobytes() and bool(np.all(np.isinf(more)))

    rng = np.random.default_rng(5)
    values = {p.name: np.exp(rng.normal(size=50)) * (0.2 if p.high == 1.0 else 1.0) for p in system.parameters}
    made = system.definition.machines
    with np.errstate(all="ignore"):
        many = made(values)
        for k in (0, 7, 49):
            alone = made({key: column[k : k + 1] for key, column in values.items()})
            assert all(alike(a[0], b[k]) for a, b in zip(alone, many, strict=True))


def test_every_entry_enters_the_identity_and_its_spelling_does_not() -> None:
    def of(text: str) -> dict[str, Any]:
        return identity(System.from_toml(text).to_resolved())

    changes = {
        'name = "wall"': 'name = "gate"', 'release = "force"': 'release = "displacement"', "belt = 0.5": "belt = 0.6",
        "preload = 0.5": "preload = 0.6", 'kinetic = "mu / 2"': 'kinetic = "mu / 3"', 'start = "duty"': "start = 0.25",
        'static = "1.2 * mu"': 'static = "mu"',
    }  # fmt: skip
    for old, new in changes.items():
        assert RIG.count(old) == 1 and of(RIG.replace(old, new)) != of(RIG)
    spelt = RIG.replace("slope = -0.01", "slope = -1e-2").replace('"s / 100"', '"s/100.0"')
    assert of(spelt.replace('preload = 0.5, stiffness = "2 * s"', 'stiffness = "2*s", preload = 0.50')) == of(RIG)


def hybrid(system: System, **given: float | np.ndarray) -> Machines:
    return system.definition.machines(values_of(system, **given))


def test_values_of_parameters_make_the_numbers_of_each_phase() -> None:
    found = hybrid(System.from_toml(RIG), s=np.array([10.0, 20.0]), mu=np.array([0.25, 0.5]))
    assert found.starts.tolist() == [[0.0, 0.25, 1.0]] * 2
    assert found.stiffness[1].tolist() == [[[4.0, -1.0], [-1.0, 2.0]], [[7.0, -1.0], [-1.0, 2.0]]]
    assert found.damping[1].tolist() == [[[0.1, 0.0], [0.0, 0.1]], [[0.2, 0.0], [0.0, 0.1]]]
    assert found.load[1].tolist() == [[0.0, 0.0], [0.0, -1.5]]
    assert (found.row[0].tolist(), found.stops[0].tolist()) == ([[1, 0], [-1, 1]], [[-0.4, 0.4], [-0.8, math.inf]])
    assert (found.R[0].tolist(), found.soft[0].tolist(), found.by_force[0].tolist()) == ([0.7, 1.0], [0, 1], [0, 1])
    assert found.contact_constants.tolist() == [
        [[[0, 0, 0], [10, 0.1, 0.25]], [[0, 0, 0], [20, 0.1, 0.5]]],
        [[[0, 0, 0], [20, 0.2, 0.25]], [[0, 0, 0], [40, 0.2, 0.5]]],
    ]
    assert (found.friction_rows[0].tolist(), found.belt[0].tolist()) == ([[0, 1], [1, 0]], [0.5, 0.0])
    ground, guide = found.friction_constants[:, :, 0, 1], found.friction_constants[:, :, 1, 1]
    assert ground.tolist() == [[[0.25, 0.25, -0.01], [0.125, 0.125, -0.01]], [[0.5, 0.5, -0.01], [0.25, 0.25, -0.01]]]
    assert guide[:, 0].tolist() == guide[:, 1].tolist() == [[0.1, 1.2 * 0.25, 0.0], [0.1, 1.2 * 0.5, 0.0]]


def test_a_phase_changes_the_amplitude_of_the_first_order_and_leaves_angles_and_harmonics() -> None:
    found = hybrid(System.from_toml(RIG))
    assert found.force_sin[0, :, 0].tolist() == [[1.5 * math.cos(0.5), 0.0], [0.0, 1.5]]
    assert found.force_cos[0, :, 0].tolist() == [[1.5 * math.sin(0.5), 0.0], [0.0, 0.0]]
    assert found.force_sin[0, :, 2].tolist() == [[0.0, 0.2], [0.0, 0.2]]
    alone = hybrid(System.from_toml(SQUARE))
    assert (alone.force_sin.tolist(), alone.load.tolist()) == ([[[[0.0]], [[0.0]]]], [[[0.5], [-0.5]]])


FAULTS = [
    ({"k": math.inf}, OUT_OF_DOUBLES), ({"b": math.nan}, OUT_OF_DOUBLES), ({"b": -0.4}, OUT_OF_RANGE),
    ({"R": 2.2}, OUT_OF_RANGE), ({"s": -1.0}, OUT_OF_RANGE), ({"mu": -0.1}, OUT_OF_RANGE), ({"mu": 0.05}, OUT_OF_RANGE),
    ({"duty": 0.0}, OUT_OF_RANGE), ({"duty": 1.0}, OUT_OF_RANGE), ({"duty": math.nan}, OUT_OF_DOUBLES),
    ({"A": -1.0}, NO_REASON),
]  # fmt: skip


@pytest.mark.parametrize(("given", "reason"), FAULTS, ids=[str(given) for given, _ in FAULTS])
def test_values_that_make_no_element_are_told_of_their_cell_alone(given: dict[str, float], reason: int) -> None:
    system = System.from_toml(RIG)
    columns = {name: np.array([system.parameter(name).default, value]) for name, value in given.items()}
    assert faults(hybrid(system, **columns)).tolist() == [NO_REASON, reason]


def test_matrices_of_a_phase_need_not_be_symmetric() -> None:
    found = hybrid(System.from_toml(RIG), omega=np.ones(2))
    found.stiffness[1, 1, 0, 1] = 0.0
    assert faults(found).tolist() == [NO_REASON, NO_REASON]


def test_rows_that_depend_on_each_other_at_some_values_are_told() -> None:
    """Of rigid contacts and friction: the row of a contact also holds friction on it, and soft contacts hold none.

    Two frictions of one row stick at once where the contact is open, and what each of them takes is not determined.
    """
    found = hybrid(System.from_toml(RIG), omega=np.ones(9))
    found.friction_rows[1, 0] = [2.0, 0.0]  # along the guide's, twice as long
    found.friction_rows[2] = [[-2.0, 0.0], [0.0, 1.0]]  # against the wall's, twice as long, and no other there
    found.friction_rows[3, 1] = [0.0, -1.0]  # against the ground's
    found.row[4, 1] = [1.0, 0.0]  # a soft contact
    found.friction_rows[5, 0] = [1e-200, 0.0]  # along the guide's, however short
    found.row[6, 0] = [1e-200, 0.0]  # the wall's, along the guide's still
    found.soft[7:, 1] = 0.0
    found.row[7, 1] = [-3e-200, 0.0]  # a rigid contact against the wall's
    found.friction_rows[8] = [
        [0.0, 1e-200],
        [1e200, 1e200],
    ]  # friction on no contact's row, beside the wall's and the pad's
    wrong = np.isin(np.arange(9), [1, 3, 5, 7, 8])
    assert faults(found).tolist() == np.where(wrong, OUT_OF_RANGE, NO_REASON).tolist()
    assert map_fields(found, lambda field: field[:0]).mass.shape == (0, 2, 2)
    assert faults(map_fields(found, lambda field: field[:0])).tolist() == []


def rig(**changes: Any) -> dict[str, Any]:
    """The table of the rig with other entries, by paths such as contacts__0__gap; None takes one out."""
    table = tomllib.loads(RIG)["system"]
    for path, value in changes.items():
        *steps, last = (int(step) if step.isdigit() else step for step in path.split("__"))
        place: Any = table
        for step in steps:
            place = place[step]
        if value is None:
            del place[last]
        elif isinstance(place, list) and last == len(place):
            place.append(value)
        else:
            place[last] = value
    return table


SOFT = {"gap": [1, 0], "upper": 1, "stiffness": 1}
SLIDE = {"row": [1, 0], "kinetic": 1}
BOTH = "a rigid contact has a restitution, a soft one a stiffness, damping or law, preload and release"

WRONG = [
    ({"gap": [1, 0]}, "system.gap: found beside [[system.contacts]], must stand in one of these tables"),
    ({"upper": 1.0}, "system.upper: found beside [[system.contacts]]"),
    ({"lower": 1.0}, "system.lower: found beside [[system.contacts]]"),
    ({"restitution": 1.0}, "system.restitution: found beside [[system.contacts]]"),
    ({"contacts": {"name": "wall"}}, "system.contacts: found {'name': 'wall'}, must be tables [[system.contacts]]"),
    ({"contacts": []}, "system.contacts: found none; give one, or leave the key out"),
    ({"contacts": [1]}, "system.contacts[0]: found 1, must be a table"),
    ({"contacts__0__gpa": 1}, "unknown key in system.contacts[0] 'gpa'; did you mean 'gap'?"),
    ({"contacts__0__name": None}, "system.contacts[0]: name missing"),
    ({"contacts__0__name": "a b"}, "system.contacts[0].name: found 'a b', must be a name of letters"),
    ({"contacts__0__name": "pi"}, "system.contacts[0].name: 'pi' has another meaning already"),
    ({"contacts__1__name": "wall"}, "system.contacts[1].name: there is a contact 'wall' already; choose another"),
    ({"contacts__0__gap": None}, "system.contacts[0]: gap missing"),
    ({"contacts__0__gap": [1]}, "system.contacts[0].gap: found 1 entries, must be 2, one per coordinate"),
    ({"contacts__0__gap": ["x1", 0]}, "system.contacts[0].gap[0]: unknown name 'x1'"),
    ({"contacts__0__gap": [0, 0]}, "system.contacts[0].gap: found zeros only; give the row that makes y of the"),
    ({"contacts__1__lower": None}, "system.contacts[1]: upper and lower missing; give one stop or both"),
    ({"contacts__0__upper": "-2 * b"}, "system.contacts[0].upper: found -0.8, lower -0.4 at the defaults, must be"),
    ({"contacts__0__stiffness": 1.0}, f"system.contacts[0]: found restitution and stiffness; {BOTH}"),
    ({"contacts__1__restitution": 1.0}, f"system.contacts[1]: found restitution and stiffness; {BOTH}"),
    ({"contacts__0__release": "force"}, f"system.contacts[0]: found restitution and release; {BOTH}"),
    ({"contacts__0__restitution": None}, f"system.contacts[0]: restitution missing; {BOTH}"),
    ({"contacts__1__stiffness": None, "contacts__1__damping": None}, f"system.contacts[1]: stiffness missing; {BOTH}"),
    ({"contacts__0__restitution": -0.5}, "system.contacts[0].restitution: found -0.5 at the defaults, must be 0 to 2"),
    ({"contacts__1__stiffness": -1}, "system.contacts[1].stiffness: found -1 at the defaults, must be 0 or more"),
    ({"contacts__1__damping": "-s", "contacts__1__release": "force"},
     "system.contacts[1].damping: found -20 at the defaults, must be 0 or more with release"),
    ({"contacts__1__preload": -0.5}, "system.contacts[1].preload: found -0.5 at the defaults, must be 0 or more"),
    ({"contacts__1__preload": "1 / (k - 3)"}, "system.contacts[1].preload: found inf at the defaults, must be finite"),
    ({"contacts__1__stiffness": "ks"}, "system.contacts[1].stiffness: unknown name 'ks'"),
    ({"contacts__1__release": "speed"}, "system.contacts[1].release: found 'speed', must be 'displacement' or 'force'"),
    ({"contacts__1__release": ["force"]}, "system.contacts[1].release: found ['force'], must be"),
    ({"contacts__2": SOFT | {"name": "c", "lower": -1}}, "system.contacts: found 5 stops, sides counted, must be at m"),
    ({"phases": [], "contacts__1": {"name": "c", "gap": ["-k", 0], "upper": 1, "restitution": 0}},
     "system.contacts[1].gap: found [-3.0, 0.0] at the defaults, depends on rows of rigid contacts and friction"),
    ({"friction": {}}, "system.friction: found {}, must be tables [[system.friction]]"),
    ({"friction__0__knetic": 1}, "unknown key in system.friction[0] 'knetic'; did you mean 'kinetic'?"),
    ({"friction__0__name": None}, "system.friction[0]: name missing"),
    ({"friction__1__name": "ground"}, "system.friction[1].name: there is a friction element 'ground' already"),
    ({"friction__0__row": None}, "system.friction[0]: row missing; give a row"),
    ({"friction__0__row": [1, 0, 0]}, "system.friction[0].row: found 3 entries, must be 2"),
    ({"friction__0__row": [0, 0]}, "system.friction[0].row: found zeros only; give the row that makes the sliding"),
    ({"friction__0__row": [2, 0]}, "system.friction[1].row: found [1.0, 0.0] at the defaults, depends on rows of"),
    ({"friction__0__kinetic": None}, "system.friction[0]: kinetic missing; give a force"),
    ({"friction__0__kinetic": -1}, "system.friction[0].kinetic: found -1 at the defaults, must be 0 or more"),
    ({"friction__1__static": 0.05}, "system.friction[1].static: found 0.05, kinetic 0.1 at the defaults, must not be"),
    ({"friction": [SLIDE | {"name": f"f{i}"} for i in range(5)]}, "system.friction: found 5, must be at most 4"),
    ({"phases": 1}, "system.phases: found 1, must be tables [[system.phases]]"),
    ({"phases": [{"start": i / 20} for i in range(17)]}, "system.phases: found 17, must be at most 16"),
    ({"phases__0__strat": 1}, "unknown key in system.phases[0] 'strat'; did you mean 'start'?"),
    ({"phases__0__start": None}, "system.phases[0]: start missing; give a share of the forcing period"),
    ({"phases__0__start": 0.1}, "system.phases[0].start: found 0.1, must be 0; the first phase begins at the section"),
    ({"phases__0__start": "duty"}, "system.phases[0].start: found 'duty', must be 0"),
    ({"phases__1__start": 0}, "system.phases[1].start: found 0 after 0 at the defaults, must rise and stay below 1"),
    ({"phases__1__start": "4 * duty"}, "system.phases[1].start: found 1 after 0 at the defaults, must rise and stay"),
    ({"phases__2": {"start": 0.2}}, "system.phases[2].start: found 0.2 after 0.25 at the defaults, must rise"),
    ({"phases__1__mass": [[1, 0], [0, 1]]}, "system.phases[1].mass: phases cannot change mass, rows or positions"),
    ({"phases__1__gap": [1, 0]}, "system.phases[1].gap: phases cannot change mass, rows or positions"),
    ({"phases__1__contacts__pad__gap": [1, 0]}, "system.phases[1].contacts.pad.gap: phases cannot change mass, rows"),
    ({"phases__1__contacts__pad__lower": 0}, "system.phases[1].contacts.pad.lower: phases cannot change mass, rows or"),
    ({"phases__1__contacts__wall": {"upper": 1}}, "system.phases[1].contacts.wall.upper: phases cannot change mass,"),
    ({"phases__1__friction__ground__row": [1, 0]}, "system.phases[1].friction.ground.row: phases cannot change mass,"),
    ({"phases__1__contacts": {"pda": {}}}, "unknown element in system.phases[1].contacts 'pda'; did you mean 'pad'?"),
    ({"phases__1__friction": {"pad": {}}}, "unknown element in system.phases[1].friction 'pad'; known: ground, guide"),
    ({"phases__1__contacts": 1}, "system.phases[1].contacts: found 1, must be a table"),
    ({"phases__1__contacts__pad": 1}, "system.phases[1].contacts.pad: found 1, must be a table"),
    ({"phases__1__contacts__wall": {"stiffness": 1}}, "system.phases[1].contacts.wall: wall is rigid; a phase changes"),
    ({"phases__1__contacts__pad__release": "force"}, "unknown key in system.phases[1].contacts.pad 'release'"),
    ({"phases__1__friction__ground__belt": 1}, "unknown key in system.phases[1].friction.ground 'belt'"),
    ({"phases__1__contacts__pad__preload": -1}, "system.phases[1].contacts.pad.preload: found -1 at the defaults"),
    ({"phases__1__friction__guide": {"static": 0}}, "system.phases[1].friction.guide.static: found 0, kinetic 0.1 at"),
    ({"phases__1__stiffness": [[1, 0]]}, "system.phases[1].stiffness: found 1 rows, must be 2, one per coordinate"),
    ({"phases__1__force": [1]}, "system.phases[1].force: found 1 entries, must be 2"),
    ({"phases__1__force": [0, "1 / (k - 3)"]}, "system.phases[1].force of order 1: found [0.0, inf] at the defaults"),
    ({"phases__1__load": ["q", 0]}, "system.phases[1].load[0]: unknown name 'q'"),
    ({"phases__1__load": [0, "1 / (k - 3)"]}, "system.phases[1].load: found [0.0, inf] at the defaults, must be"),
    ({"drift": "x3"}, "unknown coordinate in system.drift 'x3'; did you mean 'x2'?"),
    ({"drift": 1}, "system.drift: found 1, must be text in quotes"),
    ({"drift": "x2"}, "system.drift: system.stiffness ties x2 down at the defaults; leave out this entry or drift"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), WRONG, ids=[message for _, message in WRONG])
def test_a_definition_that_is_wrong_gets_one_line(changes: dict[str, Any], message: str) -> None:
    refuse(rig(**changes), message)


def test_a_phase_without_elements_to_change_says_that_there_are_none() -> None:
    given = tomllib.loads(SQUARE)["system"]
    given["phases"][1]["friction"] = {"ground": {"kinetic": 1}}
    with pytest.raises(
        DefinitionError, match=r"unknown element in system\.phases\[1\]\.friction 'ground'; known: none"
    ):
        System.from_mapping(given)


def test_what_drifts_has_to_be_declared_and_tied_down_by_nothing() -> None:
    with pytest.raises(DefinitionError, match=r"leaves a free motion that the gap does not see.*drift = NAME"):
        System.from_toml(CAPSULE.replace('drift = "x2"', ""))
    with pytest.raises(DefinitionError, match="the gap row of a contact ties x2 down"):
        System.from_toml(CAPSULE.replace("gap = [1, 0]", "gap = [1, 1]"))
    with pytest.raises(DefinitionError, match=r"system\.drift: found in a machine without a force; .* give force too"):
        System.from_toml(CAPSULE.split("[[system.friction]]")[0].replace("force = [1, 1]", ""))


def test_friction_may_be_on_the_row_of_a_rigid_contact_and_soft_contacts_on_any() -> None:
    wall = {"name": "second", "gap": [1, 0], "upper": 0.3, "stiffness": 5.0}
    definition: Definition = System.from_mapping(rig(contacts__1=wall, phases__1__contacts={})).definition
    assert [one.name for one in definition.contacts] == ["wall", "second"]
    assert definition.friction[1].row == definition.contacts[0].gap


def test_an_infinite_stop_is_none_and_counts_as_none() -> None:
    given = tomllib.loads(MACHINE)["system"]
    assert System.from_mapping(given | {"upper": math.inf}).definition.stop.stops == 1


JUNK = (0, -1.5, True, math.nan, 10**400, "k", "x1", "1 +", "", [], [1, 0], [[1, 0], [0, 1]], ["k"], {}, {"a": 1}, [{}])


def paths(entries: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to each entry of tables and lists in each other."""
    inside = entries.items() if isinstance(entries, dict) else enumerate(entries) if isinstance(entries, list) else ()
    return [path, *(found for key, entry in inside for found in paths(entry, (*path, key)))]


@pytest.mark.parametrize("key", ["contacts", "friction", "phases", "drift"])
def test_whatever_stands_in_an_entry_is_read_or_refused_in_one_line(key: str) -> None:
    whole = rig(drift="x2")
    for *steps, last in paths(whole[key], (key,)):
        for junk in JUNK:
            given = copy.deepcopy(whole)
            place: Any = given
            for step in steps:
                place = place[step]
            place[last] = junk
            try:
                System.from_mapping(given)
            except DefinitionError as error:
                assert "\n" not in str(error) and len(str(error)) < 350
