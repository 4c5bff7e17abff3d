"""In which order what disturbs records is asked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from pymc_backbone.discrepancy.disturbances import changed
from pymc_backbone.discrepancy.disturbances import undisturbed as module
from pymc_backbone.discrepancy.disturbances import without_edges as of_edges
from pymc_backbone.discrepancy.disturbances.edges import Edges
from pymc_backbone.discrepancy.disturbances.sensor_filter import SensorFilter
from pymc_backbone.discrepancy.weighing import evidence
from pymc_backbone.discrepancy.weighing.evidence import Drifting


@dataclass
class Unmeasured:
    """A question whose records hold nothing."""

    batch: object = None

    def of_records(self, *_):
        return Unmeasured(SimpleNamespace(records=(), waveform=(), specimens=("one",), count=4))

    def saying(self, *_):
        return self


def _asked_in(name):
    """The module that asks this."""
    return of_edges if name == "edges" else module


@pytest.fixture(autouse=True)
def _as_released(monkeypatch):
    """No beat, no release without force, no step of the clock, every early high-pass needed, unless a test says so."""
    monkeypatch.setattr(module, "lines_that_beat", lambda *_: None)
    monkeypatch.setattr(module, "clock_steps", lambda *_: None)
    monkeypatch.setattr(module, "is_relaxed_at_release", lambda *_: False)
    monkeypatch.setattr(changed, "run_in", lambda batch, _specimens: batch)
    monkeypatch.setattr(module, "settled", lambda _search, _behind, chosen: chosen)


@pytest.mark.parametrize(("passes", "is_cut"), [([3], True), ([3, 1], True), ([3, 3, 3, 3], False)])
def test_first_cycles_that_come_to_be_off_one_after_the_other_are_no_edge(passes, is_cut, monkeypatch):
    """A stop that large motions alone reach: where three cycles are left out, it is in the three that follow."""
    batch, waiting = SimpleNamespace(specimens=("one",)), list(passes)

    def seen(_batch, _found, known):
        assert (known is None) == (len(waiting) == len(passes))
        return Edges({"one": 1.0}, cycles=waiting.pop(0)) if waiting else None

    monkeypatch.setattr(of_edges, "edges", seen)
    monkeypatch.setattr(of_edges, "fitted_on", lambda found, _batch: found)
    asked = SimpleNamespace(records=[], posed=lambda: SimpleNamespace(batch=batch))
    asked.within = lambda _lost: asked
    cut = of_edges._cut_by(asked, SimpleNamespace(batch=batch, fits={(): "a fit"}), ())
    assert (cut is not None) == is_cut
    if is_cut:
        assert cut.lost.cycles == sum(passes)


@pytest.mark.parametrize(("cycles", "left", "measured"), [(1, 1e3, 1), (1, 10.0, 3), (2, 10.0, 0)])
def test_records_that_a_set_explains_are_seldom_measured_again_without_edges(cycles, left, measured, monkeypatch):
    """One first cycle is all that is told beside such a set; and a set that is far off without it leaves more."""
    posed, waiting = [], [cycles, 0, 0]
    batch, again = SimpleNamespace(specimens=("one",), count=100), SimpleNamespace(chi_square=np.array([left * 100]))
    monkeypatch.setattr(of_edges, "edges", lambda *_: Edges({"one": 1.0}, cycles=waiting.pop(0)) if waiting else None)
    monkeypatch.setattr(of_edges, "fitted_on", lambda *_: again)
    asked = SimpleNamespace(posed=lambda: posed.append(1) or SimpleNamespace(batch=batch))
    asked.within = lambda _lost: asked
    cut = of_edges._cut_by(asked, SimpleNamespace(batch=batch, fits={(): "a fit"}), (), is_needed=False)
    assert len(posed) == measured and (cut is None) == (cycles > 1)


@pytest.mark.parametrize("is_drifting", [True, False])
def test_a_drift_is_asked_before_cycles_are_left_out_and_noise_is_weighed(is_drifting, monkeypatch):
    left = {"base": False, "drift": is_drifting}
    asked = []

    def says(name):
        return lambda *_: asked.append(name)

    names = ("drifting_zero", "is_relaxed_at_release", "drop_outs", "sensor_filter", "earlier", "edges")
    for name in (*names, "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, says(name))
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: left[found])
    monkeypatch.setattr(changed, "over_motion", lambda *_: 1e-3)
    monkeypatch.setattr(module, "over_motion", lambda *_: 1e-3)
    search = SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): "base"}, best=tuple)

    def drifting(_):
        asked.append("drift")
        return {(): Drifting("drift", 0.0)}

    known = module.undisturbed(SimpleNamespace(batch=None), search, [], None, says("searched"), drifting)
    assert known.search is search and known.is_drifting == is_drifting
    between = [] if is_drifting else ["edges", "motion_noise"]
    # before first samples are left out: these say how what remembers was released
    first = ["drifting_zero", "is_relaxed_at_release", "drop_outs", "sensor_filter", "earlier"]
    assert asked == [*first, "drift", *between, "disturbed"]


def test_of_velocities_and_accelerations_a_filter_is_asked_before_the_zero(monkeypatch):
    asked = []
    for name in ("drifting_zero", "drop_outs", "sensor_filter", "earlier", "edges", "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_, name=name: asked.append(name))
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda *_: False)
    search = SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): "base"}, best=tuple)
    records = [SimpleNamespace(quantity="acceleration"), SimpleNamespace(quantity="velocity")]
    module.undisturbed(SimpleNamespace(batch=None), search, records, None, lambda _: search, lambda _: {})
    assert asked[:4] == ["drop_outs", "sensor_filter", "drifting_zero", "earlier"]


@pytest.mark.parametrize(("quieter", "is_straightened"), [(0.95, False), (0.5, True)])
def test_sensors_are_straightened_beside_a_drift_where_less_noise_is_left(quieter, is_straightened, monkeypatch):
    """A noise that was estimated with the disturbance in it hides that, and a drift takes the rest."""
    for name in ("drifting_zero", "drop_outs", "sensor_filter", "earlier", "edges", "motion_noise"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    bent = SimpleNamespace(is_bent=True, undisturbed=lambda records: records)
    monkeypatch.setattr(module, "disturbed", lambda _: bent)
    monkeypatch.setattr(changed, "sentences", lambda found: [])
    monkeypatch.setattr(changed, "whatever_is_left", lambda batch, _: batch)
    left = {"base": 1.0, "drift": 1e-3, "straight": quieter * 1e-3}
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found != "base")
    monkeypatch.setattr(changed, "over_motion", lambda _, found: left[found])
    monkeypatch.setattr(module, "over_motion", lambda _, found: left[found])
    search, straight = (
        SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): name}, best=tuple)
        for name in ("base", "straight")
    )
    drifting = {(): Drifting("drift", 0.0)}
    known = module.undisturbed(Unmeasured(), search, [], None, lambda _: straight, lambda _: drifting)
    assert known.search is (straight if is_straightened else search) and known.is_bent == is_straightened


@pytest.mark.parametrize(
    ("remain", "likelier", "p_value", "is_drift"),
    [
        (("law", "more"), ("law", *evidence.DRIFT), 0.4, True),
        (("law",), ("law", *evidence.DRIFT), 0.4, False),
        (("law", "more"), ("law", *evidence.DRIFT), 0.01, False),
        (("law", "more"), ("law", "more", *evidence.DRIFT), 0.4, False),
        (("law", "more"), ("law", "more"), 0.4, False),
    ],
)
def test_a_drift_that_leaves_nothing_goes_before_a_bent_sensor_beside_more_effects(
    remain, likelier, p_value, is_drift, monkeypatch
):
    """A bilinear spring that drifts had been a stop and a play that left noise, and then a sensor seemed bent."""
    for name in ("drifting_zero", "drop_outs", "sensor_filter", "earlier", "edges", "motion_noise"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    bent = SimpleNamespace(is_bent=True, undisturbed=lambda records: records)
    monkeypatch.setattr(module, "disturbed", lambda _: bent)
    monkeypatch.setattr(changed, "sentences", lambda _: [])
    monkeypatch.setattr(changed, "whatever_is_left", lambda batch, _: batch)
    monkeypatch.setattr(module, "over_motion", lambda *_: 1e-3)
    monkeypatch.setattr(changed, "over_motion", lambda *_: 1e-3)
    monkeypatch.setattr(module, "likeliest", lambda *_: likelier)
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda *_: True)

    def left(_batch, found):
        return SimpleNamespace(share=0.01, p_value=p_value if found == "beside a drift" else 0.02)

    monkeypatch.setattr(module.evidence, "lack_of_fit", left)
    given = SimpleNamespace(halted=None, is_told=False, batch=None, fits={("law", "more", "still"): "larger"})
    straight = SimpleNamespace(halted=None, is_told=False, batch=None, fits={remain: "straight"})
    given.best, straight.best = lambda: ("law", "more", "still"), lambda: remain

    def drifts(search):
        assert search is given
        return dict.fromkeys((("law",), ("law", "more")), Drifting("beside a drift", 0.0))

    known = module.undisturbed(Unmeasured(), given, [], None, lambda _: straight, drifts)
    assert known.search is (given if is_drift else straight) and known.is_drifting == is_drift


@pytest.mark.parametrize(("same_set_leaves", "most"), [(0.012, 3), (0.04, 3), (0.04, 1)])
def test_a_low_pass_that_explains_nothing_to_the_noise_has_to_make_the_difference(same_set_leaves, most, monkeypatch):
    """And not the larger set behind it, which leaves nearly as little without."""
    behind = SimpleNamespace(
        sentences=lambda _: ["a filter"], passed=lambda batch: "filtered", undone=lambda records, _batch: records
    )
    left = {"base": 0.1, "large behind": 0.01, "large": same_set_leaves}
    for name in ("earlier", "edges", "motion_noise", "disturbed", "drifting_zero", "drop_outs"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    monkeypatch.setattr(module, "sensor_filter", lambda _: behind)
    monkeypatch.setattr(
        changed.evidence, "lack_of_fit", lambda _, found: SimpleNamespace(share=left[found], p_value=0.0)
    )
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda *_: False)
    common = {"halted": None, "is_told": False, "batch": None}
    before = SimpleNamespace(**common, fits={(): "base"}, best=tuple, fit_set=lambda names: names and "large")
    after = SimpleNamespace(**common, fits={("large",): "large behind"}, best=lambda: ("large",), max_effects=most)

    @dataclass
    class Question:
        batch: str = "as measured"

        def of_records(self, records, measuring):
            return Question()

        def saying(self, *_):
            return self

    known = module.undisturbed(Question(), before, [], None, lambda _: after, lambda _: {})
    assert known.search is (after if same_set_leaves > 0.02 and most > 1 else before)


@pytest.mark.parametrize("helps", [True, False])
def test_a_low_pass_is_kept_where_more_is_explained_behind_it(helps, monkeypatch):
    """It is said, and what follows is asked of the search behind it; else nothing of it is left."""
    behind = SimpleNamespace(
        sentences=lambda _: ["a filter"], passed=lambda batch: "filtered", undone=lambda records, _batch: records
    )
    seen = []
    for name in ("earlier", "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda search, name=name: seen.append(search.fits[()]))
    monkeypatch.setattr(of_edges, "edges", lambda _batch, found, _known: seen.append(found))
    for name in ("drifting_zero", "drop_outs"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    monkeypatch.setattr(module, "sensor_filter", lambda _: behind)
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found == "explained")
    before = SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): "base"}, best=tuple)
    after = SimpleNamespace(
        halted=None, is_told=False, batch=None, fits={(): "explained" if helps else "base"}, best=tuple
    )
    asked = []

    @dataclass
    class Question:
        said: tuple[str, ...] = ()
        batch: str = "as measured"

        def saying(self, *said):
            return replace(self, said=said)

    def searched(question):
        asked.append(question)
        return after

    known = module.undisturbed(Question(), before, [], None, searched, lambda _: {})
    assert [(item.said, item.batch) for item in asked] == [(("a filter",), "filtered")]
    assert known.search is (after if helps else before)
    assert set(seen) == {known.search.fits[()]}


@pytest.mark.parametrize("helps", [True, False])
def test_a_search_that_a_filter_halted_goes_on_where_nothing_is_explained_behind_it(helps, monkeypatch):
    """Where a set leaves noise behind the filter, nothing else is asked."""
    seen = []
    for name in ("drop_outs", "drifting_zero", "sensor_filter", "earlier", "edges", "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_, name=name: seen.append(name))
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found == "explained")
    before = SimpleNamespace(halted=SensorFilter(1, 0.5, "high-pass"), is_told=False, fits={(): "base"}, best=tuple)
    before.batch = SimpleNamespace(records=[SimpleNamespace(frequency=5.0)], waveform=(), specimens=("one",))
    before.resume = lambda: seen.append("resumed")
    after = SimpleNamespace(
        halted=None, is_told=False, batch=None, fits={(): "explained" if helps else "base"}, best=tuple
    )

    monkeypatch.setattr(SensorFilter, "passed", lambda _self, batch: batch)
    question = Unmeasured(before.batch)
    known = module.undisturbed(question, before, [], None, lambda _: after, lambda _: {})
    assert known.search is (after if helps else before) and (known.question is question) == (not helps)
    assert seen[:1] == ([] if helps else ["resumed"]) and ("sensor_filter" in seen) == (not helps)


@pytest.mark.parametrize("beats", [False, True])
def test_records_are_searched_without_the_line_that_halted_a_search_or_beats(beats, monkeypatch):
    """Again with all that is asked early, and at last without lines; what follows is asked of the last."""
    for name in ("drop_outs", "drifting_zero", "sensor_filter", "earlier", "edges", "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    monkeypatch.setattr(changed, "sentences", lambda found: [f"{len(found)} taken away"])
    monkeypatch.setattr(changed, "whatever_is_left", lambda batch, _: batch)
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda *_: False)
    line = module.Disturbed({}, ())
    beating = iter([[], [], []])  # whatever is left of them, no third line is taken away
    if beats:
        monkeypatch.setattr(module, "lines_that_beat", lambda *_: next(beating))
    records = [SimpleNamespace(quantity="displacement", taken=taken) for taken in range(3)]
    monkeypatch.setattr(module.Disturbed, "undisturbed", lambda _self, known: [records[known[0].taken + 1]])
    searches = [
        SimpleNamespace(
            halted=None if beats else halted,
            is_told=False,
            batch=SimpleNamespace(specimens=()),
            fits={(): "base"},
            best=tuple,
        )
        for halted in (line, line, None)
    ]
    asked = []

    @dataclass
    class Question:
        taken: int = 0
        said: tuple[str, ...] = ()
        batch: object = None

        def of_records(self, records, measuring):
            return Question(records[0].taken)

        def saying(self, *said):
            return replace(self, said=said)

    def searched(question, *early):
        asked.append((question.taken, question.said, early))
        return searches[len(asked)]

    known = module.undisturbed(Question(), searches[0], records[:1], None, searched, lambda _: {})
    assert known.search is searches[-1]
    assert asked == [
        (1, ("1 taken away",), (module.in_the_way, module.drift_alone)),
        (2, ("2 taken away",), (module._in_front, module.drift_alone)),
    ]


@pytest.mark.parametrize(("is_bent", "explains"), [(False, True), (False, False), (True, True)])
def test_everything_is_asked_anew_where_a_line_is_not_all_that_disturbs_records(is_bent, explains, monkeypatch):
    """A hum beside a baseline that tilts: a bent sensor and another mode had stood for what the tilt left."""
    for name in ("drop_outs", "drifting_zero", "sensor_filter", "earlier", "edges", "motion_noise"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found == "explained")
    item = module.Disturbed({"one": SimpleNamespace(bent=0.01 * is_bent, frequency=1.0)}, ())
    monkeypatch.setattr(changed, "sentences", lambda found: [f"{len(found)} taken away"])
    monkeypatch.setattr(changed, "whatever_is_left", lambda batch, _: batch)
    monkeypatch.setattr(module.Disturbed, "undisturbed", lambda _self, records: records)
    monkeypatch.setattr(changed, "over_motion", lambda *_: 0.01)
    monkeypatch.setattr(module, "over_motion", lambda *_: 0.01)
    first, beside, anew = (
        SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): name}, best=tuple)
        for name in ("base", "rest", "explained" if explains else "rest")
    )
    monkeypatch.setattr(module, "disturbed", lambda search: item if search is first else None)
    asked = []

    @dataclass
    class Question:
        batch: object = None

        def of_records(self, records, measuring):
            return Question()

        def saying(self, *_):
            return self

    def searched(question, *early):
        asked.append(early)
        return anew if early else beside

    known = module.undisturbed(Question(), first, [], None, searched, lambda _: {})
    assert asked == [(), *([] if is_bent else [(module.in_the_way, module.drift_alone)])]
    assert known.search is (anew if explains and not is_bent else first)


@pytest.mark.parametrize(("plain", "is_kept"), [(1e-3, False), (1.5e-3, True)])
def test_a_filter_that_straightened_records_do_not_need_is_taken_back(plain, is_kept, monkeypatch):
    """The second harmonic of a bent sensor had been that of a spring that a high-pass turns."""
    for name in ("drop_outs", "drifting_zero", "earlier", "edges", "motion_noise"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    monkeypatch.setattr(module, "sensor_filter", lambda _: SensorFilter(1, 0.5, "high-pass"))
    monkeypatch.setattr(module, "gains", lambda *_: True)
    left = {"base": 1.0, "behind": 0.1, "straight behind": 1e-3, "straight": plain}
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda _, found: SimpleNamespace(share=left[found], p_value=0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found.startswith("straight"))
    for place in (module, changed):
        monkeypatch.setattr(place, "over_motion", lambda _, found: left[found])
    bent = module.Disturbed({"one": SimpleNamespace(bent=0.01, frequency=1.0)}, ())
    monkeypatch.setattr(module, "disturbed", lambda _: bent)
    monkeypatch.setattr(changed, "sentences", lambda found: ["straightened"] if found else [])
    monkeypatch.setattr(changed, "whatever_is_left", lambda batch, _: batch)
    monkeypatch.setattr(module.Disturbed, "undisturbed", lambda _self, records: ["straight"])
    monkeypatch.setattr(SensorFilter, "passed", lambda _self, batch: {**batch, "is_behind": True})
    monkeypatch.setattr(SensorFilter, "undone", lambda _self, records, _batch: records)
    monkeypatch.setattr(SensorFilter, "sentences", lambda *_: ["behind a filter"])

    @dataclass
    class Question:
        batch: dict

        def of_records(self, records, measuring):
            return Question({"is_straight": records == ["straight"]})

        def saying(self, *_):
            return self

    def searched(question, *early):
        said = " ".join(word for word, key in (("straight", "is_straight"), ("behind", "is_behind")) if key in
                        {name for name, value in question.batch.items() if value})  # fmt: skip
        return SimpleNamespace(halted=None, is_told=False, batch=question.batch, fits={(): said}, best=tuple)

    first = SimpleNamespace(halted=None, is_told=False, batch={}, fits={(): "base"}, best=tuple)
    known = module.undisturbed(Question({}), first, [], None, searched, lambda _: {})
    assert known.is_bent
    assert known.search.fits[()] == ("straight behind" if is_kept else "straight")


@pytest.mark.parametrize("explains", [True, False])
def test_everything_is_asked_anew_of_records_whose_clock_was_set_right(explains, monkeypatch):
    """Where that explains more: else the records are as they were, and everything else is asked of these."""
    asked = []
    for name in ("drop_outs", "drifting_zero", "sensor_filter", "earlier", "edges", "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_, name=name: asked.append(name))
    steps = SimpleNamespace(sentence="set right", undisturbed=lambda records: ["right"])
    monkeypatch.setattr(module, "clock_steps", lambda search, records: steps if records == ["wrong"] else None)
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found == "explained")
    monkeypatch.setattr(changed.Changed, "is_of_rates", False)
    before = SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): "base"}, best=tuple)
    after = SimpleNamespace(
        halted=None, is_told=False, batch=None, fits={(): "explained" if explains else "base"}, best=tuple
    )
    known = module.undisturbed(Unmeasured(), before, ["wrong"], None, lambda _: after, lambda _: {})
    assert known.search is (after if explains else before)
    assert ("drifting_zero" in asked) == (not explains)


@pytest.mark.parametrize("explains", [True, False])
def test_a_high_pass_that_what_was_found_behind_it_needs_not_is_taken_back(explains, monkeypatch):
    """The search without it is taken to its end; where that leaves more than noise, the one behind it stands."""
    for name in ("drop_outs", "drifting_zero", "sensor_filter", "earlier", "edges", "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    monkeypatch.setattr(module, "settled", lambda *_: None)
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found == "explained")
    before = SimpleNamespace(halted=SensorFilter(1, 0.5, "high-pass"), is_told=False, fits={(): "base"}, best=tuple)
    before.batch = SimpleNamespace(records=[SimpleNamespace(frequency=5.0)], waveform=(), specimens=("one",))
    before.resume = lambda: before.fits.update({(): "explained" if explains else "base"})
    after = SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): "explained"}, best=tuple)

    monkeypatch.setattr(SensorFilter, "passed", lambda _self, batch: batch)
    known = module.undisturbed(Unmeasured(), before, [], None, lambda _: after, lambda _: {})
    assert known.search is (before if explains else after)


@pytest.mark.parametrize("helps", [True, False])
def test_a_zero_that_drifts_is_the_answer_where_nothing_is_left_without_the_mid_line(helps, monkeypatch):
    """Then nothing else is asked; else the records are as they were."""
    monkeypatch.setattr(module, "drifting_zero", lambda *_: "steady")
    asked = []
    for name in ("drop_outs", "sensor_filter", "earlier", "edges", "motion_noise", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_, name=name: asked.append(name))
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda _, found: found == "explained")
    before = SimpleNamespace(halted=None, is_told=False, batch=None, fits={(): "base"}, best=tuple)
    after = SimpleNamespace(
        halted=None, is_told=False, batch=None, fits={(): "explained" if helps else "base"}, best=tuple
    )
    question = SimpleNamespace(batch=None)
    known = module.undisturbed(question, before, [], None, lambda _: after, lambda _: {})
    assert (known.search, known.question) == ((after, "steady") if helps else (before, question))
    assert bool(asked) != helps


@pytest.mark.parametrize(
    ("is_drifting", "likeliest", "is_all"),
    [
        (True, evidence.DRIFT, True),
        (False, evidence.DRIFT, False),
        (True, ("quadratic_damping", *evidence.DRIFT), False),
        (True, ("jenkins",), False),
    ],
)
def test_nothing_else_is_asked_where_a_drift_explains_the_records_by_itself(
    is_drifting, likeliest, is_all, monkeypatch
):
    """Where an effect beside it is likelier, what was not asked may explain the records without a drift.

    An Iwan element had been told as drag with a drift.
    """
    resumed = []
    monkeypatch.setattr(module, "likeliest", lambda *_: likeliest)
    search = SimpleNamespace(halted=None, is_told=True, batch=None, resume=lambda: resumed.append(True))
    drifting = {(): SimpleNamespace(fit="drift")}
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda *_: is_drifting)
    monkeypatch.setattr(changed, "over_motion", lambda *_: 0.01)
    monkeypatch.setattr(module, "over_motion", lambda *_: 0.01)
    monkeypatch.setattr(module, "_one_by_one", lambda *_: "asked")
    monkeypatch.setattr(module, "_steadied", lambda *_: None)
    monkeypatch.setattr(module, "_on_time", lambda *_: None)
    found = module.undisturbed(SimpleNamespace(batch=None), search, (), None, None, lambda _: drifting)
    assert bool(resumed) != is_all
    assert found == "asked" if resumed else (found.search is search and found.drifting is drifting)


@pytest.mark.parametrize("is_worth_it", [True, False])
def test_records_without_first_cycles_or_of_weighed_noise_are_searched_where_sets_gain_by_that(
    is_worth_it, monkeypatch
):
    asked = []
    for name in ("drifting_zero", "drop_outs", "sensor_filter", "earlier", "disturbed"):
        monkeypatch.setattr(_asked_in(name), name, lambda *_: None)
    passes = iter([Edges({"one": 0.2}), Edges({}, {"one": 0.8}), None])
    noise = SimpleNamespace(sentence="noise", weighed=lambda batch: batch)
    monkeypatch.setattr(of_edges, "edges", lambda *_: next(passes))
    left = SimpleNamespace(chi_square=np.array([4.0]))
    monkeypatch.setattr(of_edges, "fitted_on", lambda *_: left)
    monkeypatch.setattr(module, "motion_noise", lambda *_: noise)
    monkeypatch.setattr(changed, "is_promising", lambda search, batch, less: asked.append(less) or is_worth_it)
    monkeypatch.setattr(changed.evidence, "lack_of_fit", lambda *_: SimpleNamespace(share=0.01, p_value=0.0))
    monkeypatch.setattr(changed.evidence, "leaves_noise", lambda *_: False)
    batch = SimpleNamespace(specimens=("one",))
    search = SimpleNamespace(halted=None, is_told=False, batch=batch, fits={(): "base"}, best=tuple)
    search.reduced = lambda _: 1.0
    searches = []
    module.undisturbed(Unmeasured(), search, [], None, lambda other: searches.append(other) or search, lambda _: {})
    # without first cycles half of what was left is enough; the noise has to explain all of it
    assert asked == [0.5, 0.0]
    assert len(searches) == (2 if is_worth_it else 0)


def test_records_are_measured_once_however_often_they_are_asked(monkeypatch):
    """Nor are those that were given, which the question was asked of."""
    measured = []

    @dataclass
    class Question:
        said: tuple[str, ...] = ()
        batch: object = None

        def of_records(self, records, measuring):
            measured.append(records)
            return Question(batch=SimpleNamespace(records=records))

        def saying(self, *said):
            return replace(self, said=said)

    monkeypatch.setattr(module, "_undisturbed", lambda known: known.changed)
    records = ["as given"]
    given = module.undisturbed(Question(), None, records, None, None, None)
    for _ in range(2):
        assert given.but("said of them").posed() == Question(("said of them",))
    assert measured == []
    cut, other = given.but("cut", records=["cut"]), given.but(records=["other"])
    for asked in (cut, cut.but("and more"), other, cut):
        assert asked.posed().batch.records is asked.records
    assert measured == [["cut"], ["other"]]
