"""Several recordings of one craft: prepare each -> explain together -> what is common -> what is left -> verdict."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from magcal_service.diagnosis.belief import with_left
from magcal_service.diagnosis.diagnose import Verdict, verdict_of
from magcal_service.diagnosis.doubts import (
    added_noise_nt,
    concerned,
    has_coverage,
    is_too_much,
    listed,
    of_noise_and_reference,
    stands_out,
)
from magcal_service.diagnosis.errors_spread import errors_covariance
from magcal_service.diagnosis.explain import Explained, Search
from magcal_service.diagnosis.field_error import SCALES, Scale
from magcal_service.diagnosis.field_level import at_scale, likeliest, needed_scale
from magcal_service.diagnosis.joint.catalogue import Forms
from magcal_service.diagnosis.joint.compare import Apart, Compared
from magcal_service.diagnosis.joint.forms import JointHypothesis, joint, transferred
from magcal_service.diagnosis.joint.light import LightSeen, light_seen
from magcal_service.diagnosis.joint.problem import JointProblem
from magcal_service.diagnosis.joint.search import JointSearch
from magcal_service.diagnosis.leftover import Structure, significant, structures, with_courses
from magcal_service.diagnosis.noise import sensor_noise_nt
from magcal_service.diagnosis.prepare import Form, Prepared, prepare, stride_for
from magcal_service.diagnosis.problem import Fit, Problem
from magcal_service.diagnosis.rest import Rest
from magcal_service.diagnosis.rows import made_where
from magcal_service.diagnosis.searching import FLOOR, LOWER, quieted
from magcal_service.diagnosis.solution import solve
from magcal_service.diagnosis.stages import COMPARING, LEFT, SIMULATING, Progress, untold
from magcal_service.model import STATE_SIZE, Array
from magcal_service.physics.catalogue import catalogue, held_at
from magcal_service.physics.held import HeldAt
from magcal_service.physics.interface import Effect
from magcal_service.recordings.inspect.inspection import Inspection


@dataclass(frozen=True, slots=True, eq=False)
class Alone:
    """One recording in a joint diagnosis.

    Parameters
    ----------
    name: of the recording.
    inspection: what is wrong with it.
    prepared: its rows, problem and the nine errors alone.
    baseline: the nine errors alone, under the field model's errors that it needs.
    fit: its nine errors with the effects, as the joint fit has them.
    covariance: (9, 9) of those errors.
    left: structures that are left, best first.
    light: channels that show the computed light.
    has_memory: whether its noise has one, which is looked for where nothing is named.
    """

    name: str
    inspection: Inspection
    prepared: Prepared
    baseline: Fit
    fit: Fit
    covariance: Array
    left: tuple[Structure, ...]
    light: tuple[LightSeen, ...] = ()
    has_memory: bool = False

    @property
    def memory_nt(self) -> float | None:
        """rms of its noise with its memory [nT], where that is more than ``noise_nt``; None where it is white."""
        return self.fit.rms_nt if self.has_memory and self.fit.rms_nt > self.noise_nt else None

    @property
    def noise_nt(self) -> float:
        """Its sensor's noise beside the effects, 1 sigma per axis [nT]."""
        return sensor_noise_nt(self.fit, self.prepared.view.stated_noise_nt)

    @property
    def made_where(self) -> list[str]:
        """What is only guessed, or was not used, of where it was made."""
        return made_where(self.prepared)

    @property
    def has_coverage(self) -> bool:
        """Whether the field pointed in enough directions to fix its nine errors."""
        return has_coverage(self.covariance)

    @property
    def held_at(self) -> tuple[HeldAt, ...]:
        """At which temperature its nine errors hold, where an effect follows one."""
        return held_at(term.hypothesis for term in self.fit.terms)

    def doubts(self, named: bool) -> Mapping[str, bool]:
        """What speaks against its noise and its reference, beside effects or (``named`` false) none."""
        return of_noise_and_reference(
            self.fit,
            named=named,
            stated=self.prepared.view.stated_noise_nt is not None,
            added_noise_nt=added_noise_nt(self.prepared.findings),
        )

    @property
    def explained(self) -> float:
        """Drop in squares by the effects [nT^2]."""
        return max(float((self.baseline.residual**2).sum() - (self.fit.residual**2).sum()), 0.0)

    @property
    def unexplained(self) -> float:
        """Squares in the best of the structures that are left [nT^2], 0 where it may be noise."""
        return self.left[0].squares if self.left and significant(self.left[0]) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class JointDiagnosis:
    """Everything that was found on several recordings of one craft.

    Parameters
    ----------
    recordings: each of them.
    explained: effects that were kept, fitted to all.
    compared: every recording against the others.
    verdict, reasons: what it comes to, and what speaks against acting on it.
    effects: the catalogue.
    seconds: what it took.
    assumed: what nothing in the recordings says, in a sentence; empty where nothing had to be assumed.
    rest: what lasts beside the names, over all recordings.
    """

    recordings: tuple[Alone, ...]
    explained: Explained
    compared: Compared
    verdict: Verdict
    reasons: tuple[str, ...]
    effects: tuple[Effect, ...]
    seconds: float
    assumed: str = ""
    rest: Rest | None = None

    @property
    def latest(self) -> int:
        """Which of the recordings begins last: its nine errors and start states a model begins from."""
        starts = [one.prepared.problem.scene.origin_ns for one in self.recordings]
        return starts.index(max(starts))

    @property
    def concerned(self) -> Mapping[str, tuple[str, ...]]:
        """The effects that a reason is about, by the reason."""
        return concerned(self.explained, {})

    @property
    def trusted(self) -> bool:
        """Whether the result may be acted on."""
        return not self.reasons

    @property
    def fit(self) -> Fit:
        """Nine errors of each and effects of all."""
        return self.explained.fit

    @property
    def unexplained(self) -> float:
        """Share of the mismatch that no effect explains."""
        left = sum(one.unexplained for one in self.recordings)
        return left / max(left + sum(one.explained for one in self.recordings), 1e-12)

    @property
    def left_share(self) -> float:
        """Of the mismatch, what is left beside the names: in a shape, or lasting without one."""
        return max(self.unexplained, 0.0 if self.rest is None else self.rest.share)

    @property
    def may_last(self) -> float:
        """Of the mismatch, what cannot be excluded to last beside the names."""
        return 0.0 if self.rest is None else self.rest.unsafe_share


def diagnose_together(
    inspections: Sequence[Inspection],
    names: Sequence[str],
    effects: tuple[Effect, ...] | None = None,
    progress: Progress = untold,
    assumed: str = "",
) -> JointDiagnosis:
    """Find the physics that several recordings of one craft have in common.

    While something has to be answered about one of the recordings, no physics is named.

    Parameters
    ----------
    inspections, names: two or more recordings with what was found on each, and a name for each.
    effects: the catalogue; a test may pass its own.
    progress: is called with which of ``stages.JOINT_STEPS`` begins.
    assumed: what the caller has to take for granted, as ``gather`` says it.
    """
    began = time.monotonic()
    is_open = any(one.open for one in inspections)
    effects = () if is_open else catalogue() if effects is None else effects
    progress(SIMULATING)
    stride = stride_for(sum(one.account_to_diagnose.used for one in inspections))
    prepared = [prepare(one.to_diagnose, effects, (Form.ROOM, Form.SCALAR), stride) for one in inspections]
    run = _Run(tuple(effects), prepared, tuple(names))
    explained = run.explained(progress)
    progress(COMPARING)
    explained, compared = run.common(explained)
    progress(LEFT)
    alone = run.alone(explained.fit, inspections)
    rest = Rest.of_all([(one.baseline, one.fit) for one in alone])
    floor = FLOOR * explained.fit.problem.noise_nt
    explained = with_left(explained, sum(one.unexplained for one in alone), rest, floor)
    found = JointDiagnosis(
        tuple(alone), explained, compared, Verdict.NONE, (), tuple(effects), time.monotonic() - began, assumed, rest
    )
    seen = {name: finding for one in alone for name, finding in one.prepared.findings.items()}
    verdict = Verdict.UNKNOWN if is_open else verdict_of(explained, seen, found.unexplained)
    doubts = ("recording_doubtful",) if is_open else ()
    return replace(found, verdict=verdict, reasons=(*doubts, *_reasons(found, verdict)))


@dataclass(eq=False)
class _Run:
    """The steps that follow the preparation, on the recordings' problems under the field-model errors they need."""

    effects: tuple[Effect, ...]
    prepared: Sequence[Prepared]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        self._usual = [one.problem.field_error for one in self.prepared]
        self._scales = [min(SCALES)] * len(self.prepared)
        self._dispersion = 1.0
        self._relative: tuple[float, ...] = ()
        self._of_alone: list[tuple[Scale, float] | None] = [None] * len(self.prepared)
        self._searched: JointSearch | None = None
        self.singles = self._scaled()
        self.catalogue = Forms.of(self.effects, self.singles)

    def _search(self, problem: JointProblem) -> JointSearch:
        """A search on a problem, which knows what came near in those before it: its rivals are among these."""
        forms, before = self.catalogue.on(problem.parts, self.names), self._searched
        search = JointSearch(problem, forms, self.effects, catalogue=self.catalogue, names=self.names)
        if before is not None:
            search.close |= before.close
            search.follow(before)
            search.look_at(problem, forms)
        self._searched = search
        return search

    def _scaled(self) -> list[Problem]:
        triples = zip(self.prepared, self._usual, self._scales, strict=True)
        return [one.problem if usual is None else at_scale(one.problem, usual, s) for one, usual, s in triples]

    def explained(self, progress: Progress) -> Explained:
        """A search, repeated while a recording needs larger errors of the field model; wider noise brings no names."""
        found: Explained | None = None
        names_hold = False
        while True:
            problem = JointProblem.of(self.singles)
            baseline = solve(problem, np.concatenate([one.baseline.x for one in self.prepared]))
            search = self._search(problem)
            floor = FLOOR * problem.noise_nt
            if found is not None and (names_hold or not found.fit.terms):
                return self._arrived(search, search.again(problem, found.fit, floor))
            found = self._arrived(search, search.run(baseline, floor, progress))
            grown, names_hold = self._grown(baseline, found.fit)
            if not grown:
                return found

    @staticmethod
    def _arrived(search: JointSearch, found: Explained) -> Explained:
        fit = search.arrived(found.fit)
        return found if fit is found.fit else search.compared(fit, FLOOR * search.problem.noise_nt)

    def _grown(self, baseline: Fit, fit: Fit) -> tuple[bool, bool]:
        """Whether some recording needs larger errors of the field model, taken from now on; and whether names hold."""
        rows = zip(self._usual, _parts(baseline), self._of_alone, strict=True)
        self._of_alone = [
            known if known or usual is None else likeliest(one.problem, usual, one.x) for usual, one, known in rows
        ]
        needed = [
            (min(SCALES), True) if usual is None or of_alone is None else needed_scale(usual, of_alone, part)
            for usual, of_alone, part in zip(self._usual, self._of_alone, _parts(fit), strict=True)
        ]
        grown = [not scale.is_within(old) for (scale, _), old in zip(needed, self._scales, strict=True)]
        hold = all(holds for (_, holds), is_grown in zip(needed, grown, strict=True) if is_grown)
        self._scales = [scale.at_least(old) for (scale, _), old in zip(needed, self._scales, strict=True)]
        self.singles = self._scaled()
        return any(grown), hold

    def common(self, explained: Explained) -> tuple[Explained, Compared]:
        """Under the scatter that the blocks have and the noise that is left, with amplitudes of each recording's own
        where they differ in them."""
        if explained.fit.terms:
            self._dispersion = max(gain.dispersion for gain in explained.gains)
            assert isinstance(explained.fit.problem, JointProblem)
            self._relative = explained.fit.problem.relative_to(explained.fit.residual)
            explained = self._with_own(explained.fit, [])
        for _ in range(len(explained.fit.terms) + 1):
            compared = self._apart(explained.fit).compared()
            apart = [
                k for k, term in enumerate(explained.fit.terms) if joint(term).common and not compared.is_common(k)
            ]
            if not apart:
                break
            explained = self._with_own(explained.fit, apart)
        return explained, compared

    def _apart(self, fit: Fit) -> Apart:
        return Apart(self.catalogue, fit, self.singles, self.names, FLOOR)

    def _with_own(self, fit: Fit, numbers: Sequence[int]) -> Explained:
        """The fit with every amplitude of some terms each recording's own."""
        problem = JointProblem.of(self.singles, self._dispersion, self._relative)
        search = self._search(problem)
        forms = [form for form in search.hypotheses if isinstance(form, JointHypothesis)]
        by_label = {form.label: form for form in forms}
        terms = []
        for number, term in enumerate(fit.terms):
            form = joint(term)
            if number in numbers:
                own = [one for one in forms if one.base == form.base and one.is_each_its_own]
                terms.append(transferred(term, own[0]))
                search.close -= {one.label for one in forms if one.base == form.base}  # it is not common: that is known
            else:
                terms.append(transferred(term, by_label[form.label]))
        floor = FLOOR * problem.noise_nt
        return search.compared(search.arrived(search.refreshed(solve(problem, fit.x, terms))), floor)

    def alone(self, fit: Fit, inspections: Sequence[Inspection]) -> list[Alone]:
        """What each recording has of the joint fit, and what is left in it."""
        assert isinstance(fit.problem, JointProblem)
        found = []
        first = 0
        for number, (part, rows) in enumerate(zip(_parts(fit), fit.problem.slices, strict=True)):
            prepared, own = self.prepared[number], slice(first, first + STATE_SIZE)
            first += part.problem.size
            spin = prepared.spin
            spin_hz = None if spin is None else abs(spin.rate_rad_s) / (2.0 * np.pi)
            search = Search(part.problem, [], self.effects, spin_hz=spin_hz)
            floor, phase = FLOOR * part.problem.noise_nt, None if spin is None else spin.phase_rad
            left = with_courses(search, part, structures(search, part, phase, floor), floor)
            by_memory = None
            if significant(left[0]) and not part.terms:
                by_memory = _by_memory(prepared, search, part, phase, LOWER * floor)
            baseline = solve(self.singles[number], prepared.baseline.x)
            found.append(
                Alone(
                    self.names[number],
                    inspections[number],
                    prepared,
                    baseline,
                    part,
                    errors_covariance(fit, part.problem, rows, own),
                    tuple(left if by_memory is None else by_memory),
                    light_seen(prepared.problem.scene, None if spin is None else spin.rate_rad_s),
                    has_memory=by_memory is not None,
                )
            )
        return found


def _by_memory(
    prepared: Prepared, search: Search, fit: Fit, phase: Array | None, floor_nt: float
) -> list[Structure] | None:
    """What is left in one recording on a residual whitened by the memory of its noise; None where that is white, or
    follows a channel in spite of it."""
    quiet = quieted(prepared, search, fit.problem, fit, floor_nt)
    return None if quiet is None else with_courses(quiet, fit, structures(quiet, fit, phase, floor_nt), floor_nt)


def _parts(fit: Fit) -> list[Fit]:
    """Each recording's own part in a fit of all."""
    assert isinstance(fit.problem, JointProblem)
    return fit.problem.fits(fit.x, fit.terms)


def _reasons(found: JointDiagnosis, verdict: Verdict) -> tuple[str, ...]:
    """What speaks against acting on a result, by the names of ``advice.REASONS``."""
    fit, named = found.fit, bool(found.fit.terms)
    predicts = any(joint(term).common for term in fit.terms) and all(
        one.stands_out and one.kept > 0.0 for one in found.compared.predicted if one.shows
    )
    each = [one.doubts(named) for one in found.recordings]
    return listed(
        found.explained,
        found.rest,
        {},
        poor_coverage=not any(one.has_coverage for one in found.recordings),
        unexplained_structure=verdict is Verdict.UNKNOWN or (named and is_too_much(found.explained, found.unexplained)),
        **{reason: any(one[reason] for one in each) for reason in each[0]},
        gain_in_scatter=named and not stands_out(solve(fit.problem, fit.x), fit, FLOOR * fit.problem.noise_nt),
        not_predicted=named and not predicts,
    )
