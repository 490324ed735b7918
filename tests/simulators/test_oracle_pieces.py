"""The oracle of piecewise-linear machines and its record of orbits, against digits published before both.

Truth: another solver's table of thirty rows (certified simulation in modal blocks, Newton's method in 28 digits), as
printed: 10 to 16 digits of event times, velocities or positions, multipliers and measures.
"""

import json
import math
import re
from typing import Any

import numpy as np
import pytest

from tests.paths import DATA
from tests.support.oracle.piecewise import PiecewiseMachine, PiecewiseMode, measures, orbit, simulate
from tests.support.oracle.piecewise.one_mass import belt, soft

RECORDS: dict[str, dict[str, Any]] = {
    record["name"]: record for record in json.loads((DATA / "piecewise.json").read_text())
}
DRIVEN = [
    name
    for name, record in RECORDS.items()
    if record["periods"] and record.get("admissible", True) and record.get("bifurcation", {}).get("kind") != "graze"
]

# Events: kind, time and, where printed, row.v before an impact, a hit or an opening, else row.x.
EVENTS = {
    "row 2": "hit 6.378485282213 .9261676526547, open .3071495296647 -.9224812777382",
    "row 2, PD": "hit 6.63098301648 .780407037019",
    "row 3": "hit 14.35849762722 1.06334959178, open .2866028257783 -1.058258217526",
    "row 3, PD": "hit 13.4729968888 1.44034002522",
    "row 4": "hit 6.385482606449 .9835138063149, open .3145597806336 -.8614265014806",
    "row 5": "hit 6.385281025486 .9815843348285, detach .2971081873131 1.014756366611, "
    "open .3142732758420 -.8634421449537",
    "row 6": "hit .01024658261735 1.181088015386, open .8141711064092 -1.130656600466",
    "row 7": "hit 8.111446360406 .2096764042515, open 8.445220720945 -.2068943809825",
    "row 8": "hit 6.280442017588 1.063755627055, open .4476752292741 -.9271152033847",
    "row 9": "open .5966250107323 -1.758490059242, hit 1.800726692143 -1.793144835083",
    "row 11": "hit .2624596027416 -.7285205170955, open .5970875547866",
    "row 12": "turn 1.116591030269 5.451110034186",
    "row 13": "turn 1.791555774823 2.545200991252",
    "row 15": "slip- 2.859611695712 2.028196045499, stick 7.734343403583",
    "row 16": "slip- 2.600817206063 2.011876650814, stick 7.752018175969",
    "row 17": "stick 4.852290765476 .04690309471873",
    "row 18": "stick 5.528804899215",
    "row 19": "slip- 1.883900318864 .8575960406115, stick 5.817377179760 -.3172581825302",
    "row 20": "stick .5419990349756 .0874164142169, slip- 1.884798801911",
    "row 21": "impact .2617136037628 1.808046303040, turn 4.592900791101 -1.259907369432",
    "row 22": "turn .7556425668872, stick 1.899833328899 .3135467187574, slip- 2.053628996259, turn 5.439853405044, "
    "impact 7.587026334677 1.883636149199",
    "row 23": "impact .6562831321744 .6055079504952, impact 2.270721948275 -.2780428217263",
    "row 24": "impact 1.216020878299 -.1731496507997, impact 2.044046036479 -.0805950774441, "
    "impact 3.805166545355 .5877723115524",
    "row 25": "impact .2700794443008 .4260161661584, impact .7964289189319 .8650631174521",
    "row 27, omega 1": "impact .5173557969453 2.033335275623",
    "row 27, omega 1.5": "impact .9813743181981 7.176296663961",
    "row 28": "hit 1.440061704675 1.22483260967, open 2.085781383526",
    "row 29": "open .4706635832367, stick 2.961679671706, slip- 4.249648395313, hit 6.660203247608 1.500858217822, "
    "turn 6.832402226744",
    "row 30": "impact 1.152249885828, leave 3.024194338506",
}

MULTIPLIERS = {
    "row 2": "-.8074860407841+-.4733540570223i",
    "row 2, PD": "-1, -.871772808002",
    "row 3": "-.500034852421+-.7046655948752i",
    "row 3, PD": "-1, -.760013359099",
    "row 4": "-.7040146997665+-.414934304599i",
    "row 5": "-.7071206054445+-.4166201817997i",
    "row 6": "-.1701385680798+-.5056307061362i",
    "row 7": "-.1215979823907+-.1686056017524i",
    "row 8": "-.4933645176128+-.6305501819578i",
    "row 11": "-.6052076334692+-.6205082485899i, -.7175730984221+-.3258993739473i",
    "row 12": ".3918963831555+-.2067261983242i",
    "row 13": ".2586039188032+-.3533733005559i",
    "row 15": ".087666379356398, 0",
    "row 16": ".0833727028467, 0",
    "row 19": "-.1640881228547, 0",
    "row 20": "-.200053376606, 0",
    "row 21": "-.3282289248611+-.0546944698823i",
    "row 22": "-.0424172600416, 0",
    "row 23": ".4489245079254+-.4142265820595i, -.369299022687+-.198405837331i",
    "row 24": "-.5448610513752+-.6129385506585i, -.3276386830156, -.0704671506014",
    "row 25": "-.0198470233379+-.684499381627i, -.3355703110901+-.1650126208204i",
    "row 26, omega 2": "-1.400774178967, -.521427866115",
    "row 26, omega 1.3": "-.061928893245+-.78287677766i",
    "row 27, omega 1": "-.4533543459753+-.2363873973374i",
    "row 27, omega 1.5": ".526299511050+-.212891689340i",
    "row 28": "-.3643235872076+-.6061325607946i",
    "row 29": "1, -.3492356772368+-.3778929350949i, 0",
    "row 30": "-.078679524025+-.358980020685i, 0, 0",
}

HALF = {
    "row 9": "-.1495881993125+-.8812600422955i",
    "row 10, SB": "-1, -.741798365148",
    "row 10, fold": "1, .901144129332",
}

SUMS = {
    "row 4": "-.403755807864057",
    "row 5": "-.39513080168556",
    "row 12": "-1.62801695797185",
    "row 21": "-2.20069919748268",
    "row 23": "-2.72457541159632",
}

MEASURES = {
    "row 5": "stop_loss .1057152280443, damper_loss .07970583872638, rms .8020194471524, "
    "max_penetration .1540882475896, max_force 4.49040733487, contact_fraction .0794853384866",
    "row 28": "stop_loss .04314610755082, damper_loss .5219713620184, max_penetration .2366118001557, "
    "rms .9020511769428",
    "row 29": "friction_loss .4641904504305, damper_loss .3408403761775",
}

BIFURCATIONS = {
    "row 2, PD": ".915739816787582",
    "row 3, PD": ".915851915327889",
    "row 10, SB": "1.05183326851636",
    "row 10, fold": "3.0181483284447",
    "row 18": ".658855574469524",
}


def printed(text: str) -> tuple[float, float]:
    """A printed number and one unit of its last digit, which covers rounding either way."""
    decimals = len(text.partition(".")[2])
    return float(text), 1.01 * 10.0**-decimals + 4e-16 * abs(float(text))


def agrees(value: float, text: str) -> bool:
    number, unit = printed(text)
    return abs(value - number) <= unit


def listed(text: str) -> list[tuple[str, list[str]]]:
    return [(kind, numbers) for kind, *numbers in (event.split() for event in text.split(", "))]


def eigenvalues(text: str) -> list[tuple[str, str]]:
    """(re, im) as printed, both of a pair."""
    result = []
    for part in text.split(", "):
        pair = re.fullmatch(r"(.+)\+-(.+)i", part)
        result += [(pair[1], pair[2]), (pair[1], "-" + pair[2])] if pair else [(part, "0.000000000000")]
    return result


def check_multipliers(found: list[list[float]], text: str) -> None:
    expected = eigenvalues(text)
    assert len(found) == len(expected)
    for re_, im in expected:
        assert any(agrees(a, re_) and agrees(b, im) for a, b in found), (re_, im, found)
        if re_ == "0":
            assert [0.0, 0.0] in found  # a lost direction, exactly


def mode_of(record: dict[str, Any]) -> PiecewiseMode:
    return PiecewiseMode(0, tuple(record["mode"]["contacts"]), tuple(record["mode"]["friction"]))


# The record


@pytest.mark.parametrize("name", EVENTS)
def test_events_are_those_published(name: str) -> None:
    for kind, numbers in listed(EVENTS[name]):
        close = [e for e in RECORDS[name]["events"] if e[1] == kind and agrees(e[0], numbers[0])]
        assert len(close) == 1, (kind, numbers, RECORDS[name]["events"])
        assert len(numbers) == 1 or agrees(close[0][3], numbers[1]), (numbers, close)


@pytest.mark.parametrize("name", MULTIPLIERS)
def test_multipliers_are_those_published(name: str) -> None:
    check_multipliers(RECORDS[name]["multipliers"], MULTIPLIERS[name])


@pytest.mark.parametrize("name", HALF)
def test_multipliers_of_half_a_turn_are_those_published(name: str) -> None:
    check_multipliers(RECORDS[name]["half_multipliers"], HALF[name])


def test_sums_measures_and_bifurcations_are_those_published() -> None:
    for name, text in SUMS.items():
        assert agrees(RECORDS[name]["sum"], text), name
    for name, text in MEASURES.items():
        for key, (number,) in listed(text):
            found = RECORDS[name]["measures"][key]
            assert agrees(found[0] if isinstance(found, list) else found, number), (name, key)
    for name, text in BIFURCATIONS.items():
        assert agrees(RECORDS[name]["bifurcation"]["value"], text), name
    assert agrees(RECORDS["row 29"]["measures"]["progress"][1], ".57356518777823")
    cycle = RECORDS["row 17"]
    assert agrees(cycle["events"][1][0] - cycle["events"][0][0], "1.806193810563")
    assert cycle["state"] == [0.95, 0.5]


# The simulator


@pytest.mark.parametrize("name", DRIVEN)
def test_a_motion_from_a_recorded_state_closes_after_the_recorded_events(name: str) -> None:
    record = RECORDS[name]
    machine = PiecewiseMachine.of(record["machine"])
    run = simulate(machine, record["state"], record["periods"], mode=mode_of(record), digits=24, rest=1e-9)
    start, end = (np.array(state, dtype=float) for state in (run.sections[0], run.sections[-1]))
    away = end - start
    if record["drift"] is not None:
        away[record["drift"]] -= record["measures"]["progress"][record["drift"]] * record["periods"]
    assert np.abs(away).max() < 1e-13 * max(1.0, np.abs(start).max()) * (100 if "fold" in name else 10)
    fast = [e for e in run.events if e.kind != "impact" or abs(e.value) > 1e-3]
    assert [(e.kind, e.index) for e in fast] == [(kind, index) for _, kind, index, _ in record["events"]]
    for event, (t, _, _, value) in zip(fast, record["events"], strict=True):
        assert abs(float(event.t) - t) < (
            1e-9 if event.kind == "rest" else 1e-12
        )  # the rest of the chatter is left out
        assert abs(float(event.value) - value) < 1e-11
    half = simulate(machine, record["state"], span=run_span(machine, 0.5), mode=mode_of(record), digits=24, rest=1e-9)
    opposite = np.abs(np.array(half.sections[-1], dtype=float) + start).max()
    assert record["symmetric"] is bool(opposite < 1e-11) or "row 26" in name


def run_span(machine: PiecewiseMachine, periods: float) -> float:
    return periods * 2 * math.pi / machine.omega


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in DRIVEN if name in {**MULTIPLIERS, **HALF}])
def test_orbit_multipliers_and_measures_come_out_again(name: str) -> None:
    record = RECORDS[name]
    machine, mode = PiecewiseMachine.of(record["machine"]), mode_of(record)
    if "bifurcation" not in record:
        start = [round(value, 5) for value in record["state"]]
        found = orbit(machine, start, record["periods"], mode=mode, drift=record["drift"])
        np.testing.assert_allclose(np.array(found.state, dtype=float), record["state"], rtol=0, atol=1e-12)
        values = [[m.real, m.imag] if abs(m) > 1e-20 else [0.0, 0.0] for m in found.multipliers]
        np.testing.assert_allclose(values, record["multipliers"], rtol=0, atol=1e-13)
    again = measures(machine, record["state"], record["periods"], mode=mode)
    for key, value in record["measures"].items():
        np.testing.assert_allclose(again[key], value, rtol=1e-11, atol=1e-12)


# Rows at bifurcation points


def test_row_1_is_where_the_linear_answer_is_1() -> None:
    for name, text in (("row 1, omega 0.782", ".782204086871376"), ("row 1, omega 1.655", "1.65477114143231")):
        omega = RECORDS[name]["bifurcation"]["value"]
        assert agrees(omega, text)
        amplitude = 0.8 * omega**2 / 1.26 / abs(1 - omega**2 + 0.02j * omega)
        assert amplitude == pytest.approx(1.0, abs=2e-14)


def test_the_period_doubling_of_row_3_leaves_out_a_contact() -> None:
    """Its equations have one contact in two periods; the motion from its state touches the stop once more."""
    record = RECORDS["row 3, PD"]
    run = simulate(soft(record["machine"]["omega"]), record["state"], 2, mode=mode_of(record), digits=24, rest=1e-9)
    assert [e.kind for e in run.events] == ["open", "hit", "open", "hit"]
    assert record["admissible"] is False


@pytest.mark.parametrize("name", ["row 14", "row 14, lower", "row 14, upper"])
def test_at_the_onset_of_stick_static_friction_would_just_hold_a_sliding_orbit(name: str) -> None:
    """Force and spring at the turns, 2 cos(omega t) - x, add up to the static friction."""
    record = RECORDS[name]
    machine = PiecewiseMachine.of(record["machine"])
    (t, kind, _, x), *_ = record["events"]
    assert kind == "turn"
    applied = machine.forces[0].cos[0] * math.cos(machine.omega * t) - x
    assert abs(applied) == pytest.approx(machine.friction[0].static, abs=2e-13)


def test_the_cycle_on_a_belt_slips_and_sticks_for_the_published_times() -> None:
    record = RECORDS["row 17"]
    run = simulate(belt(0.5), record["state"], 2, mode=PiecewiseMode(0, (), ("slip-",)), digits=24)
    for event, (t, kind, _, x) in zip(run.events, record["events"], strict=False):
        assert event.kind == kind
        assert abs(float(event.t) - t) < 1e-13
        assert abs(float(event.value) - x) < 1e-13


@pytest.mark.parametrize(("factor", "sticks"), [(1 - 1e-9, True), (1 + 1e-9, False)])
def test_beyond_row_18_the_slip_no_longer_reaches_the_belt(factor: float, sticks: bool) -> None:
    velocity = RECORDS["row 18"]["bifurcation"]["value"] * factor
    start = [1 - 0.1 * velocity, velocity]
    run = simulate(belt(velocity), start, span=6.0, mode=PiecewiseMode(0, (), ("slip-",)), digits=24)
    assert [e.kind for e in run.events] == (["stick"] if sticks else [])
